"""Laws for multigrid components except smoothers: transfer, coarse operator and coarse solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import spsolve

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base import Case, Subject, as_array, in_words, law, require
from agglo_core.conformance.inputs.questions import REFUSED, answer, plain
from agglo_core.conformance.inputs.strategies import coarsening_cases
from agglo_core.problems import CoarseSpace

_EXAMPLES = 30  # drawn levels for each law


@law("transfer", draw=coarsening_cases, examples=_EXAMPLES)
def prolongation_fits(subject: Subject, case: Case) -> None:
    """The prolongation is sparse, with a row per unknown and independent columns grouped by coarse part."""
    space = _space(subject, case)
    if space is None:
        return
    P, offsets, parts = space.P, space.block_offsets, int(case.given[0].coarse_labels.max()) + 1
    m = P.shape[1]
    fits = m > 0 and m % parts == 0
    if offsets is not None:
        fits = np.shape(offsets) == (parts + 1,) and offsets[0] == 0 and offsets[-1] == m
        fits = bool(fits and (np.diff(offsets) >= 0).all())
    require(
        fits,
        f"its {m} columns cannot be divided evenly among {parts} parts: return CoarseSpace(P, "
        "block_offsets), whose offsets increase from 0 to the number of columns",
    )
    _require_grouped(subject, case, parts)
    size = sparse.linalg.norm(P, axis=0)
    rank = np.linalg.matrix_rank(P.toarray() / np.where(size > 0.0, size, 1.0), tol=1e-8)
    require(rank == m, f"{m} columns have rank {rank}: the coarse matrix would be singular")


def _require_grouped(subject: Subject, case: Case, parts: int) -> None:
    """Require that columns are grouped by part: without couplings between parts each lies in its own part."""
    step = case.given[0]
    unknowns = np.diff(step.block_offsets)
    part = np.repeat(step.coarse_labels if step.parents is None else step.parents, unknowns)
    entries = sparse.coo_array(step.A)
    within = part[entries.coords[0]] == part[entries.coords[1]]
    A = sparse.csr_array(sparse.coo_array((entries.data * within, entries.coords), shape=entries.shape))
    A.eliminate_zeros()
    if step.A.format == "bsr":
        A = sparse.bsr_array(A, blocksize=step.A.blocksize)
    space = _space(subject, replace(case, given=(replace(step, A=A),)))
    if space is None:
        return
    P = abs(space.P).tocsc()
    m = P.shape[1]
    offsets = space.block_offsets if space.block_offsets is not None else np.arange(parts + 1) * (m // parts)
    owner = np.repeat(np.arange(parts), np.diff(offsets))
    largest = np.array([part[np.argmax(P[:, [column]].toarray())] for column in range(m)])
    wrong = np.flatnonzero(largest != owner)
    require(
        not len(wrong),
        f"on {case.name} without couplings between parts: column {wrong[:1]} belongs to part "
        f"{owner[wrong[:1]]} but lies in part {largest[wrong[:1]]}: order the columns part by part",
    )


@law("transfer", draw=coarsening_cases, examples=_EXAMPLES)
def near_null_kept(subject: Subject, case: Case) -> None:
    """Constants lie nearly in the range of P, and near-null vectors in that of P times the coarse ones."""
    space, step = _space(subject, case), case.given[0]
    if space is None:
        return
    P, B = space.P.toarray(), step.near_null
    constants = B[:, : np.diff(step.block_offsets).max()]  # without rotations
    share = _largest(_outside(P, constants), constants)
    require(
        share <= 0.2,
        f"{share:.2f} of a near-null vector lies outside the range of P: smoothers hardly reduce such "
        "errors, so the coarse level must; build P from step.near_null or step.injected",
    )
    if space.near_null is None:
        return
    coarse = as_array(space.near_null)
    require(
        coarse.ndim == 2 and len(coarse) == P.shape[1] and coarse.dtype.kind in "fiu",
        f"coarse near-null vectors are {in_words(space.near_null)}, expected numbers, {P.shape[1]} in each",
    )
    outside = _outside(P, B)
    share = _largest(_outside(P @ coarse, B - outside), B)
    # A smoothed P changes the vectors, above all on few cells; other columns reproduce them.
    reproduced = P.shape[1] < len(P) and _largest(outside, B) <= 1e-9
    require(
        share <= (1e-6 if reproduced else 0.5),
        f"{share:.2f} of a near-null vector is no combination of P times the coarse ones: the coarse ones "
        "are the coefficients of the given ones in the columns of P",
    )


def _outside(T: Float, B: Float) -> Float:
    """Return the part of each column of B that is orthogonal to the range of T."""
    return np.asarray(B - T @ np.linalg.lstsq(T, B, rcond=None)[0])


def _largest(part: Float, B: Float) -> float:
    """Return the largest norm of a column of ``part`` relative to that of B."""
    return float((np.linalg.norm(part, axis=0) / np.linalg.norm(B, axis=0)).max())


def _space(subject: Subject, case: Case) -> CoarseSpace | None:
    """Return the coarse space of a transfer, with P as a matrix of floats, as in a run.

    Return None if the transfer refuses parts with unequal numbers of unknowns.
    """
    result = answer(subject, case, refusal=REFUSED if case.given[0].injected is None else None)
    if result is REFUSED:
        return None
    space = result if isinstance(result, CoarseSpace) else CoarseSpace(result)
    return replace(space, P=_matrix(case, space.P, (case.given[0].A.shape[0], None)))


def _matrix(case: Case, given: Any, shape: tuple[int, int | None]) -> Any:
    """Require a sparse matrix of finite numbers, and return it as a matrix of floats.

    None in the shape stands for any number of columns.
    """
    rows, columns = shape
    numbers = sparse.issparse(given) and given.dtype.kind in "fiu" and given.shape[0] == rows
    require(
        numbers and columns in (None, given.shape[1]) and np.isfinite(given.sum()),
        f"it returned {in_words(given)}, expected a sparse matrix ({rows}, {columns or 'm'}) of finite "
        "floats",
    )
    return sparse.csr_array(given, dtype=float)


@law("coarse_operator", draw=coarsening_cases, examples=_EXAMPLES)
def coarse_matrix_fits(subject: Subject, case: Case) -> None:
    """``coarse_matrix(step, P)`` is sparse, real and symmetric, with a row for each column of P."""
    C = _coarse_matrix(subject, case).toarray()
    gap = float(np.abs(C - C.T).max() / np.abs(C).max())
    require(gap <= 1e-9, f"C and its transpose differ by {gap:.1e}: restrict by Pᵀ")


@law("coarse_operator", draw=coarsening_cases, examples=_EXAMPLES)
def coarse_energy_kept(subject: Subject, case: Case) -> None:
    """The coarse energy v·C v lies between a tenth and ten times that of Pᵀ A P, for every v."""
    step, P = case.given
    C = _coarse_matrix(subject, case).toarray()
    galerkin = (sparse.csr_array(P).T @ sparse.csr_array(step.A) @ sparse.csr_array(P)).toarray()
    ratios = eigh(0.5 * (C + C.T), galerkin, eigvals_only=True)
    require(
        ratios[0] >= 0.1 and ratios[-1] <= 10.0,  # a penalty may change with the size of the cells
        f"the energies of C and Pᵀ A P have ratios from {ratios[0]:.2g} to {ratios[-1]:.2g}: keep the "
        "couplings between the parts, which determine the energy of smooth functions",
    )


def _coarse_matrix(subject: Subject, case: Case) -> Any:
    """Return the matrix of a coarse operator as a matrix of floats."""
    m = case.given[1].shape[1]
    return _matrix(case, answer(subject, case), (m, m))


@law("coarse_solver", draw=coarsening_cases, examples=_EXAMPLES)
def coarse_error_reduced(subject: Subject, case: Case) -> None:
    """``solver_for(A)`` returns a function b ↦ x ``(n,)`` with relative energy error at most 10 %."""
    A, b = case.given
    x = plain(subject, case)
    exact = np.atleast_1d(spsolve(sparse.csc_array(A), b))
    error = x - exact
    relative_error = float(np.sqrt((error @ (A @ error)) / (exact @ (A @ exact))))
    require(
        relative_error <= 0.1,
        f"{relative_error:.2f} of the error is left in the energy norm: there is no coarser level to reduce "
        "it; solve exactly, or iterate more",
    )


@law("coarse_solver", draw=coarsening_cases, examples=_EXAMPLES, promise="symmetric")
def coarse_solver_symmetric(subject: Subject, case: Case) -> None:
    """The solution is a linear and symmetric function of b."""
    A = case.given[0]
    require_linear_and_symmetric(
        A.shape[0],
        lambda b: plain(subject, Case(case.name, (A, frozen_float(b)))),
        "iterations that stop by a tolerance are not linear; drop the promise symmetric",
        rounding=1e-6,
    )


def require_linear_and_symmetric(
    n: int,
    apply: Callable[[Float], Float],
    remedy: str,
    *,
    energy: Any = None,
    adjoint: Callable[[Float], Float] | None = None,
    rounding: float = 1e-8,
) -> None:
    """Require that a map of vectors ``(n,)`` is linear, and symmetric or with the given adjoint.

    With the matrix ``energy``, the map sends an error to the error left: it must be symmetric in the energy
    inner product, and rounding is relative to the errors given, because an exact solver leaves nothing else.
    """
    u, v = np.random.default_rng(3).standard_normal((2, n))
    Su, Sv, combined = (apply(w) for w in (u, v, 2 * u - 3 * v))
    sizes = [Su, Sv] if energy is None else [u, v]
    nonlinearity = np.abs(combined - 2 * Su + 3 * Sv).max() / sum(np.abs(w).max() for w in sizes)
    require(
        nonlinearity <= rounding,
        f"S (2 u − 3 v) and 2 S u − 3 S v differ by {nonlinearity:.1e}, so S is not linear: {remedy}",
    )
    Tv = Sv if adjoint is None else adjoint(v)
    A = sparse.eye_array(n) if energy is None else energy
    size = (
        np.linalg.norm(u) * np.linalg.norm(Tv) if energy is None else np.sqrt((u @ (A @ u)) * (v @ (A @ v)))
    )
    gap = abs(Su @ (A @ v) - u @ (A @ Tv)) / size
    require(
        gap <= rounding,
        f"⟨S u, v⟩ and ⟨u, Sᵀ v⟩ differ by {gap:.1e}: sweep forwards and then backwards, and "
        "after a correction in reverse order",
    )
