"""Laws for multigrid components except smoothers: transfer, coarse operator and coarse solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.questions import answer, in_words, plain, questions
from agglo_core.conformance.inputs.strategies import coarsening_cases

_NEAR = 0.2  # largest share of a near-null vector outside the range of the prolongation
_EXAMPLES = 30  # drawn levels for each law
_RATIO = 10.0  # of energies of coarse matrices; a penalty may change with the size of the cells
_ROUNDING = 1e-6  # relative, for nearly singular matrices
_LEFT = 0.1  # largest share of the error left by a coarse solver


@drawn_law("transfer", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def prolongation_fits(subject: Subject, case: Case) -> None:
    """The prolongation is a sparse matrix with a row per unknown and columns grouped by coarse part."""
    result = answer(subject, subject.build(), case)
    P, step = getattr(result, "P", result), case.given[0]
    n, parts = step.A.shape[0], int(step.coarse_labels.max()) + 1
    require(
        sparse.issparse(P) and P.dtype.kind == "f" and P.shape[0] == n and np.isfinite(P.data).all(),
        f"on {case.name}: it returned {in_words(P)}, expected a sparse matrix of {n} rows of finite floats",
    )
    offsets = getattr(result, "block_offsets", None)
    dealt = P.shape[1] > 0 and P.shape[1] % parts == 0
    if offsets is not None:
        dealt = len(offsets) == parts + 1 and offsets[0] == 0 and offsets[-1] == P.shape[1]
    require(
        dealt,
        f"on {case.name}: its {P.shape[1]} columns cannot be divided evenly among {parts} parts: return "
        "CoarseSpace(P, block_offsets), whose offsets increase from 0 to the number of columns",
    )


@drawn_law("transfer", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def columns_independent(subject: Subject, case: Case) -> None:
    """The columns of the prolongation are linearly independent."""
    P = _prolongation(subject, case)
    size = np.linalg.norm(P, axis=0)
    rank = np.linalg.matrix_rank(P / np.where(size > 0.0, size, 1.0), tol=1e-8)
    require(
        rank == P.shape[1],
        f"on {case.name}: {P.shape[1]} columns have rank {rank}: the coarse matrix would be singular",
    )


@drawn_law("transfer", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def near_null_kept(subject: Subject, case: Case) -> None:
    """Near-null vectors of the matrix lie nearly in the range of the prolongation."""
    P, B = _prolongation(subject, case), case.given[0].near_null
    remainder = B - P @ np.linalg.lstsq(P, B, rcond=None)[0]
    share = float((np.linalg.norm(remainder, axis=0) / np.linalg.norm(B, axis=0)).max())
    require(
        share <= _NEAR,
        f"on {case.name}: {share:.2f} of a near-null vector lies outside the range of P: smoothers "
        "hardly reduce such errors, so the coarse level must; build P from step.near_null or "
        "step.injected",
    )


@drawn_law("coarse_operator", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def coarse_matrix_fits(subject: Subject, case: Case) -> None:
    """``coarse_matrix(step, P)`` is a sparse real square matrix with a row for each column of P."""
    matrix, m = answer(subject, subject.build(), case), case.given[1].shape[1]
    require(
        sparse.issparse(matrix) and matrix.dtype.kind == "f" and matrix.shape == (m, m),
        f"on {case.name}: it returned {in_words(matrix)}, expected a sparse matrix ({m}, {m}) of floats",
    )


@drawn_law("coarse_operator", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def coarse_matrix_symmetric(subject: Subject, case: Case) -> None:
    """The coarse matrix is symmetric."""
    C = answer(subject, subject.build(), case).toarray()
    gap = float(np.abs(C - C.T).max() / np.abs(C).max())
    require(gap <= 1e-9, f"on {case.name}: C and its transpose differ by {gap:.1e}: restrict by Pᵀ")


@drawn_law("coarse_operator", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def coarse_energy_kept(subject: Subject, case: Case) -> None:
    """The coarse energy v·C v lies between a tenth and ten times that of Pᵀ A P, for every v."""
    step, P = case.given
    C = answer(subject, subject.build(), case).toarray()
    galerkin = (sparse.csr_array(P).T @ sparse.csr_array(step.A) @ sparse.csr_array(P)).toarray()
    ratios = eigh(0.5 * (C + C.T), galerkin, eigvals_only=True)
    require(
        ratios[0] >= 1 / _RATIO and ratios[-1] <= _RATIO,
        f"on {case.name}: the energies of C and Pᵀ A P have ratios from {ratios[0]:.2g} to {ratios[-1]:.2g}: "
        "keep the couplings between the parts, which determine the energy of smooth functions",
    )


@drawn_law("coarse_solver", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES)
def coarse_error_reduced(subject: Subject, case: Case) -> None:
    """``solver_for(A)`` returns a function b ↦ x ``(n,)`` with relative energy error at most 10 %."""
    A, b = case.given
    x = answer(subject, subject.build(), case)
    require(
        isinstance(x, np.ndarray) and x.shape == b.shape and x.dtype.kind == "f",
        f"on {case.name}: solve(b) returned {in_words(x)}, expected floats of shape {b.shape}",
    )
    exact = np.atleast_1d(spsolve(sparse.csc_array(A), b))
    error = x - exact
    relative_error = float(np.sqrt((error @ (A @ error)) / (exact @ (A @ exact))))
    require(
        relative_error <= _LEFT,
        f"on {case.name}: {relative_error:.2f} of the error is left in the energy norm: there is no "
        "coarser level to reduce it; solve exactly, or iterate more",
    )


@drawn_law("coarse_solver", draw=coarsening_cases, fixed=questions, examples=_EXAMPLES, promise="symmetric")
def coarse_solver_symmetric(subject: Subject, case: Case) -> None:
    """The solution is a linear and symmetric function of b."""
    A = case.given[0]
    u, v = np.random.default_rng(3).standard_normal((2, A.shape[0]))
    Su, Sv, combined = (_solution(subject, case, b) for b in (u, v, 2 * u - 3 * v))
    size = np.abs(combined).max() + np.abs(Su).max()
    nonlinearity = float(np.abs(combined - 2 * Su + 3 * Sv).max() / size)
    require(
        nonlinearity <= _ROUNDING,
        f"on {case.name}: S (2 u − 3 v) differs from 2 S u − 3 S v by {nonlinearity:.1e}: conjugate "
        "gradients that stop by a tolerance are not linear; drop the promise symmetric",
    )
    gap = float(abs(u @ Sv - v @ Su) / (np.linalg.norm(u) * np.linalg.norm(Sv)))
    require(
        gap <= _ROUNDING,
        f"on {case.name}: u·S v and v·S u differ by {gap:.1e}: sweep forwards and then backwards",
    )


def _prolongation(subject: Subject, case: Case) -> Float:
    result = answer(subject, subject.build(), case)
    return np.asarray(getattr(result, "P", result).toarray())


def _solution(subject: Subject, case: Case, b: Any) -> Float:
    return plain(subject, subject.build(), Case(case.name, (case.given[0], frozen_float(b))))
