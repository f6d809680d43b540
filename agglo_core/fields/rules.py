"""Quadrature points inside the cells of a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.fields.gauss_points import simplex_rule
from agglo_core.fields.simplices import tetrahedra_of_solids, triangulate
from agglo_core.mesh import Mesh

# Quadrature points per batch, which fits into the processor cache (benchmarks/constants.py)
_POINTS = 200_000


class Batch(NamedTuple):
    """Quadrature points of the cells ``first … first + n``.

    ``offsets (n + 1,)`` index the points; ``points (q, d)`` are relative to the mesh origin;
    ``weights (q,)`` sum to areas or volumes.
    """

    first: int
    offsets: Int
    points: Float
    weights: Float

    @property
    def cells(self) -> Int:
        """Cell of each point ``(q,)``."""
        sizes = np.diff(self.offsets)
        return frozen_int(self.first + np.repeat(np.arange(len(sizes)), sizes))


def batches(offsets: Int, most: int) -> Iterator[tuple[int, int]]:
    """Yield ranges ``first … stop`` of lists with at most ``most`` items together, but at least one list.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.fields.rules import batches
    >>> list(batches(np.array([0, 2, 4, 9, 10]), 4))
    [(0, 2), (2, 3), (3, 4)]
    """
    first = 0
    while first < len(offsets) - 1:
        stop = max(first + 1, int(np.searchsorted(offsets, offsets[first] + most, "right")) - 1)
        yield first, stop
        first = stop


def inside(mesh: Mesh, degree: int) -> Iterator[Batch]:
    """Yield quadrature points inside the cells, exact up to a degree, in batches of cells.

    Raises
    ------
    MeshError
        See :func:`~agglo_core.fields.simplices.triangulate`.
    """
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else tetrahedra_of_solids(mesh)
    reference, weights = simplex_rule(mesh.dim, degree // 2 + 1)
    ends = offsets * len(weights)
    for first, stop in batches(ends, _POINTS):
        chosen = corners[offsets[first] : offsets[stop]]
        edges = chosen[:, 1:] - chosen[:, :1]
        points = chosen[:, None, 0]
        for axis in range(mesh.dim):
            points = points + reference[:, axis : axis + 1] * edges[:, axis : axis + 1]
        yield Batch(
            first,
            frozen_int(ends[first : stop + 1] - ends[first]),
            frozen_float(points.reshape(-1, mesh.dim)),
            frozen_float((_determinants(edges)[:, None] * weights).ravel()),
        )


def _determinants(edges: Float) -> Float:
    """Return the determinants ``(t,)`` of the edges ``(t, d, d)`` from the first corner of each simplex."""
    u, v = edges[:, 0], edges[:, 1]
    if edges.shape[1] == 2:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.asarray((np.cross(u, v) * edges[:, 2]).sum(axis=1))
