"""Multigrid levels for elasticity: cells, a continuous vector space, then smoothed aggregation.

Cell smoothing removes the discontinuous errors. The rest is a problem for displacements of vertices, whose
aggregates hold rigid motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from agglo_core.authoring import Float, Int, frozen_float, frozen_index, frozen_int, multigrid
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space
from agglo_polydg_mg.auxiliary.conforming_stack import labels_of_unknowns
from agglo_polydg_mg.auxiliary.solid_space import solid_space
from agglo_polydg_mg.elasticity.discretisation import Assembled
from agglo_polydg_mg.elasticity.vectors import coordinates, motions_of
from agglo_polydg_mg.space.basis import Basis

_SMALL_BUBBLES = 0.03
"""Entries between bubbles up to this multiple of the geometric mean of both diagonal entries are dropped. A
larger value makes cycles cheaper and weaker (benchmarks/elasticity.py --degrees 2)."""
_ROUNDING = 1e-13  # the same limit for other entries: rigid motions bear no larger one
_VISITS = 2
"""Visits of the levels of vertices and aggregates per cycle: two visits save a third of the iterations, for
little time (benchmarks/elasticity.py)."""
_WEAK = 0.05
"""Couplings of vertices up to this fraction of the diagonal do not smooth the prolongation of aggregates. A
larger value gives sparser and weaker coarse levels (benchmarks/elasticity.py)."""
_FIT = 1e-5
"""Tolerance of the unknowns of the coordinates. A larger value moves the vertices that they stand for."""
_FLAT = 1e-10
"""Ratio of eigenvalues below which the vertices of a cell count as collinear: the correction then leaves
the function across them. A smaller value corrects by large functions."""


def elastic_stack(
    assembled: Assembled,
    A: Any,
    labels: Sequence[Int] = (),
    *,
    groups: bool = False,
    dtype: Any = np.float32,
) -> multigrid.LevelStack:
    """Build the multigrid levels of an assembled elasticity problem, for its matrix ``A (n, n)``.

    Parameters
    ----------
    assembled : Assembled
    A : (n, n) bsr
        The matrix, which may be scaled.
    labels : sequence of (n_cells,) int
        Agglomerates, finest first: a vertex belongs to its first cell's agglomerate.
    groups : bool
        Smooth strongly coupled cells together.
    dtype : float32 or float64
        Cycle precision.

    Raises
    ------
    LinAlgError
        If a block of the matrix is not positive definite.
    """
    # 1. The continuous space of each component, and the matrix of its vector functions
    basis, dim = assembled.basis, assembled.basis.mesh.dim
    if dim == 2:
        scalar = conforming_space(basis, assembled.sigma, assembled.material.acoustic[:, 1])
    else:
        scalar = solid_space(basis)
    scalar, values = exact_for_linear(scalar, basis)
    space = component_space(scalar, dim)
    C = space.galerkin(in_components(A, dim), _ROUNDING, _SMALL_BUBBLES)
    # 2. Cells, and below them vertices and bubbles if there are any
    top, scaling = _first_level(assembled, A, space, groups, dtype)
    levels, n = [top], space.n_vertices
    if space.n > n:
        inject = sparse.csr_array(sparse.eye_array(space.n, n, dtype=dtype))
        sweeps = multigrid.ScalarGaussSeidel(C, dtype)
        levels.append(multigrid.Level(sweeps.matrix, frozen_int(np.arange(space.n + 1)), inject, sweeps))
        C = sparse.csr_array(C[:n, :n])
    # 3. Smoothed aggregation that keeps the rigid motions of the vertices
    vertex_labels = [labels_of_unknowns(scalar, each)[: scalar.n_vertices] for each in labels]
    below = multigrid.aggregation_stack(
        C,
        labels=vertex_labels or None,
        near_null=motions_of(values)[:n],
        block_offsets=dim,
        dtype=dtype,
        weak=_WEAK,
        smoother=multigrid.pointwise,
        visits=_VISITS,
    )
    return multigrid.LevelStack([*levels, *below.levels], below.coarse, dtype, scaling)


def _first_level(
    assembled: Assembled, A: Any, space: ConformingSpace, groups: bool, dtype: Any
) -> tuple[multigrid.Level, Any]:
    """Return the level of the cells, and the transformation of its unknowns if cells are grouped."""
    offsets = assembled.system.block_offsets
    if not groups:
        matrix = multigrid.block_matrix(A, offsets, dtype, symmetric=True)
        sweeps: multigrid.LevelSmoother = multigrid.GaussSeidel.on(matrix)
        return multigrid.Level(A, offsets, space.prolongation(dtype), sweeps), None
    scaled = multigrid.block_scaled(A)
    joined = multigrid.strong_groups(scaled.A)
    sweeps = multigrid.VertexPatches(scaled.A, joined, dtype)
    P = sparse.csr_array(scaled.LT @ space.prolongation()).astype(dtype)
    return multigrid.Level(sweeps.A, offsets, P, sweeps, patches=joined), scaled.T


def component_space(space: ConformingSpace, dim: int) -> ConformingSpace:
    """Return the vector functions of a space, with component a of unknown v as unknown ``dim v + a``.

    Each component of a cell counts as a cell.
    """
    offsets, rows, axes = _repeated(space.offsets, dim)
    unknowns = frozen_index(dim * np.asarray(space.unknowns)[rows] + axes)
    fitted = frozen_float(space.fitted[rows])
    none = frozen_int(np.empty(0))
    sizes = dim * space.n_vertices, dim * space.n
    return ConformingSpace(offsets, unknowns, fitted, *sizes, none, none, 0, frozen_float(np.empty(0)))


def in_components(A: Any, dim: int) -> sparse.bsr_array:
    """Return a matrix of cells in smaller blocks, one for each pair of components."""
    m = A.blocksize[0] // dim
    offsets, blocks, axes = _repeated(A.indptr, dim)
    data = A.data.reshape(-1, dim, m, dim, m)[blocks, axes].transpose(0, 2, 1, 3).reshape(-1, m, m)
    indices = (dim * np.asarray(A.indices)[blocks][:, None] + np.arange(dim)).ravel()
    return sparse.bsr_array((data, indices, dim * offsets), shape=A.shape)


def _repeated(offsets: Any, dim: int) -> tuple[Int, Int, Int]:
    """Repeat each list of items ``dim`` times: offsets, the items, and the number of the repetition."""
    counts = np.repeat(np.diff(offsets), dim)
    ends = np.concatenate(([0], np.cumsum(counts)))
    items = np.arange(ends[-1]) + np.repeat(np.repeat(offsets[:-1], dim) - ends[:-1], counts)
    axes = np.repeat(np.tile(np.arange(dim), len(offsets) - 1), counts)
    return frozen_int(ends), frozen_int(items), frozen_int(axes)


def exact_for_linear(space: ConformingSpace, basis: Basis) -> tuple[ConformingSpace, Float]:
    """Return the space corrected to contain 1 and the coordinates, and their unknowns ``(n, 1 + d)``.

    The fit of traces misses linear functions slightly, which rigid motions of slender bodies would not
    survive. The unknowns of the coordinates are the closest in the space, 0 for bubbles. In each cell the
    correction is the smallest: F + y (yᵀ y)⁺ (T − yᵀ F), with coefficients F of the unknowns' functions,
    values y of the unknowns and coefficients T of the linear functions.
    """
    # 1. The closest unknowns
    P, dim, n = sparse.csr_array(space.prolongation()), basis.mesh.dim, space.n_vertices
    P = P[:, :n]
    mass = sparse.csr_array(P.T @ P)
    inverse = sparse.diags_array(1.0 / mass.diagonal())
    target = np.concatenate(
        (basis.constants(np.ones(basis.mesh.n_cells)).reshape(-1, 1, basis.n_local), coordinates(basis)),
        axis=1,
    )
    values = np.zeros((space.n, dim + 1))
    values[:n, 0] = 1.0
    for axis in range(1, dim + 1):
        values[:n, axis] = cg(mass, P.T @ target[:, axis].ravel(), M=inverse, rtol=_FIT, maxiter=200)[0]
    # 2. Corrections cell by cell, with coordinates relative to the cell
    cells = np.repeat(np.arange(basis.mesh.n_cells), np.diff(space.offsets))
    y, starts = values[space.unknowns], space.offsets[:-1]
    counts = np.maximum(np.add.reduceat(y[:, 0], starts), 1.0)
    centres = np.add.reduceat(y[:, 1:], starts, axis=0) / counts[:, None]
    y[:, 1:] -= y[:, :1] * centres[cells]
    target[:, 1:] -= centres[:, :, None] * target[:, :1]
    gram = np.add.reduceat(y[:, :, None] * y[:, None], starts, axis=0)
    missing = target - np.add.reduceat(y[:, :, None] * space.fitted[:, None], starts, axis=0)
    change = np.linalg.pinv(gram, rcond=_FLAT, hermitian=True) @ missing
    fitted = space.fitted + np.einsum("ri,rik->rk", y, change[cells])
    return replace(space, fitted=frozen_float(fitted)), frozen_float(values)
