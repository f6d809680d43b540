"""Remove repeated consecutive vertices, as in closed or padded loops and collapsed elements."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.mesh.elements import Polyhedra, gather


def simple_loops(offsets: Int, vertices: Int) -> tuple[Int, Int]:
    """Remove from vertex loops (CSR) each vertex that equals its cyclic successor.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.mesh.construction.repeated_vertices import simple_loops
    >>> offsets, vertices = simple_loops(np.array([0, 4, 9]), np.array([0, 1, 2, 0, 3, 4, 5, 5, 5]))
    >>> offsets.tolist(), vertices.tolist()
    ([0, 3, 6], [0, 1, 2, 3, 4, 5])
    """
    used = np.diff(offsets) > 0
    following = np.roll(vertices, -1)
    following[offsets[1:][used] - 1] = vertices[offsets[:-1][used]]
    kept = vertices != following
    place = np.concatenate(([0], np.cumsum(kept)))
    return frozen_int(place[offsets]), frozen_int(vertices[kept])


def simple_solids(solids: Polyhedra) -> Polyhedra:
    """Remove repeated consecutive vertices from polyhedra, and the faces that thus lose their area.

    Faces with fewer than three vertices are dropped. In changed cells, pairs of faces with equal vertices
    (the two sides of a part without thickness) are also dropped.
    """
    loop_offsets, vertices = simple_loops(solids.loop_offsets, solids.vertices)
    cell = np.repeat(np.arange(len(solids.cell_offsets) - 1), np.diff(solids.cell_offsets))
    sizes = np.diff(loop_offsets)
    changed = np.zeros(len(solids.cell_offsets) - 1, bool)
    changed[cell[sizes < np.diff(solids.loop_offsets)]] = True
    keep = sizes >= 3
    # In changed cells, find the pairs of faces with equal vertices.
    for size in np.unique(sizes[keep & changed[cell]]):
        loops = np.flatnonzero((sizes == size) & changed[cell])
        rows = np.sort(vertices[loop_offsets[loops][:, None] + np.arange(size)], axis=1)
        _, group, count = np.unique(
            np.column_stack((cell[loops], rows)), axis=0, return_inverse=True, return_counts=True
        )
        keep[loops[count[group.ravel()] == 2]] = False
    remaining = frozen_int(np.flatnonzero(keep))
    new, places = gather(loop_offsets, remaining)
    counts = np.bincount(cell[remaining], minlength=len(changed))
    return Polyhedra(frozen_int(np.concatenate(([0], np.cumsum(counts)))), new, frozen_int(vertices[places]))
