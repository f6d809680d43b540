"""Polynomials of each cell.

On cell K the basis is L_i(x̂) L_j(ŷ), i + j <= p: Legendre polynomials orthonormal on [−1, 1], (x̂, ŷ)
running over [−1, 1]² in the bounding box of K. They need no mapping, so K may be any polygon.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Field,
    Float,
    Int,
    Mesh,
    MeshError,
    OptionError,
    frozen_float,
    frozen_int,
    over_ranges,
)
from agglo_polydg_mg.option_checks import require_count
from agglo_polydg_mg.quadrature import gauss, moments, per_cell, weighted_moments

__all__ = ["Basis", "block_diagonal", "legendre", "one_per_row", "orders", "products", "slopes", "stiffness"]


_FILL = 0.1
"""A cell that fills less of its bounding box may have one that is turned."""


@cache
def orders(degree: int) -> Int:
    """Degrees ``(m, 2)`` in x and y of the polynomials of a cell, by total degree."""
    return frozen_int([(total - j, j) for total in range(degree + 1) for j in range(total + 1)])


def legendre(x: Float, degree: int) -> Float:
    """Orthonormal Legendre polynomials 0..degree at ``x (q,)``, shape ``(degree + 1, q)``."""
    values = np.empty((degree + 1, *np.shape(x)))
    before, value = np.zeros_like(x), np.ones_like(x)
    for k in range(degree + 1):
        values[k] = value * np.sqrt(k + 0.5)
        before, value = value, ((2 * k + 1) * x * value - k * before) / (k + 1)
    return values


def slopes(values: Float) -> Float:
    """Derivatives of the polynomials ``values (degree + 1, q)``: P'_{k+1} = P'_{k−1} + (2k + 1) P_k."""
    result = np.zeros_like(values)
    for k in range(len(values) - 1):
        below = result[k - 1] / np.sqrt(k - 0.5) if k else 0.0
        result[k + 1] = (below + 2 * np.sqrt(k + 0.5) * values[k]) * np.sqrt(k + 1.5)
    return result


@dataclass(frozen=True, eq=False)
class Basis:
    """Discontinuous polynomials of a degree on the cells of a 2-D mesh.

    The unknowns of cell c are ``c * n_local … (c + 1) * n_local``.

    Attributes
    ----------
    mesh : Mesh
    degree : int
        p, 1..6.
    scaled : bool
        Divide by the square root of the box's quarter area, so that the basis is orthonormal on the
        box itself, and turn the boxes of cells that fill less than a tenth of theirs: otherwise the
        polynomials are linearly dependent, nearly. The paper's basis is neither.

    Raises
    ------
    MeshError, OptionError
        For a mesh in 3-D, a degree outside 1..6.
    """

    mesh: Mesh
    degree: int
    scaled: bool = False

    def __post_init__(self) -> None:
        if self.mesh.dim != 2:
            raise MeshError(f"PolyDG takes 2-D meshes; given {self.mesh!r}")
        require_count("degree", self.degree, 1, 6)

    @property
    def n_local(self) -> int:
        """Unknowns of a cell, (p + 1)(p + 2) / 2."""
        return (self.degree + 1) * (self.degree + 2) // 2

    @property
    def n(self) -> int:
        """All unknowns."""
        return self.mesh.n_cells * self.n_local

    @cached_property
    def boxes(self) -> Float:
        """Bounding boxes ``(n_cells, 6)``: centre from the mesh's origin, half sides, direction of one."""
        from agglo_polydg_mg.legendre_kernels import bounding_boxes

        mesh, least = self.mesh, _FILL if self.scaled else 0.0
        points, (offsets, faces), areas = mesh.local_points, mesh.cell_faces, mesh.cell_measures

        def boxes(start: int, stop: int) -> Float:
            own, pairs = offsets[start : stop + 1], mesh.face_pairs
            found: Float = bounding_boxes(points, own, faces, pairs, areas[start:stop], least)
            return found

        return frozen_float(np.concatenate(over_ranges(boxes, mesh.n_cells)))

    @cached_property
    def scale(self) -> Float:
        """Factor of the polynomials of each cell ``(n_cells,)``: 1 unless ``scaled``."""
        quarter = self.boxes[:, 2] * self.boxes[:, 3]
        return frozen_float(1 / np.sqrt(quarter) if self.scaled else np.ones(len(quarter)))

    @property
    def fill(self) -> Float:
        """Part of its box that each cell fills ``(n_cells,)``."""
        return frozen_float(self.mesh.cell_measures / (4.0 * self.boxes[:, 2] * self.boxes[:, 3]))

    @cached_property
    def across(self) -> Int:
        """Cells from left to right ``(n_cells,)``: a slice of them is a strip of the mesh."""
        return frozen_int(np.argsort(self.mesh.local_centroids[:, 0]))

    @cached_property
    def pattern(self) -> tuple[Int, Int, Int, Int]:
        """Blocks of a matrix that joins neighbours, as rows; see ``block_pattern`` in ``face_kernels``."""
        from agglo_polydg_mg.face_kernels import block_pattern

        indptr, indices, diagonal, slots = block_pattern(*self.mesh.cell_faces, self.mesh.face_cells)
        return frozen_int(indptr), frozen_int(indices), frozen_int(diagonal), frozen_int(slots)

    @cached_property
    def _integrals(self) -> Float:
        """Integrals of the polynomials that source and stiffness need, as :func:`moments` gives them."""
        return frozen_float(moments(self.mesh, self.boxes, max(self.degree, 2 * self.degree - 2)))

    def weighted_moments(self, field: Field, degree: int, name: str) -> Float:
        """:func:`~agglo_polydg_mg.quadrature.weighted_moments` in the boxes; those of numbers are kept.

        The degree is at most that of the basis or of a product of two gradients.
        """
        if callable(field):
            return weighted_moments(self.mesh, field, self.boxes, degree, name)
        values, count = per_cell(field, self.mesh.n_cells, name), (degree + 1) * (degree + 2) // 2
        if not values.any():
            return np.zeros((len(values), count))
        return np.asarray(self._integrals[:, :count] * values[:, None])

    def values(self, cells: Int, points: Float) -> Float:
        """Polynomials ``(q, n_local)`` of ``cells (q,)`` at ``points (q, 2)`` relative to the origin."""
        i, j = orders(self.degree).T
        lx, ly = (legendre(x, self.degree) for x in self._inside(cells, points))
        return np.asarray((lx[i] * ly[j] * self.scale[cells]).T)

    def gradients(self, cells: Int, points: Float) -> Float:
        """Their gradients ``(q, 2, n_local)``."""
        (i, j), (c, s) = orders(self.degree).T, self.boxes[cells, 4:].T
        lx, ly = (legendre(x, self.degree) for x in self._inside(cells, points))
        both = np.stack((slopes(lx)[i] * ly[j], lx[i] * slopes(ly)[j]))
        along, across = both * self.scale[cells] / self.boxes[cells, 2:4].T[:, None]
        return np.transpose(np.stack((c * along - s * across, s * along + c * across)), (2, 0, 1))

    def _inside(self, cells: Int, points: Float) -> Float:
        """Coordinates ``(2, q)`` of points in the boxes of cells, −1..1 inside."""
        box = self.boxes[cells]
        (x, y), (c, s) = (points - box[:, :2]).T, box[:, 4:].T
        return np.stack((c * x + s * y, c * y - s * x)) / box[:, 2:4].T

    def evaluate(self, x: Float, cells: Int, points: Float) -> Float:
        """Values ``(q,)`` of the function with coefficients ``x (n,)`` in a cell each.

        ``cells (q,)`` and ``points (q, 2)`` belong together. Points are in user coordinates,
        and need not lie in the cells.
        """
        values = self.values(cells, np.asarray(points, float) - self.mesh.origin)
        return np.asarray(np.einsum("qk,qk->q", values, self.coefficients(x)[cells]))

    def coefficients(self, x: Float) -> Float:
        """The vector ``x (n,)`` as ``(n_cells, n_local)``, or OptionError if its length is another."""
        if np.shape(x) != (self.n,):
            raise OptionError(f"the vector has shape {np.shape(x)}, this space ({self.n},) unknowns")
        return np.reshape(x, (-1, self.n_local))

    def constants(self, values: Float) -> Float:
        """Coefficients ``(n,)`` of the function with constant ``values (n_cells,)`` on each cell."""
        x = np.zeros((self.mesh.n_cells, self.n_local))
        x[:, 0] = 2.0 * values / self.scale  # L₀ is the root of 1/2
        return frozen_float(x.ravel())

    def project(self, function: Field | Callable[[Float], Float]) -> Float:
        """Coefficients ``(n,)`` of the L2 projection of a number, an array per cell or a callable."""
        load = self.weighted_moments(function, self.degree, "the function")
        load *= self.scale[:, None]
        return np.asarray(np.linalg.solve(self.mass_blocks, load[:, :, None]).ravel(), dtype=np.float64)

    @cached_property
    def mass_blocks(self) -> Float:
        """Mass matrix ∫ φ_i φ_j of each cell ``(n_cells, n_local, n_local)``."""
        integrals = moments(self.mesh, self.boxes, 2 * self.degree)
        return frozen_float(products([integrals * self.scale[:, None] ** 2], self.degree, [(0, 0)]))

    def mass(self) -> sparse.bsr_array:
        """Mass matrix, block diagonal."""
        return block_diagonal(self.mass_blocks)


