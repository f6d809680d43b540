"""Conforming auxiliary space for the smooth errors that cell-wise smoothing leaves.

The penalty pushes the solution towards continuity. The space has one unknown per vertex and p − 1 bubbles
per face. On each cell, a function is the polynomial of degree p closest to the trace that the unknowns
define on the boundary. Auxiliary spaces: J. Xu, Computing 56 (1996); for discontinuous methods V. Dobrev,
R. Lazarov, P. Vassilevski, L. Zikatanov, Numer. Linear Algebra Appl. 13 (2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Index, Int, Mask, Mesh, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.fields.gauss_points import gauss
from agglo_polydg_mg.space.basis import Basis

_SHORT = 0.85
"""Fraction of |K| / diam K below which a face is short: its ends share an unknown, and it has no bubbles.

A larger value gives fewer unknowns and a coarser space (benchmarks/solve.py --meshes voronoi).
"""
_WEAK = 10.0
"""A face is weak if a unit jump costs less than 1 / this factor of the maximum in either cell. A larger
value couples more cells (benchmarks/solve.py --meshes graded layers)."""
_COMPARABLE = 3.0
"""A cell unites two groups if the second group's stiffness is at most this multiple of its own. A
larger value couples more groups (benchmarks/solve.py --meshes jumps checks)."""
_SQUARES = 6
"""Grid size, in squares per side: cells with more corners than its square depend on only one corner per grid
square. A larger value follows the trace of such cells better, at more time and memory."""
_UNROLLED = 10
"""Largest block size, in unknowns per cell, with a specialised kernel for PᵀAP: p = 3 in 2-D, p = 2 in 3-D. A
kernel of fixed size is faster, but takes a compilation for each size (benchmarks/solve.py)."""
_REGULARISATION = 1e-4
"""Weight of the squared degree in the fit, relative to the squared trace on a box scaled to a square.

