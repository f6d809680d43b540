"""Galerkin products Pᵀ A P, in blocks or entry by entry, and multigrid levels built from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Int, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarse_solve import coarse_solver
from agglo_core.multigrid.kernels.block_products import block_columns, block_products
from agglo_core.multigrid.kernels.block_sweeps import UNROLLED
from agglo_core.multigrid.kernels.galerkin_product import galerkin_product
from agglo_core.multigrid.matrices.block_matrix import in_blocks, in_precision
from agglo_core.multigrid.smoothers.level_smoothers import SetUp, smoother_setup
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack, Solve
from agglo_core.problems import MultigridLevel, Patches

_SAMPLE = 64
"""Number of sampled product rows to estimate the number of entries.

Larger: a better estimate, and a longer set-up (benchmarks/linear.py).
"""


def csr_galerkin(A: Any, P: Any) -> Any:
    """Return Pᵀ A P as ``csr_array`` with sorted columns and read-only arrays.

    Parameters
    ----------
    A : (n, n) csr
        Symmetric matrix in double precision with read-only arrays.
    P : (n, m) csr
        Prolongation in double precision.
    """
    m = P.shape[1]
    indptr, indices, data = galerkin_product(A.indptr, A.indices, A.data, P.indptr, P.indices, P.data, m)
    product = sparse.csr_array((data, indices, indptr), shape=(m, m))
    product.data, product.indices, product.indptr = (frozen(a, a.dtype) for a in (data, indices, indptr))
    product.has_canonical_format = True
    return product


def product_entries(A: Any, P: Any) -> float:
    """Estimate the entry count of Pᵀ A P from evenly spaced rows.

    Parameters
    ----------
    A : (n, n) csr
    P : (n, m) csr
    """
    m = P.shape[1]
    columns = np.unique(np.linspace(0, m - 1, _SAMPLE).astype(np.int64))
    return float((sparse.csr_array(P[:, columns].T) @ A @ P).nnz * m / len(columns))


def have_kernels(*matrices: Any) -> bool:
    """Return True if all matrices have square blocks of the same size, 2 to 16, in double precision."""
    if any(matrix.format != "bsr" or matrix.dtype != np.float64 for matrix in matrices):
        return False
    sizes = {size for matrix in matrices for size in matrix.blocksize}
    few = all(matrix.indptr[-1] < np.iinfo(np.int32).max for matrix in matrices)
    return few and len(sizes) == 1 and 1 < sizes.pop() <= UNROLLED


def block_matmat(A: Any, P: Any) -> sparse.bsr_array:
    """Return A P for block matrices, with columns in any order."""
    places = frozen_index(np.arange(len(A.indices)))
    return _product(frozen_index(A.indptr), frozen_index(A.indices), places, A, 0, P)


def block_galerkin(A: Any, P: Any) -> sparse.bsr_array:
    """Return Pᵀ A P for block matrices, with sorted columns."""
    columns = P.shape[1] // P.blocksize[1]
    pattern = block_columns(frozen_index(P.indptr), frozen_index(P.indices), columns)
    starts, rows, places = (frozen_index(each) for each in pattern)
    found = _product(starts, rows, places, P, 1, block_matmat(A, P))
    found.sort_indices()
    return found


def _product(indptr: Any, rows: Any, places: Any, source: Any, transposed: int, P: Any) -> sparse.bsr_array:
    """Multiply a block matrix, given by its pattern and the indices ``places`` of its blocks, by P."""
    width, columns = int(P.blocksize[0]), P.shape[1] // int(P.blocksize[0])
    first, second = (frozen_float(matrix.data).reshape(-1) for matrix in (source, P))
    pattern = frozen_index(P.indptr), frozen_index(P.indices)
    product = block_products(width)(indptr, rows, places, first, transposed, *pattern, second, columns)
    shape = ((len(indptr) - 1) * width, P.shape[1])
    return sparse.bsr_array((product[2].reshape(-1, width, width), product[1], product[0]), shape=shape)


def injection(parents: Int, width: int = 1) -> sparse.bsr_array:
    """Return the prolongation that copies the ``width`` unknowns of a part to each of its children.

    Parameters
    ----------
    parents : (n,) int
        Coarse part per fine part: 0..parts − 1.
    width : int
        Unknowns per part.

    Examples
    --------
    >>> from agglo_core.multigrid import injection
    >>> injection([0, 0, 1]).toarray()
    array([[1., 0.],
           [1., 0.],
           [0., 1.]])
    """
    parents = frozen_int(parents)
    n, parts = len(parents), int(parents.max(initial=-1)) + 1
    blocks = np.broadcast_to(np.eye(width), (n, width, width)).copy()
    pattern = (parents.astype(np.int32), np.arange(n + 1, dtype=np.int32))
    return sparse.bsr_array((blocks, *pattern), shape=(n * width, parts * width))


def galerkin(A: Any, P: Any) -> Any:
    """Return Pᵀ A P, in blocks if A and P are in blocks.

    Parameters
    ----------
    A : (n, n) sparse
    P : (n, m) sparse

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import galerkin
    >>> P = sparse.csr_array(np.kron(np.eye(3), np.ones((2, 1))))
    >>> galerkin(A, P).toarray()
    array([[ 2., -1.,  0.],
           [-1.,  2., -1.],
           [ 0., -1.,  2.]])
    """
    if have_kernels(A, P):
        return block_galerkin(A, P)
    if A.format == P.format == "bsr" and A.blocksize[0] == A.blocksize[1] == P.blocksize[0]:
        return P.T @ (A @ P)
    P = sparse.csr_array(P)
    return sparse.csr_array(P.T) @ (sparse.csr_array(A) @ P)


def build_stack(
    A: Any,
    block_offsets: Int | Sequence[Int],
    prolongations: Sequence[Any],
    smoother: Any = "gauss_seidel",
    coarse: str | Callable[[Any], Solve] = "dense",
    dtype: Any = np.float64,
    *,
    labels: Sequence[Int] | None = None,
    patches: Sequence[Patches | None] | None = None,
    steps: int = 1,
) -> LevelStack:
    """Build multigrid levels with coarse matrices Pᵀ A P, computed in double precision.

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric positive definite matrix.
    block_offsets : (parts + 1,) int, or a sequence of them
        Offsets of the finest level, with coarse blocks taken from the columns of prolongations (single
        unknowns unless ``bsr_array``), or offsets of every level, finest first.
    prolongations : sequence of (n, m) sparse
        Prolongations to each level from the next coarser level, finest first.
    smoother : str, object with ``setup``, or callable
        See :func:`smoother_setup`.
    coarse : "dense", "elimination", "lu" or callable
        See :func:`coarse_solver`.
    dtype : float32 or float64
        Precision of the vectors in a cycle.
    labels : sequence of (n_cells,) int, optional
        Part of each mesh cell per level, finest first. Without labels, smoothers treat each part as a cell.
    patches : sequence of Patches or None, optional
        Patches per smoothed level, finest first.
    steps : int
        Smoothing steps before and after the coarse correction.

    Raises
    ------
    OptionError
        If shapes do not fit, or for invalid options.
    LinAlgError
        If a matrix is not positive definite. The message names the level.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import build_stack, cycle, injection
    >>> A = sparse.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(8, 8))
    >>> stack = build_stack(A, np.arange(9), [injection(np.arange(8) // 2)])
    >>> stack.grid_complexity
    1.5
    >>> (cycle(stack) @ np.ones(8)).round(1)[:4]
    array([2.2, 3.6, 3.9, 4.4])
    """
    setup = smoother_setup(smoother)
    offsets = _offsets(block_offsets, prolongations)
    for name, entries, n_levels in (("labels", labels, len(offsets)), ("patches", patches, len(offsets) - 1)):
        if entries is not None and len(entries) < n_levels:
            raise OptionError(f"{name} must be given for each of {n_levels} levels; given {len(entries)}")
    levels = []
    for k, P in enumerate(prolongations):
        if P.shape[0] != A.shape[0]:
            raise OptionError(
                f"prolongation {k} has shape {P.shape}, but the matrix of its finer level has shape {A.shape}"
            )
        # Set up the smoother on the level.
        A = in_blocks(A, offsets[k])
        level_labels = labels[k] if labels is not None else frozen_int(np.arange(len(offsets[k]) - 1))
        groups = patches[k] if patches is not None else None
        level = MultigridLevel(A, A, offsets[k], level_labels, P, None, steps, groups)
        smooth = _set_up(setup, level, dtype, k)
        stored_labels = None if labels is None else level_labels
        single = (in_precision(matrix, dtype) for matrix in (A, _to_bsr_or_csr(P)))
        # Store the level in the precision of the stack.
        levels.append(Level(next(single), offsets[k], next(single), smooth, stored_labels, groups))
        A = galerkin(A, P)
    # Coarsest level.
    A = in_blocks(A, offsets[-1])
    last = in_precision(A, dtype)
    levels.append(Level(last, offsets[-1], labels=None if labels is None else labels[len(levels)]))
    return LevelStack(levels, coarse_solver(coarse, A, dtype), dtype)


def _set_up(setup: SetUp, level: MultigridLevel, dtype: Any, k: int) -> LevelSmoother:
    try:
        return setup(level, dtype)
    except np.linalg.LinAlgError as error:
        raise np.linalg.LinAlgError(f"level {k}: {error}") from error


def _to_bsr_or_csr(P: Any) -> Any:
    return P if P.format in ("bsr", "csr") else sparse.csr_array(P)


def _offsets(offsets: Any, prolongations: Sequence[Any]) -> list[Int]:
    """Return the block offsets per level."""
    if len(offsets) and np.ndim(offsets[0]):
        if len(offsets) != len(prolongations) + 1:
            raise OptionError(
                f"block_offsets are given for {len(offsets)} levels, but {len(prolongations)} "
                f"prolongations make {len(prolongations) + 1} levels"
            )
        return [frozen_int(array) for array in offsets]
    widths = [P.blocksize[1] if P.format == "bsr" else 1 for P in prolongations]
    sizes = [P.shape[1] for P in prolongations]
    coarse = [frozen_int(np.arange(0, n + 1, w)) for n, w in zip(sizes, widths, strict=True)]
    return [frozen_int(offsets), *coarse]
