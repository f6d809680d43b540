"""Discontinuous polynomial basis: products of Legendre polynomials on the bounding box of each cell.

On cell K the basis is L_i(x̂) L_j(ŷ), i + j <= p: Legendre polynomials orthonormal on [−1, 1], with (x̂, ŷ)
in [−1, 1]² on the bounding box of K. They need no mapping, so K may be any polygon. In 3-D the basis is
L_i(x̂) L_j(ŷ) L_k(ẑ), i + j + k <= p, on any polyhedron K.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from agglo_core.authoring import Field, Float, Int, Mesh, OptionError, frozen_float, frozen_int, solvers
from agglo_core.fields.location import boxes_of_solids
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell
from agglo_core.threads import over_ranges
from agglo_polydg_mg.forms.sides import Sides, sides_of
from agglo_polydg_mg.space.polynomials import derivatives, legendre, n_polynomials, orders, products, slopes
from agglo_polydg_mg.space.quadrature import moments, weighted_moments

_FILL = 0.1
"""Box fraction below which a cell may have a rotated box. A smaller value leaves nearly dependent polynomials
on thin cells, a larger value rotates more boxes (benchmarks/solve.py --meshes random)."""


@dataclass(frozen=True, eq=False)
class Basis:
    """Basis of the discontinuous polynomials on the cells of a mesh.

    Cell c has the unknowns ``c * n_local … (c + 1) * n_local``.

    Attributes
    ----------
    mesh : Mesh
    degree : int
        p, 1..6.
    scaled : bool
        Divide by the square root of a quarter box area (an eighth box volume), so that the basis is
        orthonormal on the box itself, and in 2-D rotate the boxes of cells that fill less than a tenth of
        them: otherwise the polynomials are nearly linearly dependent. The paper does neither.

    Raises
    ------
    OptionError
        For a degree outside 1..6.
    """

    mesh: Mesh
    degree: int
    scaled: bool = False

    def __post_init__(self) -> None:
        solvers.require_count("degree", self.degree, 1, 6)

    @property
    def n_local(self) -> int:
        """Unknowns per cell: (p + 1)(p + 2) / 2, in 3-D times (p + 3) / 3."""
        return n_polynomials(self.degree, self.mesh.dim)

    @property
    def n(self) -> int:
        """Total number of unknowns."""
        return self.mesh.n_cells * self.n_local

    @cached_property
    def boxes(self) -> Float:
        """Bounding boxes ``(n_cells, 6)``: centre from the mesh origin, half sides, in 2-D a direction."""
        if self.mesh.dim == 3:
            return boxes_of_solids(self.mesh)
        from agglo_polydg_mg.space.legendre_kernels import bounding_boxes

        mesh, least = self.mesh, _FILL if self.scaled else 0.0
        points, (offsets, faces), areas = mesh.local_points, mesh.cell_faces, mesh.cell_measures

        def boxes(start: int, stop: int) -> Float:
            own, pairs = offsets[start : stop + 1], mesh.face_pairs
            found: Float = bounding_boxes(points, own, faces, pairs, areas[start:stop], least)
            return found

        return frozen_float(np.concatenate(over_ranges(boxes, mesh.n_cells)))

    @property
    def centres(self) -> Float:
        """Box centres ``(n_cells, d)``, relative to the mesh origin."""
        return self.boxes[:, : self.mesh.dim]

    @property
    def halves(self) -> Float:
        """Box half sides ``(n_cells, d)``."""
        return self.boxes[:, self.mesh.dim : 2 * self.mesh.dim]

    @cached_property
    def scale(self) -> Float:
        """Factor of the polynomials in each cell ``(n_cells,)``: 1 unless ``scaled``."""
        quarter = self.halves.prod(axis=1)
        return frozen_float(1 / np.sqrt(quarter) if self.scaled else np.ones(len(quarter)))

    @property
    def fill(self) -> Float:
        """Fraction of its bounding box that each cell fills ``(n_cells,)``."""
        return frozen_float(self.mesh.cell_measures / (2.0**self.mesh.dim * self.halves.prod(axis=1)))

    @property
    def directions(self) -> Float:
        """Matrices R ``(n_cells, d, d)`` with ∂/∂x_i = Σ_a R[i, a] ∂/∂x̂_a in box coordinates."""
        scaled = 1.0 / self.halves
        if self.mesh.dim == 3:
            return np.asarray(scaled[:, :, None] * np.eye(3))
        c, s = self.boxes[:, 4:].T
        rotations = np.stack((np.stack((c, -s), axis=1), np.stack((s, c), axis=1)), axis=1)
        return np.asarray(rotations * scaled[:, None, :])

    @cached_property
    def across(self) -> Int:
        """Cells sorted from left to right ``(n_cells,)``, so that a slice is a strip of the mesh."""
        return frozen_int(np.argsort(self.mesh.local_centroids[:, 0]))

    @cached_property
    def pattern(self) -> tuple[Int, Int, Int, Int]:
        """Block sparsity of a matrix that couples neighbours, see ``block_pattern`` in ``face_kernels``."""
        from agglo_polydg_mg.forms.face_kernels import block_pattern

        if self.mesh.dim == 3:
            incidences = self.sides.cell_offsets, self.sides.cell_sides, self.sides.cells
        else:
            incidences = *self.mesh.cell_faces, self.mesh.face_cells
        indptr, indices, diagonal, slots = block_pattern(*incidences)
        return frozen_int(indptr), frozen_int(indices), frozen_int(diagonal), frozen_int(slots)

    @cached_property
    def sides(self) -> Sides:
        """Cell sides in a 3-D mesh: one per pair of neighbours, however many faces they share."""
        return sides_of(self.mesh)

    @cached_property
    def _integrals(self) -> Float:
        """Integrals of the polynomials for source and stiffness terms, from :func:`moments`."""
        return frozen_float(moments(self.mesh, self.boxes, max(self.degree, 2 * self.degree - 2)))

    def weighted_moments(self, field: Field, degree: int, name: str) -> Float:
        """Integrate a field times each cell's polynomials, up to a degree.

        See :func:`~agglo_polydg_mg.space.quadrature.weighted_moments`. Integrals for numbers and cell
        values are cached. The degree is at most that of the basis or a product of two gradients.
        """
        if callable(field):
            return weighted_moments(self.mesh, field, self.boxes, degree, name)
        values, count = per_cell(field, self.mesh.n_cells, name), n_polynomials(degree, self.mesh.dim)
        if not values.any():
            return np.zeros((len(values), count))
        return np.asarray(self._integrals[:, :count] * values[:, None])

    def values(self, cells: Int, points: Float) -> Float:
        """Evaluate the basis functions ``(..., n_local)`` of cells at points relative to the mesh origin.

        ``cells (t,)`` have a point each, ``points (t, d)``, or several each, ``points (t, q, d)``.
        """
        cells, flat = _cell_per_point(cells, points)
        values = (self.on_reference(self._inside(cells, flat)) * self.scale[cells]).T
        return np.asarray(values.reshape(*points.shape[:-1], self.n_local))

    def on_reference(self, points: Float) -> Float:
        """Evaluate the orthonormal polynomials ``(n_local, q)`` at points ``(d, q)`` of the box [−1, 1]ᵈ."""
        return self._products([legendre(x, self.degree) for x in points])

    def gradients(self, cells: Int, points: Float) -> Float:
        """Evaluate the gradients ``(..., d, n_local)`` of the basis functions, as :meth:`values`."""
        cells, flat = _cell_per_point(cells, points)
        lines = [legendre(x, self.degree) for x in self._inside(cells, flat)]
        steep = [
            self._products([slopes(line) if at == axis else line for at, line in enumerate(lines)])
            for axis in range(len(lines))
        ]
        values = np.stack(steep) * self.scale[cells] / self.halves[cells].T[:, None]
        if self.mesh.dim == 2:
            (c, s), (slope_u, slope_v) = self.boxes[cells, 4:].T, values
            values = np.stack((c * slope_u - s * slope_v, s * slope_u + c * slope_v))
        return np.asarray(np.transpose(values, (2, 0, 1)).reshape(*points.shape, self.n_local))

    def _products(self, lines: list[Float]) -> Float:
        """Multiply polynomials ``(degree + 1, q)`` along the axes to basis functions ``(n_local, q)``."""
        first, *rest = (line[own] for line, own in zip(lines, orders(self.degree, len(lines)).T, strict=True))
        for each in rest:
            first = first * each
        return np.asarray(first)

    def _inside(self, cells: Int, points: Float) -> Float:
        """Map points to coordinates ``(d, q)`` in their cells' boxes, −1..1 inside."""
        if self.mesh.dim == 3:
            return np.asarray(((points - self.centres[cells]) / self.halves[cells]).T)
        box = self.boxes[cells]
        (x, y), (c, s) = (points - box[:, :2]).T, box[:, 4:].T
        return np.stack((c * x + s * y, c * y - s * x)) / box[:, 2:4].T

    def from_boxes(self, cells: Int, points: Float) -> Float:
        """Map points ``(q, d)`` of [−1, 1]ᵈ into the boxes of cells, ``(len(cells), q, d)``."""
        local = self.halves[cells, None] * points
        if self.mesh.dim == 2:
            (c, s), (x, y) = self.boxes[cells, 4:].T[:, :, None], np.moveaxis(local, 2, 0)
            local = np.stack((c * x - s * y, s * x + c * y), axis=2)
        return np.asarray(self.centres[cells, None] + local)

    def evaluate(self, x: Float, cells: Int, points: Float) -> Float:
        """Evaluate a function at points whose cells are known.

        Parameters
        ----------
        x : (n,) or (n_cells, ..., n_local) float
            Coefficients of a function, or of several such as the components of a vector.
        cells : (q,) int
        points : (q, d) float
            In user coordinates. They need not lie in the cells.

        Returns
        -------
        (q, ...) float
        """
        values = self.values(cells, np.asarray(points, float) - self.mesh.origin)
        return np.asarray(np.einsum("qk,q...k->q...", values, self.coefficients(x)[cells]))

    def gradient(self, x: Float, cells: Int, points: Float) -> Float:
        """Evaluate gradients ``(q, ..., d)`` at points, with arguments as of :meth:`evaluate`."""
        values = self.values(cells, np.asarray(points, float) - self.mesh.origin)
        return np.asarray(np.einsum("qk,q...k->q...", values, self.gradient_coefficients(x)[cells]))

    def gradient_coefficients(self, x: Float) -> Float:
        """Return the coefficients ``(n_cells, ..., d, n_local)`` of the gradient, arguments as above."""
        along = np.einsum("aij,c...j->c...ai", derivatives(self.degree, self.mesh.dim), self.coefficients(x))
        return np.asarray(np.einsum("cia,c...ak->c...ik", self.directions, along))

    def coefficients(self, x: Float) -> Float:
        """Return the vector ``x (n,)`` as ``(n_cells, n_local)``, or raise OptionError for a wrong length.

        Coefficients ``(n_cells, ..., n_local)`` are returned unchanged.
        """
        if np.ndim(x) > 1 and (len(x), np.shape(x)[-1]) == (self.mesh.n_cells, self.n_local):
            return x
        if np.shape(x) != (self.n,):
            raise OptionError(f"the vector has shape {np.shape(x)}, but this space has ({self.n},) unknowns")
        return np.reshape(x, (-1, self.n_local))

    def constants(self, values: Float) -> Float:
        """Return the coefficients ``(n,)`` of the piecewise constant function with ``values (n_cells,)``."""
        x = np.zeros((self.mesh.n_cells, self.n_local))
        x[:, 0] = 2.0 ** (0.5 * self.mesh.dim) * values / self.scale  # L₀ = √½
        return frozen_float(x.ravel())

    def project(self, function: Field | Callable[[Float], Float]) -> Float:
        """Return the L2 projection ``(n,)`` of a number, an array per cell or a callable."""
        load = self.weighted_moments(function, self.degree, "the function")
        load *= self.scale[:, None]
        return np.asarray(np.linalg.solve(self.mass_blocks, load[:, :, None]).ravel(), dtype=np.float64)

    @cached_property
    def mass_blocks(self) -> Float:
        """Mass matrix ∫ φ_i φ_j per cell ``(n_cells, n_local, n_local)``."""
        return self._mass_of(moments(self.mesh, self.boxes, 2 * self.degree))

    def weighted_mass(self, field: Callable[[Float], Float], name: str) -> Float:
        """Return the mass matrix with a callable as weight, per cell ``(n_cells, n_local, n_local)``."""
        return self._mass_of(weighted_moments(self.mesh, field, self.boxes, 2 * self.degree, name))

    def _mass_of(self, integrals: Float) -> Float:
        scaled = integrals * self.scale[:, None] ** 2
        return frozen_float(products([scaled], self.degree, [(0,) * self.mesh.dim]))

    def mass(self) -> sparse.bsr_array:
        """Return the block-diagonal mass matrix."""
        return block_diagonal(self.mass_blocks)


