"""Second layer of ghosts, for computations that need the neighbours of ghosts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.distributed.mesh.halo import all_cells, local_mesh, part_of_whole
from agglo_core.distributed.mesh.whole_cells import WholeCells, merge_cells, places, take_cells
from agglo_core.distributed.solution.kinds_of_all import kinds_of_all
from agglo_core.mesh import Mesh


class _Seen(NamedTuple):
    """A rank's cells and ghosts, and a mark ``(n_faces,)`` on faces to cells outside."""

    cells: WholeCells
    hidden: Mask


def with_second_layer(mesh: DistributedMesh) -> tuple[Mesh, Int]:
    """Return a rank's cells and two layers of ghosts as a mesh, with increasing global ids. Collective.

    Here ghosts have all their neighbours, as needed for penalties at a face that depend on all faces of both
    cells. ``outer_faces`` excludes faces to cells outside this mesh. The kinds of cells and boundary faces
    are those of the whole mesh, so that problems defined by tag fit every rank.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.distributed import DistributedMesh
    >>> with_second_layer(DistributedMesh.scatter(samples.squares(2)))[1].tolist()
    [0, 1, 2, 3]
    """
    ranks, local = mesh.ranks, mesh.local
    # Exchange the neighbourhoods of the ghosts.
    with ranks.together():
        view = _Seen(
            all_cells(local, mesh.global_ids, mesh.owners, mesh.point_ids, mesh.face_ids), mesh.hidden
        )
        parcels = {
            rank: _add_neighbours(view, mesh.own[cells]) for rank, cells in mesh.ghosts_elsewhere.items()
        }
    views, kinds = [view, *ranks.exchanged(parcels).values()], kinds_of_all(mesh)
    with ranks.together():
        # prefer the copy of a face from a rank with both of its sides
        whole = [
            take_cells(cells, frozen_int(np.arange(len(cells.cells))), _positions(~hidden))
            for cells, hidden in views
        ]
        faces = [take_cells(cells, frozen_int([]), _positions(hidden)) for cells, hidden in views]
        every = merge_cells(whole + faces)
        union_mesh, cut = local_mesh(every, local.origin, local.name)
        # Faces known from one side only are hidden.
        is_whole = np.isin(every.faces, np.concatenate([piece.faces for piece in whole]))
        part = part_of_whole(union_mesh, local.origin, cut | ~is_whole)
        part.__dict__.update(cell_kinds=kinds[0], boundary_kinds=kinds[1])  # cached properties
        return part, every.cells


def _add_neighbours(view: _Seen, cells: Int) -> _Seen:
    """Return the given cells together with their neighbours."""
    sides = places(view.cells.face_cells, view.cells.cells)
    chosen, near = np.zeros((2, len(view.cells.cells) + 1), bool)
    chosen[cells] = True
    near[sides[chosen[sides].any(axis=1)]] = True
    near[-1] = False  # cells outside
    faces = _positions(near[sides].any(axis=1))
    return _Seen(take_cells(view.cells, _positions(near[:-1]), faces), view.hidden[faces])


def _positions(mask: NDArray[Any] | np.bool_) -> Int:
    return frozen_int(np.flatnonzero(mask))
