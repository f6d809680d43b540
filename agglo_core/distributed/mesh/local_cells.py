"""Join all ranks' given cells to one mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.given_cells import GivenCells
from agglo_core.distributed.mesh.shared import Beyond, FaceKeys, cells_beyond, face_keys, shared_points
from agglo_core.distributed.mesh.whole_cells import WholeCells, distinct, places
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_offsets, whole_numbers
from agglo_core.mesh.construction.polygons import loops_as_csr
from agglo_core.mesh.elements import gather

FaceTags = Mapping[str, tuple[Any, ArrayLike]]
"""Faces (lists of points) and values by tag name."""


def across_ranks(given: GivenCells, face_tags: FaceTags | None, ranks: Ranks) -> WholeCells:
    """Return the local cells, with faces numbered and oriented as on a single process.

    A face belongs to its cell with the smaller global id. Faces follow their owner cells' order, and
    within a cell the cell's order.
    """
    mesh, offsets = given.mesh, given.mesh.face_offsets
    vertices = given.points[mesh.face_vertices]
    names = sorted(set().union(*ranks.gathered(set(face_tags or {}))))
    with ranks.together():
        tags = _listed_tags(face_tags or {}, names, given, vertices)
    # Faces with all points on several ranks may have a cell on another rank.
    cells = np.append(given.cells, -1)[mesh.face_cells]
    shared = shared_points(given.points, mesh.points, ranks)[mesh.face_vertices]
    if mesh.n_faces:  # a face between ranks has only shared points
        shared = np.logical_and.reduceat(shared, offsets[:-1])
    near = frozen_int(np.flatnonzero(shared))
    loops, entries = gather(offsets, near)
    # Match these faces across ranks, and merge tags of both sides.
    found = cells_beyond(vertices[entries], loops, frozen_int(cells[near]), tags[near], near, ranks)
    tags[near] = np.where(tags[near] != 0, tags[near], found.tags)
    across = found.cells >= 0
    beyond = Beyond(*(each[across] for each in found))
    border = frozen_int(near[across])
    # The smaller cell id owns a border face. Owners number and orient the faces.
    mine = np.ones(mesh.n_faces, bool)
    mine[border] = cells[border, 0] < beyond.cells
    faces = _numbered(cells[:, 0], mine, ranks)
    faces, vertices = _from_owners(faces, mine, offsets, vertices, border, beyond, ranks)
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


def _listed_tags(
    face_tags: FaceTags, names: list[str], given: GivenCells, vertices: Int
) -> NDArray[np.int64]:
    """Return face tags ``(n_faces, len(names))`` from faces listed by points, 0 elsewhere."""
    tags = np.zeros((given.mesh.n_faces, len(names)), np.int64)
    if not face_tags:
        return tags
    keys = face_keys(vertices, given.mesh.face_offsets)
    for name, (faces, values) in face_tags.items():
        column = tags[:, names.index(name)]
        found = _listed(f"face tag {name!r}", faces, given, keys)
        said = whole_numbers(values, f"face tag {name!r}")
        if len(said) != len(found):
            raise MeshError(f"face tag {name!r} lists {len(found)} faces, but {len(said)} values")
        column[found] = said
        if (column[found] != said).any():
            raise MeshError(f"face tag {name!r} lists a face twice, with different values")
    return tags


def _listed(what: str, faces: Any, given: GivenCells, keys: FaceKeys) -> Int:
    """Return the numbers for faces listed by points, or raise MeshError for an unknown face."""
    offsets, points = loops_as_csr(faces)
    check_offsets(offsets, len(points), "face")
    known = (points >= 0) & (points < len(given.numbers))
    known[known] = given.numbers[points[known]] >= 0
    if not known.all():
        raise MeshError(f"{what}: no cell of this rank has point {points[np.argmin(known)]}")
    found = _found(face_keys(given.points[given.numbers[points]], offsets), keys)
    if len(found) and found.min() < 0:
        row = int(np.argmin(found))
        loop = points[offsets[row] : offsets[row + 1]].tolist()
        raise MeshError(f"{what}: no cell of this rank has a face with the points {loop}")
    return found


def _found(sought: FaceKeys, keys: FaceKeys) -> Int:
    """Look up each sought face among the keys, with -1 if missing."""
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


def _numbered(owner: Int, mine: NDArray[np.bool_], ranks: Ranks) -> Int:
    """Number the faces that belong to own cells in cell order, with -1 for other faces."""
    own = owner[mine]
    rank = np.arange(len(own)) - np.searchsorted(own, own)
    most = int(ranks.largest(float(rank.max(initial=0)))) + 1
    faces = np.full(len(owner), -1)
    faces[mine] = own * most + rank
    return frozen_int(faces)


def _from_owners(
    faces: Int,
    mine: NDArray[np.bool_],
    offsets: Int,
    vertices: Int,
    border: Int,
    beyond: Beyond,
    ranks: Ranks,
) -> tuple[Int, Int]:
    """Return numbers and points for all faces, received from other ranks for faces owned there."""
    parcels = {}
    for rank in distinct(beyond.ranks).tolist():
        told = np.flatnonzero((beyond.ranks == rank) & mine[border])
        at = border[told]
        parcels[rank] = beyond.faces[told], faces[at], vertices[gather(offsets, at)[1]]
    faces, vertices = faces.copy(), vertices.copy()
    for at, numbers, loops in ranks.exchanged(parcels).values():
        faces[at] = numbers
        vertices[gather(offsets, at)[1]] = loops
    return faces, vertices


def _sides(cells: Int, border: Int, beyond: Beyond, rank: int) -> tuple[Int, Int]:
    """Return both cells per face and their ranks, owner first."""
    sides, owners = cells.copy(), np.where(cells >= 0, rank, -1)
    sides[border, 1], owners[border, 1] = beyond.cells, beyond.ranks
    turned = border[beyond.cells < cells[border, 0]]
    sides[turned], owners[turned] = sides[turned, ::-1], owners[turned, ::-1]
    return sides, owners
