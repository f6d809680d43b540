"""Convert polygons with holes to single closed loops of vertices.

A bridge edge, traversed both ways, joins two boundary loops.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.mesh import Mesh


def single_loops(mesh: Mesh) -> tuple[Int, Int, Int]:
    """Return each cell as one closed loop of vertices, counter-clockwise, with the same area.

    Loops with a common vertex (a pinch) are joined there, others by a bridge between close vertices.

    Returns
    -------
    offsets : (n_cells + 1,) int
    vertices : int
    loops : (n_cells,) int
        Boundary loops per cell; for 1 the polygon is the boundary itself.

    Raises
    ------
    FileError
        If every possible bridge is an edge of the mesh.
    """
    boundary = mesh.boundary_loops
    loops = np.diff(boundary.cell_offsets)
    several = np.flatnonzero(loops > 1)
    if not len(several):
        return boundary.loop_offsets, boundary.vertices, frozen_int(loops)
    edges = _Edges(mesh)
    starts = boundary.loop_offsets[boundary.cell_offsets]
    pieces, sizes, position = [], np.diff(starts), 0
    for c in several.tolist():
        rows = range(boundary.cell_offsets[c], boundary.cell_offsets[c + 1])
        parts = [boundary.vertices[boundary.loop_offsets[i] : boundary.loop_offsets[i + 1]] for i in rows]
        ring = _join(mesh.local_points, parts, edges)
        if ring is None:
            raise FileError(f"cell {c} has {len(parts)} boundary loops that no free edge can join")
        pieces += [boundary.vertices[position : starts[c]], ring]
        position, sizes[c] = starts[c + 1], len(ring)
    vertices = np.concatenate([*pieces, boundary.vertices[position:]])
    return frozen_int(np.concatenate(([0], np.cumsum(sizes)))), frozen_int(vertices), frozen_int(loops)


class _Edges:
    """Edges that cannot join two loops: mesh edges, and edges that already join others."""

    def __init__(self, mesh: Mesh) -> None:
        self._n = mesh.n_points
        self._faces = np.sort(self._keys(mesh.face_pairs[:, 0], mesh.face_pairs[:, 1]))
        self._bridges: set[int] = set()

    def _keys(self, a: Int, b: Int) -> Int:
        return frozen_int(np.minimum(a, b) * self._n + np.maximum(a, b))

    def taken(self, a: Int, b: Int) -> NDArray[np.bool_]:
        keys = self._keys(a, b)
        place = np.minimum(np.searchsorted(self._faces, keys), len(self._faces) - 1)
        is_bridge = [key in self._bridges for key in keys.ravel().tolist()]
        return np.asarray((self._faces[place] == keys) | np.reshape(is_bridge, keys.shape))

    def add(self, a: int, b: int) -> None:
        self._bridges.add(min(a, b) * self._n + max(a, b))


def _join(points: Float, parts: list[Int], edges: _Edges) -> Int | None:
    """Join the boundary loops of a cell into one loop, by short edges (Prim's algorithm).

    Return None if no bridge is free.
    """
    vertices = np.concatenate(parts)
    part = np.repeat(np.arange(len(parts)), [len(loop) for loop in parts])
    near, distance = np.full(len(vertices), -1), np.full(len(vertices), np.inf)
    ring, newest = parts[0].tolist(), 0
    is_pending = part != 0
    while is_pending.any():
        # Update the distance of every pending vertex to the loops joined so far (Prim's algorithm).
        rows = np.flatnonzero(is_pending)
        anchor, gap = _nearest(points, frozen_int(vertices[rows]), parts[newest], edges)
        closer = gap < distance[rows]
        near[rows[closer]], distance[rows[closer]] = anchor[closer], gap[closer]
        # Insert the nearest loop at its closest vertex.
        best = int(rows[np.argmin(distance[rows])])
        if not np.isfinite(distance[best]):
            return None
        newest, a, b = int(part[best]), int(near[best]), int(vertices[best])
        loop = parts[newest].tolist()
        turn = loop.index(b)
        walk = loop[turn:] + loop[:turn]
        place = ring.index(a) + 1
        ring[place:place] = [*walk[1:], a] if a == b else [*walk, b, a]
        if a != b:
            edges.add(a, b)
        is_pending[part == newest] = False
    return frozen_int(ring)


def _nearest(points: Float, vertices: Int, loop: Int, edges: _Edges) -> tuple[Int, Float]:
    """Return for each of ``vertices`` the nearest vertex in ``loop`` that an edge may join to it."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points[loop])
    for k in (min(8, len(loop)), len(loop)):
        gap, place = tree.query(points[vertices], k=range(1, k + 1))
        anchor = loop[place]
        vertex = np.repeat(vertices[:, None], k, axis=1)
        is_coincident = (gap == 0) & (anchor != vertex)  # two coincident points: no edge between them
        gap = np.where(is_coincident | ((anchor != vertex) & edges.taken(anchor, vertex)), np.inf, gap)
        if np.isfinite(gap).any():
            break
    best = np.argmin(gap, axis=1)
    row = np.arange(len(vertices))
    return frozen_int(anchor[row, best]), gap[row, best]
