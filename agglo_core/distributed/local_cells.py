"""Cells that each rank gives by itself, joined to one mesh across the ranks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.given_cells import GivenCells
from agglo_core.distributed.shared_faces import Beyond, FaceKeys, cells_beyond, face_keys
from agglo_core.distributed.shared_points import shared_points
from agglo_core.distributed.whole_cells import WholeCells, places
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import whole_numbers
from agglo_core.mesh.elements import gather
from agglo_core.mesh.polygons import loops_as_csr

__all__ = ["FaceTags", "across_ranks"]

FaceTags = Mapping[str, tuple[Any, ArrayLike]]
"""For each name faces, lists of their points, and their values."""


def across_ranks(given: GivenCells, face_tags: FaceTags | None, ranks: Ranks) -> WholeCells:
    """The cells of this rank, their faces numbered and oriented as if all cells had been given in one place.

    A face belongs to the one of its cells with the smaller global id; faces follow the cells that they
    belong to, in the order of the faces of each.
    """
    mesh = given.mesh
    vertices, offsets = given.points[mesh.face_vertices], mesh.face_offsets
    keys = face_keys(vertices, offsets)
    names = sorted(set().union(*ranks.gathered(set(face_tags or {}))))
    with ranks.together():
        tags = _listed_tags(face_tags or {}, names, given, keys)
    shared = shared_points(given.points, mesh.points, ranks)[mesh.face_vertices]
    near = np.flatnonzero(np.logical_and.reduceat(shared, offsets[:-1]) if mesh.n_faces else shared)
    cells = np.append(given.cells, -1)[mesh.face_cells]
    beyond = cells_beyond(vertices, offsets, keys, frozen_int(cells), tags, frozen_int(near), ranks)
    tags = np.where(tags != 0, tags, beyond.tags)
    mine = (beyond.cells < 0) | (cells[:, 0] < beyond.cells)
    faces = _numbered(cells[:, 0], mine, ranks)
    faces, vertices = _from_owners(faces, mine, offsets, vertices, beyond, ranks)
    sides, owners = _sides(cells, beyond, ranks.rank)
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
    face_tags: FaceTags, names: list[str], given: GivenCells, keys: FaceKeys
) -> NDArray[np.int64]:
    """Tags ``(n_faces, len(names))`` of faces given by their points; 0 on those that are not listed."""
    tags = np.zeros((len(keys.low), len(names)), np.int64)
    for name, (faces, values) in face_tags.items():
        offsets, vertices = loops_as_csr(faces)
        said = whole_numbers(values, f"face tag {name!r}")
        if len(said) != len(offsets) - 1:
            raise MeshError(f"face tag {name!r} lists {len(offsets) - 1} faces, but {len(said)} values")
        if len(vertices) and (vertices.min() < 0 or vertices.max() >= len(given.numbers)):
            raise MeshError(f"face tag {name!r} uses points outside 0..{len(given.numbers) - 1}")
        numbers = given.numbers[vertices]
        found = _found(face_keys(np.append(given.points, -1)[numbers], offsets), keys)
        if len(found) and found.min() < 0:
            row = int(np.argmin(found))
            loop = vertices[offsets[row] : offsets[row + 1]].tolist()
            raise MeshError(f"face tag {name!r}: no cell of this rank has a face with the points {loop}")
        tags[found, names.index(name)] = said
        if (tags[found, names.index(name)] != said).any():
            raise MeshError(f"face tag {name!r} lists a face twice, with different values")
    return tags


def _found(sought: FaceKeys, keys: FaceKeys) -> Int:
    """Place of each face among those with these keys, or -1."""
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
    """Numbers of the faces that belong to own cells, -1 for others; they come in the order of these cells."""
    own = owner[mine]
    rank = np.arange(len(own)) - np.searchsorted(own, own)
    most = int(ranks.largest(float(rank.max(initial=0)))) + 1
    faces = np.full(len(owner), -1)
    faces[mine] = own * most + rank
    return frozen_int(faces)


def _from_owners(
    faces: Int, mine: NDArray[np.bool_], offsets: Int, vertices: Int, beyond: Beyond, ranks: Ranks
) -> tuple[Int, Int]:
    """Numbers and points of all faces: where a face belongs to a cell of another rank, as they are there."""
    parcels = {}
    for rank in np.unique(beyond.ranks[beyond.ranks >= 0]).tolist():
        told = frozen_int(np.flatnonzero((beyond.ranks == rank) & mine))
        parcels[rank] = beyond.faces[told], faces[told], vertices[gather(offsets, told)[1]]
    faces, vertices = faces.copy(), vertices.copy()
    for at, numbers, loops in ranks.exchanged(parcels).values():
        faces[at] = numbers
        vertices[gather(offsets, at)[1]] = loops
    return faces, vertices


def _sides(cells: Int, beyond: Beyond, rank: int) -> tuple[Int, Int]:
    """Both cells of each face and the ranks that have them, the owner first."""
    sides, owners = cells.copy(), np.where(cells >= 0, rank, -1)
    far = beyond.cells >= 0
    sides[far, 1], owners[far, 1] = beyond.cells[far], beyond.ranks[far]
    turned = far & (beyond.cells < cells[:, 0])
    sides[turned], owners[turned] = sides[turned, ::-1], owners[turned, ::-1]
    return sides, owners