def _cell_per_point(cells: Int, points: Float) -> tuple[Int, Float]:
    """Return the cell of each point ``(q,)``, and the points ``(q, d)``."""
    each = points.shape[1] if points.ndim == 3 else 1
    return np.repeat(cells, each), points.reshape(-1, points.shape[-1])


def stiffness(basis: Basis, kappa: Field | Tensor) -> Float:
    """Return the stiffness matrix ∫ ∇φ_i·κ∇φ_j per cell ``(n_cells, n_local, n_local)``."""
    if isinstance(kappa, Tensor):
        return _tensor_stiffness(basis, kappa)
    integrals = basis.weighted_moments(kappa, 2 * basis.degree - 2, "kappa")
    integrals *= (basis.scale**2)[:, None]
    along = [integrals / half[:, None] ** 2 for half in basis.halves.T]
    once = [tuple(row) for row in np.eye(len(along), dtype=int).tolist()]
    return products(along, basis.degree, once)


def _entry_moments(basis: Basis, kappa: Tensor, row: int, column: int, degree: int) -> Float:
    """Integrate an entry of a callable tensor times polynomials up to a degree over each cell ``(n, m)``."""

    def entry(points: Float) -> Float:
        return kappa.at(points, None)[:, row, column]

    return weighted_moments(basis.mesh, entry, basis.boxes, degree, "kappa")


