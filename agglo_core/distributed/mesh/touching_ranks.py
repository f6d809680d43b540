"""Detection of outer faces that coincide but are not shared: hanging vertices, also across ranks."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.meeting import refuse_all
from agglo_core.distributed.mesh.halo import faces_of, local_mesh
from agglo_core.distributed.mesh.whole_cells import WholeCells, merge_cells, parcels, places, take_cells
from agglo_core.mesh.construction.conforming import TOLERANCE, reach
from agglo_core.mesh.construction.touching import facing_pairs, find_contacts, outer_faces
from agglo_core.mesh.elements import gather

_log = logging.getLogger("agglo")


class _Rim(NamedTuple):
    """Outer faces and the indices of their cells in WholeCells, with bounding boxes."""

    faces: Int
    cells: Int
    low: Float  # (faces, d)
    high: Float


def refuse_hanging_vertices(own: WholeCells, ranks: Ranks) -> None:
    """Raise MeshError if outer faces, also of different ranks, overlap and share points.

    Bodies in contact without shared points are assumed to be separate on purpose, and reported by a warning.

    Parameters
    ----------
    own : WholeCells
        Own cells, with their neighbours on other ranks.

    Raises
    ------
    MeshError
        On all ranks, with two cells and their ranks.
    """
    # Contacts with shared points are an error on all ranks.
    near = cells_near(own, ranks)
    fault = None
    with ranks.together():
        pairs, hang = _contacts(near)
        if hang.any():
            cells = " and ".join(_describe_cell(near, cell) for cell in pairs[np.argmax(hang)])
            fault = (
                f"faces of {cells} coincide in part but are not equal, so the cells would "
                "not be neighbours: give both cells all points on the faces between them, "
                "or pass allow_gaps=True if the gap is intended"
            )
    refuse_all(ranks, fault)
    # Contacts without shared points are a warning of the first rank that has any.
    first = min((rank for rank, some in enumerate(ranks.gathered(len(pairs) > 0)) if some), default=-1)
    if ranks.rank == first:
        _log.warning(
            "outer faces, such as those of %s, coincide but share no points and are kept "
            "separate: the domain has a gap there. Pass allow_gaps=True if it is intended",
            " and ".join(_describe_cell(near, cell) for cell in pairs[0]),
        )


def outer_faces_touch(own: WholeCells, ranks: Ranks) -> bool:
    """Return True if outer faces overlap, also on different ranks, with or without shared points."""
    near = cells_near(own, ranks)
    with ranks.together():
        found = len(_contacts(near)[0]) > 0
    return any(ranks.gathered(found))


def _describe_cell(near: WholeCells, cell: int) -> str:
    return f"cell {near.cells[cell]} (rank {near.owners[cell]})"


def cells_near(own: WholeCells, ranks: Ranks) -> WholeCells:
    """Return this rank's cells with outer faces, and cells of other ranks that may touch them."""
    with ranks.together():
        rim = _rim(own)
        box = (rim.low.min(axis=0), rim.high.max(axis=0)) if len(rim.faces) else None
    boxes = ranks.gathered(box)
    with ranks.together():
        sent = _parcels(own, rim, boxes, ranks.rank)
    return merge_cells(
        list(ranks.exchanged(sent).values()) or [take_cells(own, frozen_int([]), frozen_int([]))]
    )


def _rim(whole: WholeCells) -> _Rim:
    """Return the outer faces with slightly enlarged bounding boxes."""
    faces = frozen_int(np.flatnonzero((whole.face_cells < 0).any(axis=1)))
    cells = places(whole.face_cells[faces].max(axis=1), whole.cells)
    if not len(faces):
        none = frozen_float(np.empty((0, whole.coordinates.shape[1])))
        return _Rim(faces, cells, none, none)
    offsets, entries = gather(whole.face_offsets, faces)
    points = whole.coordinates[whole.face_vertices[entries]]
    low = np.minimum.reduceat(points, offsets[:-1], axis=0)
    high = np.maximum.reduceat(points, offsets[:-1], axis=0)
    wider = TOLERANCE * (high - low).max(axis=1, keepdims=True)
    return _Rim(faces, frozen_int(cells), frozen_float(low - wider), frozen_float(high + wider))


def _parcels(
    whole: WholeCells, rim: _Rim, boxes: Sequence[tuple[Float, Float] | None], rank: int
) -> dict[int, WholeCells]:
    """Return the cells with outer faces to send to each rank whose bounding box they meet."""
    to, rim_cells = [], []
    for receiver, box in enumerate(boxes):
        if box is None or not len(rim.faces):
            continue
        within = (rim.low <= box[1]).all(axis=1) & (rim.high >= box[0]).all(axis=1)
        chosen = np.flatnonzero(within | (receiver == rank))
        to.append(np.full(len(chosen), receiver))
        rim_cells.append(rim.cells[chosen])
    if not to:
        return {}
    ends, cells = frozen_int(np.concatenate(to)), frozen_int(np.concatenate(rim_cells))
    rows, bounds = faces_of(whole)
    offsets, entries = gather(bounds, cells)
    faces = frozen_int(np.repeat(ends, np.diff(offsets))), frozen_int(rows[entries])
    return parcels(whole, (ends, cells), faces)


def _contacts(near: WholeCells) -> tuple[Int, Mask]:
    """Return cell pairs with overlapping outer faces, and mark the pairs with shared points."""
    if not len(near.cells):
        return frozen_int(np.empty((0, 2))), np.empty(0, bool)
    mesh, is_hidden = local_mesh(
        near, 0.5 * (near.coordinates.min(axis=0) + near.coordinates.max(axis=0)), ""
    )
    outer = outer_faces(mesh)
    owner = mesh.face_cells[outer.faces, 0]
    pairs = facing_pairs(outer)
    pairs = pairs[(owner[pairs[:, 0]] != owner[pairs[:, 1]]) & ~is_hidden[outer.faces[pairs]].any(axis=1)]
    contacts = find_contacts(outer, frozen_int(pairs), reach(mesh, outer, frozen_int(pairs), TOLERANCE)).pairs
    return frozen_int(owner[contacts]), _share_points(outer.offsets, outer.vertices, contacts)


def _share_points(offsets: Int, vertices: Int, pairs: Int) -> Mask:
    """Mark face pairs with a shared point."""
    (a, first), (b, second) = (gather(offsets, frozen_int(column)) for column in pairs.T)
    n = int(vertices.max(initial=0)) + 1
    row = np.repeat(np.arange(len(pairs)), np.diff(a))
    other = np.repeat(np.arange(len(pairs)), np.diff(b))
    both = np.intersect1d(row * n + vertices[first], other * n + vertices[second]) // n
    found = np.zeros(len(pairs), bool)
    found[both] = True
    return found
