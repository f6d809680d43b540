"""Cell coordinates in which every cell has unit inertia, and mean values of data times monomials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, NamedTuple

import numpy as np

from agglo_core.authoring import Field, Float, Int, Mesh, MeshError, fields, frozen_float
from agglo_vem.monomials import count, exponents, monomials

_THIN: Final = 1e-12
"""Minimum ratio of the principal moments of inertia: thinner cells lose all digits."""
_EXTRA: Final = 4
"""Additional degree of quadrature rules for callables."""


class Corners(NamedTuple):
    """Corners of the polygons, loop by loop, in the order of ``mesh.boundary_loops``.

    A vertex that several loops of a cell visit is a corner of each.

    Attributes
    ----------
    offsets : (n_cells + 1,) int
    cells, vertices, following : (c,) int
        Cell and point of each corner, and number of the next corner of its loop.
    """

    offsets: Int
    cells: Int
    vertices: Int
    following: Int


@dataclass(frozen=True, eq=False)
class Frames:
    """Coordinates y = T (x − c) on each cell, with the centroid c and a lower triangular T.

    The mean of y yᵀ over the cell is the identity, so that monomials are well conditioned on elongated cells.
    """

    mesh: Mesh

    @cached_property
    def corners(self) -> Corners:
        """Corners of the polygons."""
        loops = self.mesh.boundary_loops
        offsets = loops.loop_offsets[loops.cell_offsets]
        following = np.arange(1, len(loops.vertices) + 1)
        following[loops.loop_offsets[1:] - 1] = loops.loop_offsets[:-1]
        cells = np.repeat(np.arange(self.mesh.n_cells), np.diff(offsets))
        return Corners(offsets, cells, loops.vertices, following)

    @cached_property
    def maps(self) -> Float:
        """Matrices T ``(n_cells, d, d)``.

        Raises
        ------
        MeshError
            For cells whose width vanishes to rounding.
        """
        mesh, dim = self.mesh, self.mesh.dim
        unit = np.broadcast_to(np.eye(dim), (mesh.n_cells, dim, dim)) / mesh.cell_diameters[:, None, None]
        second = self._means(unit, 2)[:, exponents(2, dim).sum(axis=1) == 2]
        inertia = np.zeros((mesh.n_cells, dim, dim))
        inertia[:, *np.triu_indices(dim)] = inertia.transpose(0, 2, 1)[:, *np.triu_indices(dim)] = second
        moments = np.linalg.eigvalsh(inertia)
        thin = np.flatnonzero(~(moments[:, 0] > _THIN * moments[:, -1]))
        if len(thin):
            raise MeshError(f"cells {thin[:5].tolist()} are too thin for virtual elements")
        lower = np.linalg.inv(np.linalg.cholesky(inertia))
        return frozen_float(lower / mesh.cell_diameters[:, None, None])

    def coordinates(self, cells: Int, points: Float) -> Float:
        """Return coordinates ``(q, d)`` of points relative to the mesh origin, in known ``cells (q,)``."""
        shifted = points - self.mesh.local_centroids[cells]
        return np.asarray(np.einsum("qab,qb->qa", self.maps[cells], shifted))

    def means(self, degree: int) -> Float:
        """Return the means ``(n_cells, m)`` of the monomials up to a degree over each cell, exactly."""
        return self._means(self.maps, degree)

    def weighted_means(self, field: Field, degree: int, name: str) -> Float:
        """Return the means ``(n_cells, m)`` of a field times the monomials up to a degree."""
        mesh = self.mesh
        if not callable(field):
            values = fields.per_cell(field, mesh.n_cells, name)
            return values[:, None] * self.means(degree)
        return self._by_quadrature(
            self.maps, degree, _EXTRA, lambda points: fields.sample(field, points, name)
        )

    def tensor_means(self, kappa: Any, degree: int) -> Float:
        """Return the means ``(n_cells, d, d, m)`` of a tensor or scalar field times monomials."""
        mesh, dim = self.mesh, self.mesh.dim
        if not isinstance(kappa, fields.Tensor):
            return np.eye(dim)[:, :, None] * self.weighted_means(kappa, degree, "kappa")[:, None, None]
        if kappa.by_cell:
            return np.asarray(kappa.field[..., None] * self.means(degree)[:, None, None])
        entries = np.empty((mesh.n_cells, dim, dim, count(degree, dim)))
        for i, j in zip(*np.triu_indices(dim), strict=True):
            entry = partial(lambda i, j, points: frozen_float(kappa.at(points, None)[:, i, j]), i, j)
            entries[:, i, j] = entries[:, j, i] = self.weighted_means(entry, degree, "kappa")
        return entries

    def _means(self, maps: Float, degree: int) -> Float:
        """Return the means ``(n_cells, m)`` of the monomials in coordinates with other ``maps``."""
        mesh, dim = self.mesh, self.mesh.dim
        if dim == 3:
            return self._by_quadrature(maps, degree)
        # A homogeneous polynomial of degree p has the integral ∮ m y·n / (p + 2) (divergence theorem).
        corners = self.corners
        cells = corners.cells
        shifted = mesh.local_points[corners.vertices] - mesh.local_centroids[cells]
        start = np.einsum("cab,cb->ca", maps[cells], shifted)
        end = start[corners.following]
        nodes, weights = fields.gauss(degree // 2 + 1)
        along = 0.5 * (1.0 + nodes)[:, None]
        values = monomials((1.0 - along) * start[:, None] + along * end[:, None], degree)
        cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
        integrals = np.einsum("q,cqm->cm", 0.5 * weights, values) * cross[:, None]
        sums = np.add.reduceat(integrals, corners.offsets[:-1]) / (exponents(degree, dim).sum(axis=1) + 2)
        sizes = mesh.cell_measures * np.linalg.det(maps)
        return np.asarray(sums / sizes[:, None])

    def _by_quadrature(
        self, maps: Float, degree: int, extra: int = 0, field: Callable[[Float], Float] | None = None
    ) -> Float:
        """Return means as :meth:`_means`, times a field, by a rule with ``extra`` degrees."""
        mesh, sums = self.mesh, np.zeros((self.mesh.n_cells, count(degree, self.mesh.dim)))
        for batch in fields.inside(mesh, degree + extra):
            shifted = batch.points - mesh.local_centroids[batch.cells]
            values = monomials(np.einsum("qab,qb->qa", maps[batch.cells], shifted), degree)
            weights = batch.weights if field is None else batch.weights * field(batch.points + mesh.origin)
            stop = batch.first + len(batch.offsets) - 1
            sums[batch.first : stop] = np.add.reduceat(weights[:, None] * values, batch.offsets[:-1])
        return np.asarray(sums / mesh.cell_measures[:, None])