def _tensor_stiffness(basis: Basis, kappa: Tensor) -> Float:
    dim, degree = basis.mesh.dim, 2 * basis.degree - 2
    # 1. Moments of the entries, along the axes of the boxes
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    if kappa.by_cell:
        unit = basis.weighted_moments(1.0, degree, "kappa")
        entries = {(i, j): unit * kappa.field[:, i, j, None] for i, j in pairs}
    else:
        entries = {(i, j): _entry_moments(basis, kappa, i, j, degree) for i, j in pairs}
    if dim == 2:
        c, s = basis.boxes[:, 4:].T[:, :, None]
        xx, xy, yy = entries[0, 0], entries[0, 1], entries[1, 1]
        entries = {
            (0, 0): c * c * xx + 2.0 * c * s * xy + s * s * yy,
            (0, 1): c * s * (yy - xx) + (c * c - s * s) * xy,
            (1, 1): s * s * xx - 2.0 * c * s * xy + c * c * yy,
        }
    # 2. Products of the derivatives along two axes
    once = [tuple(row) for row in np.eye(dim, dtype=int).tolist()]
    scale, halves = (basis.scale**2)[:, None], basis.halves
    weights = [m * scale / (halves[:, i] * halves[:, j])[:, None] for (i, j), m in entries.items()]
    first, second = ([once[pair[at]] for pair in entries] for at in (0, 1))
    return products(weights, basis.degree, first, second)


def block_diagonal(blocks: Float) -> sparse.bsr_array:
    """Return the block-diagonal matrix of ``blocks (n, m, m)``."""
    n, m, _ = blocks.shape
    return one_per_row(blocks, frozen_int(np.arange(n)), (n * m, n * m))


def one_per_row(blocks: Float, columns: Int, shape: tuple[int, int]) -> sparse.bsr_array:
    """Return a block matrix with one of the blocks ``(n, m, w)`` in each row, in ``columns (n,)``."""
    indptr = np.arange(len(blocks) + 1, dtype=np.int32)
    return sparse.bsr_array((blocks, np.asarray(columns, np.int32), indptr), shape=shape)