def products(integrals: list[Float], degree: int, derivatives: list[tuple[int, int]]) -> Float:
    """Blocks ``(n, m, m)`` of the integrals of products of derivatives of polynomials, summed over a list.

    A product of two Legendre polynomials is a sum of Legendre polynomials, so what is needed of a cell
    are the integrals ``(n, k)`` of polynomials up to the degree of the product; each of the list is taken
    with one pair of orders of differentiation in x and y.
    """
    from agglo_polydg_mg.legendre_kernels import sparse_products

    size = (degree + 1) * (degree + 2) // 2
    blocks = np.zeros((len(integrals[0]), size, size))
    for weights, (dx, dy) in zip(integrals, derivatives, strict=True):
        most = (int(np.sqrt(8 * weights.shape[1] + 1)) - 3) // 2
        given, terms = frozen_float(weights), _expansion(degree, most, dx, dy)
        over_ranges(
            lambda start, stop: sparse_products(given[start:stop], *terms, blocks[start:stop]),  # noqa: B023
            len(blocks),
        )
    return blocks


def stiffness(basis: Basis, kappa: Field) -> Float:
    """∫ κ∇φ_i·∇φ_j of each cell ``(n_cells, n_local, n_local)``."""
    integrals = basis.weighted_moments(kappa, 2 * basis.degree - 2, "kappa")
    integrals *= (basis.scale**2)[:, None]
    along = [integrals / basis.boxes[:, k, None] ** 2 for k in (2, 3)]
    return products(along, basis.degree, [(1, 0), (0, 1)])


