"""Conforming meshes across ranks: coincident outer faces are joined.

Each rank treats the faces of its own cells, using the cells of other ranks that touch them. Both sides of
a face arrive at equal results, because a hanging vertex is a point that either side has.
"""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, Mask, frozen_int, trusted_copy
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.halo import common_origin, local_mesh
from agglo_core.distributed.mesh.touching_ranks import cells_near
from agglo_core.distributed.mesh.whole_cells import WholeCells, merge_cells, take_cells
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.mesh.construction.conforming import TOLERANCE, reach
from agglo_core.mesh.construction.touching import facing_pairs, find_contacts, outer_faces


def join_across_ranks(own: WholeCells, ranks: Ranks, name: str) -> Mesh | None:
    """Insert hanging vertices from all ranks into the faces of this rank's cells, and return their mesh.

    Parameters
    ----------
    own : WholeCells
        Own cells, with their neighbours on other ranks.
    ranks : Ranks
    name : str
        Mesh name.

    Returns
    -------
    Mesh or None
        Cells in unchanged order, or None without cells.

    Raises
    ------
    MeshError
        As :meth:`agglo_core.Mesh.conforming` (RankError on other ranks).
    """
    near, origin = cells_near(own, ranks), common_origin(own, ranks)
    with ranks.together():
        if not len(own.cells):
            return None
        # Close all faces that another rank has to treat, then join the rest.
        whole = merge_cells([own, near])
        mesh, is_hidden = local_mesh(whole, origin, name)
        is_own = whole.owners == ranks.rank
        shut = is_hidden | _foreign_faces(mesh, is_hidden, is_own)
        try:
            together = _close_faces(trusted_copy(mesh, cell_tags={}), shut).conforming(merge_points=True)
        except MeshError as error:
            raise MeshError(
                f"{error} (cell numbers count the cells of this rank and nearby cells of other ranks)"
            ) from None
        return _cells_of(together, own, whole, is_own)


def _close_faces(mesh: Mesh, faces: Mask) -> Mesh:
    """Make the given outer faces inner faces, by a dummy cell behind them."""
    sides = mesh.face_cells.copy()
    sides[faces, 1] = mesh.n_cells
    return trusted_copy(mesh, face_cells=frozen_int(sides))


def _foreign_faces(mesh: Mesh, is_hidden: Mask, is_own: Mask) -> Mask:
    """Mark outer faces in 3-D on other ranks that neither equal nor tile a face of this rank.

    Only the owner can split a large face, because some faces on top may be missing here. In 2-D each edge is
    cut at the points on the edge, regardless of other ranks.
    """
    shut = np.zeros(mesh.n_faces, bool)
    if mesh.dim == 2:
        return shut
    outer = outer_faces(_close_faces(mesh, is_hidden))
    owner = mesh.face_cells[outer.faces, 0]
    pairs = facing_pairs(outer)
    pairs = frozen_int(pairs[is_own[owner[pairs]].sum(axis=1) == 1])
    contacts = find_contacts(outer, pairs, reach(mesh, outer, pairs, TOLERANCE))
    is_foreign = ~is_own[owner[contacts.pairs]]
    shut[outer.faces[~is_own[owner]]] = True
    shut[outer.faces[contacts.pairs[is_foreign & (contacts.share > 1 - contacts.slack[:, None])]]] = False
    return shut


def _cells_of(mesh: Mesh, own_cells: WholeCells, whole: WholeCells, is_own: Mask) -> Mesh:
    """Extract this rank's cells, with their tags, from a mesh that contains cells of other ranks."""
    number = np.append(np.where(is_own, np.cumsum(is_own) - 1, -1), (-1, -1))  # dummy cell, and -1
    sides = frozen_int(number[mesh.face_cells])
    alone = WholeCells(
        frozen_int(np.arange(len(own_cells.cells))),
        own_cells.owners,
        own_cells.cell_tags,
        _numbers(mesh.n_faces),
        mesh.face_offsets,
        mesh.face_vertices,
        sides,
        sides,
        mesh.face_tags,
        _numbers(mesh.n_points),
        mesh.points,
    )
    faces = frozen_int(np.flatnonzero((sides >= 0).any(axis=1)))
    return local_mesh(take_cells(alone, alone.cells, faces), mesh.origin, mesh.name).mesh


def _numbers(n: int) -> Int:
    return frozen_int(np.arange(n))
