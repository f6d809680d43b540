"""Distributed mesh from the cells given on each rank."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.given_cells import GivenCells
from agglo_core.distributed.mesh.shared import Beyond, FaceKeys, cells_beyond, face_keys, mark_shared_points
from agglo_core.distributed.mesh.whole_cells import WholeCells, distinct, places
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_offsets, whole_numbers
from agglo_core.mesh.construction.polygons import loops_as_csr
from agglo_core.mesh.elements import gather

FaceTags = Mapping[str, tuple[Any, ArrayLike]]
"""Faces (lists of points) and values by tag name."""


def across_ranks(given: GivenCells, face_tags: FaceTags | None, ranks: Ranks) -> WholeCells:
    """Match the given cells' faces across ranks, and number them as on a single process.

    A face belongs to its cell with the smaller global id. Faces follow their owner cells' order, and
    within a cell the cell's order.
    """
    mesh, offsets = given.mesh, given.mesh.face_offsets
    vertices = given.points[mesh.face_vertices]
    names = sorted(set().union(*ranks.gathered(set(face_tags or {}))))
    with ranks.together():
        tags = _collect_tags(face_tags or {}, names, given, vertices)
    # Faces with all points on several ranks may have a cell on another rank.
    cells = np.append(given.cells, -1)[mesh.face_cells]
    shared = mark_shared_points(given.points, mesh.points, ranks)[mesh.face_vertices]
    if mesh.n_faces:  # a face between ranks has only shared points
        shared = np.logical_and.reduceat(shared, offsets[:-1])
    near = frozen_int(np.flatnonzero(shared))
    loops, entries = gather(offsets, near)
    # Match these faces across ranks, and merge tags of both sides.
    partners = cells_beyond(vertices[entries], loops, frozen_int(cells[near]), tags[near], near, ranks)
    tags[near] = np.where(tags[near] != 0, tags[near], partners.tags)
    across = partners.cells >= 0
    beyond = Beyond(*(column[across] for column in partners))
    border = frozen_int(near[across])
    # The smaller cell id owns a border face. Owners number and orient the faces.
    is_owned = np.ones(mesh.n_faces, bool)
    is_owned[border] = cells[border, 0] < beyond.cells
    faces = _number_faces(cells[:, 0], is_owned, ranks)
    faces, vertices = _from_owners(faces, is_owned, offsets, vertices, border, beyond, ranks)
    sides, owners = _sides(cells, border, beyond, ranks.rank)
    # Sort faces by their global number.
    order = np.argsort(faces)
    new_offsets, entries = gather(offsets, frozen_int(order))
    return WholeCells(
        given.cells,
        frozen_int(np.full(len(given.cells), ranks.rank)),
        mesh.cell_tags,
        frozen_int(faces[order]),
        new_offsets,
        places(frozen_int(vertices[entries]), given.points),
        frozen_int(sides[order]),
        frozen_int(owners[order]),
        {name: frozen_int(tags[order, k]) for k, name in enumerate(names)},
        given.points,
        mesh.points,
    )


def _collect_tags(
    face_tags: FaceTags, names: list[str], cells: GivenCells, vertices: Int
) -> NDArray[np.int64]:
    """Return face tags ``(n_faces, len(names))`` for faces given by their points, 0 elsewhere."""
    tags = np.zeros((cells.mesh.n_faces, len(names)), np.int64)
    if not face_tags:
        return tags
    keys = face_keys(vertices, cells.mesh.face_offsets)
    for name, (faces, values) in face_tags.items():
        column = tags[:, names.index(name)]
        positions = _find_listed_faces(f"face tag {name!r}", faces, cells, keys)
        tag_values = whole_numbers(values, f"face tag {name!r}")
        if len(tag_values) != len(positions):
            raise MeshError(f"face tag {name!r} lists {len(positions)} faces, but {len(tag_values)} values")
        column[positions] = tag_values
        if (column[positions] != tag_values).any():
            raise MeshError(f"face tag {name!r} lists a face twice, with different values")
    return tags


def _find_listed_faces(title: str, faces: Any, cells: GivenCells, keys: FaceKeys) -> Int:
    """Return the indices of faces given by their points, or raise MeshError for an unknown face."""
    offsets, points = loops_as_csr(faces)
    check_offsets(offsets, len(points), "face")
    is_known = (points >= 0) & (points < len(cells.numbers))
    is_known[is_known] = cells.numbers[points[is_known]] >= 0
    if not is_known.all():
        raise MeshError(f"{title}: no cell of this rank has point {points[np.argmin(is_known)]}")
    face_numbers = _look_up_faces(face_keys(cells.points[cells.numbers[points]], offsets), keys)
    if len(face_numbers) and face_numbers.min() < 0:
        row = int(np.argmin(face_numbers))
        loop = points[offsets[row] : offsets[row + 1]].tolist()
        raise MeshError(f"{title}: no cell of this rank has a face with the points {loop}")
    return face_numbers


def _look_up_faces(sought: FaceKeys, keys: FaceKeys) -> Int:
    """Return the index of each sought face among the keys, or -1 if missing."""
    if not len(sought.low):
        return frozen_int([])
    every = np.concatenate((keys.low, sought.low)), np.concatenate((keys.mixed, sought.mixed))
    order = np.lexsort(every[::-1])
    low, mixed = (each[order] for each in every)
    new = np.concatenate(([True], (low[1:] != low[:-1]) | (mixed[1:] != mixed[:-1])))
    first = order[np.flatnonzero(new)][np.cumsum(new) - 1]  # the sort is stable: known faces come first
    found = np.empty(len(order), np.int64)
    found[order] = np.where(first < len(keys.low), first, -1)
    return frozen_int(found[len(keys.low) :])


def _number_faces(owner: Int, is_owned: NDArray[np.bool_], ranks: Ranks) -> Int:
    """Number the faces that this rank's cells own, in cell order. Other faces get -1."""
    owner_cells = owner[is_owned]
    rank = np.arange(len(owner_cells)) - np.searchsorted(owner_cells, owner_cells)
    most = int(ranks.largest(float(rank.max(initial=0)))) + 1
    faces = np.full(len(owner), -1)
    faces[is_owned] = owner_cells * most + rank
    return frozen_int(faces)


def _from_owners(
    faces: Int,
    is_owned: NDArray[np.bool_],
    offsets: Int,
    vertices: Int,
    border: Int,
    beyond: Beyond,
    ranks: Ranks,
) -> tuple[Int, Int]:
    """Exchange border face numbers and points, so that each rank uses those of the face's owner."""
    parcels = {}
    for rank in distinct(beyond.ranks).tolist():
        rows = np.flatnonzero((beyond.ranks == rank) & is_owned[border])
        at = border[rows]
        parcels[rank] = beyond.faces[rows], faces[at], vertices[gather(offsets, at)[1]]
    faces, vertices = faces.copy(), vertices.copy()
    for at, numbers, loops in ranks.exchanged(parcels).values():
        faces[at] = numbers
        vertices[gather(offsets, at)[1]] = loops
    return faces, vertices


def _sides(cells: Int, border: Int, beyond: Beyond, rank: int) -> tuple[Int, Int]:
    """Return each face's two cells and their ranks, the owner first."""
    sides, owners = cells.copy(), np.where(cells >= 0, rank, -1)
    sides[border, 1], owners[border, 1] = beyond.cells, beyond.ranks
    turned = border[beyond.cells < cells[border, 0]]
    sides[turned], owners[turned] = sides[turned, ::-1], owners[turned, ::-1]
    return sides, owners