@cache
def _expansion(degree: int, most: int, dx: int, dy: int) -> tuple[Int, Int, Float]:
    """Products of derivatives of two polynomials as sums of polynomials of degree ``most`` or less.

    Pairs of the two ``(t, 2)``, polynomials ``(t,)`` and factors ``(t,)`` of the terms that are not 0.
    """
    i, j = orders(degree).T
    a, b = orders(most).T
    first, second = np.tril_indices(len(i))
    along_x, along_y = _triple(degree, dx), _triple(degree, dy)
    table = along_x[i[first], i[second], a[:, None]] * along_y[j[first], j[second], b[:, None]]
    pairs, columns = np.nonzero(np.abs(table.T) > 1e-13 * np.abs(table).max())
    places = np.stack((first[pairs], second[pairs]), axis=1)
    return frozen_int(places), frozen_int(columns), frozen_float(table[columns, pairs])


@cache
def _triple(degree: int, derivative: int) -> Float:
    """Integrals of L_i⁽ᵈ⁾ L_k⁽ᵈ⁾ L_a over [−1, 1], a <= 2 degree."""
    nodes, weights = gauss(2 * degree + 1)
    values = legendre(nodes, 2 * degree)
    low = slopes(values[: degree + 1]) if derivative else values[: degree + 1]
    return np.asarray(np.einsum("iq,kq,aq,q->ika", low, low, values, weights))


def block_diagonal(blocks: Float) -> sparse.bsr_array:
    """Matrix with the blocks ``(n, m, m)`` on its diagonal."""
    n, m, _ = blocks.shape
    return one_per_row(blocks, frozen_int(np.arange(n)), (n * m, n * m))


def one_per_row(blocks: Float, columns: Int, shape: tuple[int, int]) -> sparse.bsr_array:
    """Matrix with one of the blocks ``(n, m, w)`` in each row of blocks, in ``columns (n,)``."""
    indptr = np.arange(len(blocks) + 1, dtype=np.int32)
    return sparse.bsr_array((blocks, np.asarray(columns, np.int32), indptr), shape=shape)
