"""Consistency checks for a distributed mesh on all ranks."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.meeting import refuse_all
from agglo_core.distributed.mesh.halo import LocalMesh, ghosts, local_mesh
from agglo_core.distributed.mesh.shared import check_ids
from agglo_core.distributed.mesh.whole_cells import WholeCells, distinct, merge_cells, take_cells


def check_laws(own: WholeCells, known: Int, owners: Int, held: LocalMesh, n_cells: int, ranks: Ranks) -> None:
    """Raise MeshError on all ranks unless each cell has one owner and ghosts agree with their owners.

    Parameters
    ----------
    own : WholeCells
        Own cells, the reference for ghosts on other ranks.
    known, owners : (n,) int
        Global ids and owners, for own cells and ghosts.
    held : LocalMesh
        Local mesh with own cells and ghosts.
    n_cells : int
        Number of cells in the whole mesh.
    """
    rank_name = f"rank {ranks.rank}"
    # Every cell has one owner, and local cells are in global order.
    counts = ranks.gathered(len(own.cells))
    if sum(counts) != n_cells:
        refuse_all(ranks, f"the ranks own {counts} cells, but the mesh has {n_cells}")
    order = np.flatnonzero(np.diff(known) <= 0)
    refuse_all(ranks, f"{rank_name}: cell {known[order[0] + 1]} is out of order" if len(order) else None)
    check_ids(own.cells, n_cells, ranks)
    # Border faces agree with each neighbour rank.
    parts = ghosts(own, ranks)
    faults = [_border(own, part, int(part.owners[0]), ranks.rank) for part in parts]
    partners = [-1, ranks.rank, *(int(part.owners[0]) for part in parts)]
    silent = [rank for rank in distinct(own.face_owners).tolist() if rank not in partners]
    faults += [f"rank {rank} has no border faces for its neighbours on this rank" for rank in silent]
    refuse_all(ranks, next((f"{rank_name}: {fault}" for fault in faults if fault), None))
    # Ghosts are the true neighbours, with the geometry and tags of their owners.
    whole = merge_cells([own, *parts])
    fault = _same_cells(known, owners, whole)
    refuse_all(ranks, f"{rank_name}: {fault}" if fault else None)
    fault = _same_mesh(held, local_mesh(whole, held.mesh.origin, ""), known)
    refuse_all(ranks, f"{rank_name}: {fault}" if fault else None)


def _border(cells: WholeCells, part: WholeCells, sender: int, rank: int) -> str | None:
    """Describe the first difference at faces between this rank and the sender of ``part``.

    None if both ranks agree.
    """
    none = frozen_int([])
    own_side = take_cells(cells, none, frozen_int(np.flatnonzero((cells.face_owners == sender).any(axis=1))))
    other_side = take_cells(part, none, frozen_int(np.flatnonzero((part.face_owners == rank).any(axis=1))))
    unmatched = np.setxor1d(own_side.faces, other_side.faces)
    if len(unmatched):
        side, elsewhere = (own_side, sender) if unmatched[0] in own_side.faces else (other_side, rank)
        a, b = side.face_cells[np.searchsorted(side.faces, unmatched[0])].tolist()
        return f"cells {a} and {b} share a face that is missing on rank {elsewhere}"
    for name in ("face_offsets", "face_vertices", "face_cells", "face_owners", "points", "coordinates"):
        if not np.array_equal(getattr(own_side, name), getattr(other_side, name)):
            return f"{name} between its cells and those of rank {sender} differ on that rank"
    for name, values in own_side.face_tags.items():
        if not np.array_equal(values, other_side.face_tags[name]):
            return f"face tag {name!r} between its cells and those of rank {sender} differs on that rank"
    return None


def _same_cells(ids: Int, owners: Int, whole: WholeCells) -> str | None:
    missing, surplus = np.setdiff1d(whole.cells, ids), np.setdiff1d(ids, whole.cells)
    if len(missing):
        return f"cell {missing[0]} is missing among the ghosts"
    if len(surplus):
        return f"ghost cell {surplus[0]} is not a neighbour of an own cell"
    wrong = np.flatnonzero(owners != whole.owners)
    if len(wrong):
        cell, listed_owner, owner = (int(array[wrong[0]]) for array in (ids, owners, whole.owners))
        return f"cell {cell} is listed on rank {listed_owner}, but is on rank {owner}"
    return None


def _same_mesh(local: LocalMesh, expected: LocalMesh, ids: Int) -> str | None:
    """Describe the first cell with faces, points or tags that differ from its owner's.

    None if all are equal.
    """
    mesh, truth = local.mesh, expected.mesh
    for name, values in truth.cell_tags.items():
        wrong = np.flatnonzero(mesh.cell_tags[name] != values)
        if len(wrong):
            return f"cell {ids[wrong[0]]} has a tag {name!r} that differs from its owner's"
    if not np.array_equal(mesh.face_offsets, truth.face_offsets):
        return (
            f"the mesh has {mesh.n_faces} faces, but the cells have {truth.n_faces}, or faces of other sizes"
        )
    differ = (mesh.face_cells != truth.face_cells).any(axis=1) | (local.hidden != expected.hidden)
    for name, values in truth.face_tags.items():
        differ |= mesh.face_tags[name] != values
    moved_points = (mesh.points[mesh.face_vertices] != truth.points[truth.face_vertices]).any(axis=1)
    differ[np.repeat(np.arange(mesh.n_faces), np.diff(mesh.face_offsets))[moved_points]] = True
    if differ.any():
        return f"a face of cell {ids[truth.face_cells[np.argmax(differ), 0]]} differs from its owner's"
    return None