It limits polynomials that vanish on the boundary; a larger value fits the trace less closely
(benchmarks/solve.py --degrees 2 3).
"""
_DIRECTION = (1.0, 0.618)
"""Reference direction: the sign of odd bubbles follows faces in this direction. Any direction serves that is
not normal to many faces, where rounding would decide the sign."""


@dataclass(frozen=True, eq=False)
class ConformingSpace:
    """A continuous space: unknowns at the vertices and, numbered after them, bubbles on the faces.

    Attributes
    ----------
    offsets : (n_cells + 1,) int
        Cell c has the unknowns ``unknowns[offsets[c]:offsets[c + 1]]``.
    unknowns : (m,) int
    fitted : (m, n_local) float
        Coefficients of each unknown's function in the cell.
    n_vertices, n : int
        Number of vertex unknowns, and total number.
    ends : (n_faces, 2, 2) int
        Unknowns at both ends of each face, for the cells on both sides; −1 for none.
    bubbles : (n_faces,) int
        First bubble per face, −1 if the face has none.
    bubbles_of_a_face : int
    jumps : (n_faces,) float
        Energy of a unit jump across each face.
    """

    offsets: Int
    unknowns: Index
    fitted: Float
    n_vertices: int
    n: int
    ends: Int
    bubbles: Int
    bubbles_of_a_face: int
    jumps: Float

    def prolongation(self, dtype: Any = np.float64, scale: Float | None = None) -> sparse.bsr_array:
        """Return the prolongation P ``(n_cells · n_local, n)`` to the cells, in blocks of one column.

        Entries at rounding level are set to 0. ``scale (n_cells, n_local, n_local)``, if given, multiplies
        the rows of each cell by its block.
        """
        from agglo_polydg_mg.auxiliary.galerkin_kernels import multiply_rows

        rows = self.fitted if scale is None else multiply_rows(scale, self.offsets, self.fitted)
        blocks = rows.astype(dtype)
        blocks[np.abs(blocks) < 1e-22 * np.abs(blocks).max(initial=0.0)] = 0.0  # their products: denormals
        shape = (self.fitted.shape[1] * (len(self.offsets) - 1), self.n)
        return sparse.bsr_array((blocks[:, :, None], self.unknowns, self.offsets), shape=shape)

    def galerkin(
        self,
        A: sparse.bsr_array,
        small: float = 0.0,
        small_bubbles: float = 0.0,
        small_vertices: float = 0.0,
    ) -> sparse.csr_array:
        """Return the Galerkin matrix C = Pᵀ A P ``(n, n)``, with sorted columns and without small entries.

        Entries |c_ij| ≤ ``small`` (c_ii c_jj)^½ are dropped; between two bubbles the factor is
        ``small_bubbles``, and their magnitude is added to the diagonal, so that C stays definite. Between
        two vertices, entries up to ``small_vertices`` move to the diagonal, so that C acts on constants as
        before.
        """
        from agglo_polydg_mg.auxiliary.galerkin_kernels import drop_small_entries, half_product

        pattern = frozen_index(A.indptr), frozen_index(A.indices)
        width = self.fitted.shape[1]
        product = half_product(width if width <= _UNROLLED else 0)
        half = product(*pattern, frozen_float(A.data), self.offsets, self.unknowns, self.fitted, self.n)
        rows, columns, values = (frozen(each, each.dtype) for each in half)
        limits = small, small_bubbles, small_vertices
        starts, indices, data = drop_small_entries(rows, columns, values, self.n_vertices, *limits)
        return sparse.csr_array((data, indices, starts), shape=(self.n, self.n))


def conforming_space(
    basis: Basis, sigma: Float, kappa: Float, *, bubbles: bool = True, orthogonal: bool = True
) -> ConformingSpace:
    """Build the continuous auxiliary space of a discontinuous polynomial space in 2-D.

    Vertices joined by faces shorter than 0.85 |K| / diam K share an unknown, if they lie that close
    together.

    A vertex has an unknown for each group of coupled cells around it. A face couples its cells unless it is
    weak: a jump across it costs little, in both cells, relative to other jumps in the cell. So the space is
    discontinuous across the sides of flat cells in boundary layers, where the penalty is small and
    smoothing slow. Where κ jumps the weaker cell follows the stronger cell, but does not couple two
    stronger cells that touch only at the vertex.

    On long faces of flat cells whose end unknowns belong only to the adjacent cells, bubbles are orthogonal
    to linear functions: otherwise constants along such cells would mix both.

    A cell with more than 36 corners (a large cell among small cells, or a cell with many holes) depends on
    at most 36 of them and on no bubbles, so that time and memory grow linearly with the edges, not
    quadratically.

    Parameters
    ----------
    basis : Basis
    sigma : (n_faces,) float
        Face penalty in 1 / length.
    kappa : (n_cells,) float
        Cell coefficient.
    bubbles : bool
        Whether faces have p − 1 bubbles each.
    orthogonal : bool
        Whether bubbles are orthogonal to linear functions on the long faces of flat cells.
    """
    from agglo_polydg_mg.auxiliary.conforming_kernels import corner_unknowns, corners_of_cells, fit_traces

    # 1. Cluster vertices and number the corners
    mesh, p = basis.mesh, basis.degree
    topology = (*mesh.cell_faces, mesh.face_pairs, mesh.face_cells)
    short, clusters = _clusters(mesh)
    starts, ends = (frozen_int(a) for a in corners_of_cells(*topology, clusters))
    # 2. Unite corners into vertex unknowns
    offsets, faces = mesh.cell_faces
    coupling, stiffness = _stiffness(mesh, sigma, kappa)
    order = frozen_int(np.argsort(-stiffness, kind="stable"))
    parts = offsets, faces, mesh.face_cells, ends, starts, coupling, stiffness, order
    numbering = corner_unknowns(*parts, _WEAK, _COMPARABLE)
    unknowns, n_vertices = frozen_int(numbering[0]), int(numbering[1])
    # 3. Number the bubbles
    extra = p - 1 if bubbles else 0
    first, n = _bubbles(mesh, starts, short, n_vertices, extra)
    at_ends = np.where(ends < 0, -1, unknowns[ends])
    corners = np.bincount(unknowns, minlength=n_vertices)
    isolated = _faces_with_own_ends(mesh, at_ends, corners, orthogonal and n > n_vertices)
    # 4. Fit polynomials to the traces
    nodes, weights = gauss(p + 1)
    rule = frozen_float(0.5 * (nodes + 1.0)), frozen_float(0.5 * weights)
    numbers = ends, starts, unknowns, first, isolated, _orthogonal(extra)
    limits = _REGULARISATION, _SQUARES, len(unknowns) + 2 * (n - n_vertices)
    cells, indices, fitted = fit_traces(
        mesh.local_points, *topology, *numbers, basis.boxes, basis.scale, p, *rule, *limits
    )
    # 5. Renumber: cells with many corners leave some unknowns unused
    in_use = np.zeros(n, bool)
    in_use[indices] = True  # cells with many corners skip some
    places = np.where(in_use, np.cumsum(in_use) - 1, -1)
    counts = int(in_use[:n_vertices].sum()), int(in_use.sum())
    fitted *= bubble_signs(mesh, first, extra, n)[indices, None]
    return ConformingSpace(
        frozen_int(cells),
        frozen_index(places[indices]),
        frozen_float(fitted),
        *counts,
        frozen_int(np.where(at_ends < 0, -1, places[at_ends])),
        frozen_int(np.where(first < 0, -1, places[first])),
        extra,
        coupling,
    )


def directions(mesh: Mesh) -> Float:
    """Return the edge vectors of the faces ``(n_faces, 2)``, all oriented towards one half-plane."""
    a, b = mesh.face_pairs.T
    vectors = mesh.local_points[b] - mesh.local_points[a]
    return frozen_float(np.where(vectors @ _DIRECTION < 0.0, -1.0, 1.0)[:, None] * vectors)


def bubble_signs(mesh: Mesh, bubbles: Int, extra: int, n: int) -> Float:
    """Return signs ``(n,)`` that make the basis functions independent of face orientation.

    Odd bubbles change sign when the face direction is reversed.
    """
    signs, on = np.ones(n), bubbles >= 0
    a, b = mesh.face_pairs[on].T
    turned = (mesh.local_points[b] - mesh.local_points[a]) @ _DIRECTION < 0.0
    for k in range(1, extra, 2):
        signs[bubbles[on] + k] = np.where(turned, -1.0, 1.0)
    return frozen_float(signs)


def _faces_with_own_ends(mesh: Mesh, ends: Int, corners: Int, bubbles: bool) -> Mask:
    """Return a mask of faces ``(n_faces,)`` whose end unknowns belong to no cell but the adjacent ones.

    ``corners (n_vertices,)`` counts the cells per unknown. Without ``bubbles`` the result is not
    needed and all False.
    """
    if not bubbles:
        return np.zeros(mesh.n_faces, bool)
    inner = mesh.face_cells[:, 1] >= 0
    far_ends = np.where(inner[:, None], ends[:, 1], ends[:, 0])
    distinct_ends = ends[:, 0, 0] != ends[:, 0, 1]
    alone = (corners[ends[:, 0]] == 1 + inner[:, None]).all(axis=1)
    return np.asarray((far_ends == ends[:, 0]).all(axis=1) & alone & distinct_ends)


def _orthogonal(extra: int) -> Float:
    """Return the coefficients that make each bubble orthogonal to linear functions and lower bubbles.

    Row k of the table ``(extra, 2 + extra)`` refers to the linear functions (1 − s)/2, (1 + s)/2 and the
    lower bubbles (1 − s²) s^k on −1..1.
    """
    nodes, weights = gauss(extra + 2)
    values = [0.5 * (1.0 - nodes), 0.5 * (1.0 + nodes), *((1.0 - nodes**2) * nodes**k for k in range(extra))]
    rows = np.array(values)
    table = np.zeros((extra, 2 + extra))
    for k in range(extra):
        before, own = rows[: 2 + k], rows[2 + k]
        table[k, : 2 + k] = -np.linalg.solve((before * weights) @ before.T, (before * weights) @ own)
    return frozen_float(table)


def _clusters(mesh: Mesh) -> tuple[Mask, Int]:
    """Return a mask of the short faces, and the cluster that each vertex joins along them."""
    from agglo_polydg_mg.auxiliary.conforming_kernels import cluster_vertices

    limits = _SHORT * mesh.cell_measures / mesh.cell_diameters
    owner, other = mesh.face_cells.T
    limit = np.minimum(limits[owner], limits[np.where(other < 0, owner, other)])
    short = mesh.face_measures < limit
    if not short.any():
        return short, frozen_int(np.arange(mesh.n_points))
    faces = np.flatnonzero(short)
    faces = faces[np.argsort(mesh.face_measures[faces], kind="stable")]
    edges = frozen_int(mesh.face_pairs[faces])
    return short, frozen_int(cluster_vertices(mesh.local_points, edges, frozen_float(limit[faces])))


def _bubbles(mesh: Mesh, starts: Int, short: Mask, first: int, n_per_face: int) -> tuple[Int, int]:
    """Number the bubbles by first cell: first bubble per face ``(F,)``, and total number of unknowns.

    Faces without bubbles have −1.
    """
    numbers = np.full(mesh.n_faces, -1)
    if not n_per_face:
        return frozen_int(numbers), first
    on_grid = np.diff(starts) > _SQUARES**2
    owner, neighbour = mesh.face_cells.T
    neighbour = np.where(neighbour < 0, owner, neighbour)
    faces = np.flatnonzero(~(short | on_grid[owner] | on_grid[neighbour]))
    faces = faces[np.argsort(np.minimum(owner, neighbour)[faces], kind="stable")]
    numbers[faces] = first + n_per_face * np.arange(len(faces))
    return frozen_int(numbers), first + n_per_face * len(faces)


def _stiffness(mesh: Mesh, sigma: Float, kappa: Float) -> tuple[Float, Float]:
    """Return the energy of a unit jump across each face ``(F,)``, and the largest per cell."""
    owner, neighbour = mesh.face_cells.T
    kappa_in, kappa_out = kappa[owner], kappa[np.where(neighbour < 0, owner, neighbour)]
    jump = sigma * mesh.face_measures
    offsets, faces = mesh.cell_faces
    stiffness = kappa * np.maximum.reduceat(jump[faces], offsets[:-1])
    return frozen_float(2.0 * kappa_in * (kappa_out / (kappa_in + kappa_out)) * jump), frozen_float(stiffness)
