"""Additive Schwarz: aggregates as overlapping subdomains, with or without coarse level."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.coarse_solve import direct_solver
from agglo_core.multigrid.coarsening.prolongation import Couplings, smooth_tentative, tentative
from agglo_core.multigrid.matrices.checks import check_system
from agglo_core.multigrid.stack import Solve

_DENSE = 150
"""Maximum number of unknowns of subdomains to be inverted. Larger subdomains use sparse factors.
Benchmark: benchmarks/constants.py."""
_MOST_STEPS = 8
"""Maximum number of smoothing steps for the coarse prolongation.

Each step extends the coarse functions by a layer of neighbours, which fills the coarse matrix.
Benchmark: benchmarks/constants.py.
"""


def additive_schwarz(
    A: Any,
    block_offsets: ArrayLike | None,
    labels: ArrayLike,
    overlap: int = 1,
    *,
    coarse: bool = True,
    near_null: ArrayLike | None = None,
) -> LinearOperator:
    """Return the symmetric additive Schwarz preconditioner Σ R_iᵀ A_i⁻¹ R_i (+ P (Pᵀ A P)⁻¹ Pᵀ).

    Parameters
    ----------
    A : (n, n) sparse
        Symmetric positive (semi)definite matrix.
    block_offsets : (parts + 1,) int, int or None
        Part p has the unknowns ``block_offsets[p]:block_offsets[p + 1]``. A whole number is the size of all
        parts. None for the blocks of a BSR matrix, else single unknowns.
    labels : (parts,) int
        Subdomain per part, 0..k−1: agglomerates of cells.
    overlap : int
        Layers of neighbouring parts to add to each subdomain.
    coarse : bool
        Add a coarse level, by smoothed aggregation with the subdomains as aggregates. Then iteration
        counts do not grow with the number of subdomains of fixed size.
    near_null : (n, k) or (n,) float, optional
        Near-null vectors for the coarse level. Default: constants, see :func:`aggregation_stack`.

    Returns
    -------
    LinearOperator
        Operator ``(n, n)``, with all subdomains and the coarse level factorised in advance.

    Raises
    ------
    OptionError
        For arrays that do not fit the matrix, or negative labels or overlap.

    Notes
    -----
    Toselli and Widlund, Domain Decomposition Methods (2005), chapters 2 and 3. The coarse level follows
    Lasser and Toselli, Math. Comp. 71 (2002).

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import additive_schwarz
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(6, 6))
    >>> M = additive_schwarz(A, None, [0, 0, 0, 1, 1, 1], overlap=0, coarse=False)
    >>> M @ np.ones(6)
    array([1.5, 2. , 1.5, 1.5, 2. , 1.5])
    """
    matrix, offsets, B = check_system(A, block_offsets, near_null)
    domain = frozen_int(labels)
    if domain.shape != (len(offsets) - 1,) or (domain < 0).any():
        raise OptionError(f"labels must be {len(offsets) - 1} numbers, 0 or more, one for each part of A")
    if overlap < 0:
        raise OptionError(f"overlap must be a number of layers, 0 or more; given {overlap}")
    part_of = frozen_int(np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)))
    strength = Couplings.of(matrix, offsets, part_of)
    local = [
        (rows, direct_solver(matrix[rows][:, rows], dense=_DENSE))
        for rows in _subdomains(strength, offsets, domain, overlap)
    ]
    below = _coarse_level(matrix, offsets, part_of, strength, domain, B) if coarse else None

    apply = partial(_sum_solutions, local, below)
    return LinearOperator(matrix.shape, matvec=apply, rmatvec=apply, dtype=np.float64)


def _sum_solutions(local: Sequence[tuple[Int, Solve]], below: tuple[Any, Any, Solve] | None, b: Any) -> Float:
    """Return the sum of the solutions on subdomains and on the coarse level, if any."""
    b = np.asarray(b, dtype=np.float64).ravel()
    x = np.zeros(len(b))
    for rows, solve in local:
        x[rows] += solve(b[rows])
    if below is not None:
        P, PT, solve = below
        x += P @ solve(PT @ b)
    return x


def _subdomains(strength: Couplings, offsets: Int, domain: Int, overlap: int) -> list[Int]:
    """Return the unknowns of each overlapping subdomain, in ascending order."""
    n = len(domain)
    graph = sparse.csr_array((np.ones(len(strength.to)), strength.to, strength.graph), shape=(n, n))
    member = sparse.csr_array((np.ones(n), (np.arange(n), domain)))
    for _ in range(overlap):
        member = member + graph @ member
        member.data[:] = 1.0
    sizes = np.diff(offsets)
    inside = sparse.csr_array(member.T)
    inside.sort_indices()
    parts = inside.indices
    shift = np.cumsum(sizes[parts]) - sizes[parts]
    rows = np.repeat(offsets[:-1][parts] - shift, sizes[parts]) + np.arange(sizes[parts].sum())
    ends = np.append(shift, len(rows))[inside.indptr[1:-1]]
    return [frozen_int(each) for each in np.split(rows, ends) if len(each)]


def _coarse_level(
    A: Any, offsets: Int, part_of: Int, strength: Couplings, domain: Int, B: Float
) -> tuple[Any, Any, Solve]:
    """Return P (smoothed over half the subdomain width), Pᵀ, and the coarse solver."""
    start = tentative(domain[part_of], int(domain.max()) + 1, B)
    width = np.sqrt(len(domain) / (int(domain.max()) + 1))
    steps = int(np.clip(round(0.5 * width), 1, _MOST_STEPS))
    P = smooth_tentative(A, offsets, part_of, strength, start, B, weak=0.0, steps=steps)
    PT = sparse.csr_array(P.T)
    return P, PT, direct_solver(PT @ A @ P)
