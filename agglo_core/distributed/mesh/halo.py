"""Ghosts (face neighbours on other ranks), and the mesh of a rank's cells and ghosts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_float, frozen_int, trusted
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.whole_cells import WholeCells, distinct, parcels, places, take_cells
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather


class LocalMesh(NamedTuple):
    """Mesh of a rank's cells and ghosts. ``hidden (n_faces,)`` marks faces to cells outside the mesh."""

    mesh: Mesh
    hidden: Mask


def ghosts(own: WholeCells, ranks: Ranks) -> list[WholeCells]:
    """Send this rank's border cells to neighbour ranks, and return the received ghosts by owner.

    No request is needed, because the ranks on both sides of a face are known on both.
    """
    sides = own.face_owners
    border = np.flatnonzero(((sides != ranks.rank) & (sides >= 0)).any(axis=1))
    own_side = (sides[border, 1] == ranks.rank).astype(np.int64)  # the side of border faces that is own
    cells = places(own.face_cells[border, own_side], own.cells)
    near = _restrict_to_cells(own, distinct(cells))
    to, positions = sides[border, 1 - own_side], places(own.cells[cells], near.cells)
    rows, ends = faces_of(near)
    offsets, entries = gather(ends, positions)
    faces = frozen_int(np.repeat(to, np.diff(offsets))), frozen_int(rows[entries])
    return list(ranks.exchanged(parcels(near, (to, positions), faces)).values())


def _restrict_to_cells(whole: WholeCells, cells: Int) -> WholeCells:
    """Return only the cells with the given indices, with their faces and points."""
    chosen = np.zeros(len(whole.cells) + 1, bool)
    chosen[cells] = True
    faces = chosen[places(whole.face_cells, whole.cells)].any(axis=1)
    return take_cells(whole, cells, frozen_int(np.flatnonzero(faces)))


def faces_of(whole: WholeCells) -> tuple[Int, Int]:
    """Return the faces of each cell as a CSR list: faces cell by cell, and offsets ``(n + 1,)``."""
    sides = places(whole.face_cells, whole.cells).ravel()
    order = np.argsort(sides, kind="stable")
    ends = np.searchsorted(sides[order], np.arange(len(whole.cells) + 1))
    return frozen_int(order // 2), frozen_int(ends)


def own_cells(
    mesh: Mesh, global_ids: Int, owners: Int, point_ids: Int, face_ids: Int, rank: int
) -> WholeCells:
    """Return the cells of a local mesh that the rank owns, without ghosts."""
    everything = all_cells(mesh, global_ids, owners, point_ids, face_ids)
    cells = np.flatnonzero(owners == rank)
    faces = np.flatnonzero((everything.face_owners == rank).any(axis=1))
    return take_cells(everything, frozen_int(cells), frozen_int(faces))


def all_cells(mesh: Mesh, global_ids: Int, owners: Int, point_ids: Int, face_ids: Int) -> WholeCells:
    """Return all local mesh cells, including ghosts, with neighbour -1 at faces to cells outside."""
    sides = mesh.face_cells
    rank_of = np.append(owners, -1)
    number = np.append(global_ids, -1)
    return WholeCells(
        global_ids,
        owners,
        mesh.cell_tags,
        face_ids,
        mesh.face_offsets,
        mesh.face_vertices,
        frozen_int(number[sides]),
        frozen_int(rank_of[sides]),
        mesh.face_tags,
        point_ids,
        mesh.points,
    )


def local_mesh(whole: WholeCells, origin: Float, name: str) -> LocalMesh:
    """Build a mesh from a rank's cells and ghosts, and mark the faces to cells outside.

    A ghost face to a cell outside the mesh becomes an outer face without tags. If the missing cell owns the
    face, the loop is reversed, because the owner must be in the mesh. Own cells are not affected: all their
    neighbours are in the mesh.
    """
    sides = places(whole.face_cells, whole.cells)
    is_hidden: Mask = np.asarray(((sides < 0) & (whole.face_cells >= 0)).any(axis=1))
    turned = sides[:, 0] < 0
    mesh = trusted(
        Mesh,
        whole.coordinates,
        whole.face_offsets,
        _turn_faces(whole.face_offsets, whole.face_vertices, turned),
        frozen_int(np.where(turned[:, None], sides[:, ::-1], sides)),
        cell_tags=whole.cell_tags,
        face_tags={key: np.where(is_hidden, 0, values) for key, values in whole.face_tags.items()},
        name=name,
    )
    return LocalMesh(part_of_whole(mesh, origin, is_hidden), is_hidden)


def part_of_whole(mesh: Mesh, origin: Float, hidden: Mask) -> Mesh:
    """Set the local mesh properties that depend on the global mesh: its origin and boundary.

    With the whole mesh's centre as origin, geometry is equal on any number of ranks. Hidden faces do not
    belong to the boundary.
    """
    mesh.__dict__["origin"] = origin
    mesh.__dict__["outer_faces"] = frozen((mesh.face_cells[:, 1] < 0) & ~hidden, np.bool_)
    return mesh


def _turn_faces(offsets: Int, vertices: Int, turned: Mask) -> Int:
    if not turned.any():
        return vertices
    sizes = np.diff(offsets)
    position = np.arange(len(vertices))
    mirrored = np.repeat(offsets[:-1] + offsets[1:] - 1, sizes) - position
    return frozen_int(vertices[np.where(np.repeat(turned, sizes), mirrored, position)])


def common_origin(own: WholeCells, ranks: Ranks) -> Float:
    """Return the centre ``(d,)`` of the bounding box of all cells on all ranks."""
    x = own.coordinates
    box = [(column.min(initial=np.inf), column.max(initial=-np.inf)) for column in x.T]
    boxes = np.array(ranks.gathered(np.array(box)))  # (size, d, 2)
    return frozen_float(0.5 * (boxes[:, :, 0].min(axis=0) + boxes[:, :, 1].max(axis=0)))
