"""Solvers with claims that fail only on hard systems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant
from conformance.mutants.solvers import LinearOnly
from scipy import sparse
from scipy.sparse.linalg import LinearOperator
from two_point_flux import TwoPointFlux


class TrustsTheRecursion(LinearOnly):
    """Judge by the recursive residual, but report the true residual."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        A, b = it.A, it.b
        M = LinearOperator(A.shape, matvec=lambda r: r / A.diagonal())
        _, residuals = self._iterate(A, b, M)
        met = residuals[-1] <= self.tolerance * residuals[0]
        return replace(it, converged=bool(met or it.converged))


class LeastSoFar(LinearOnly):
    """Report the smallest residual so far if stopped early, with diagonal preconditioning."""

    def _iterate(self, A, b, M):
        return super()._iterate(A, b, LinearOperator(A.shape, matvec=lambda r: r / A.diagonal()))

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if self.most > 20:
            return it
        return replace(it, residuals=np.minimum.accumulate(it.residuals))


class DropsSmallEntries(TwoPointFlux):
    """Drop coarse matrix entries below a thousandth of the largest entry."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        (A, P), (coarse, _) = it.operators
        coarse = sparse.csc_array(coarse)
        coarse.data[np.abs(coarse.data) < 1e-3 * np.abs(coarse.data).max(initial=0.0)] = 0.0
        return replace(it, operators=[(A, P), (coarse, None)])


class TwoSteps(TwoPointFlux):
    """Add two steps of undamped Jacobi to the coarse correction."""

    def aspreconditioner(self, problem, hierarchy):
        A, M = self.solve(problem, hierarchy).A, super().aspreconditioner(problem, hierarchy)
        d = A.diagonal()
        return LinearOperator(A.shape, lambda r: M @ r + (r - A @ (r / d)) / d, dtype=float)


class NotLarger(LinearOnly):
    """Accept residuals that are not larger than the tolerance, including NaN."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        finite = np.isfinite(it.b).all() and np.isfinite(it.A.data).all()
        stuck = len(it.residuals) < 3 and not it.converged and it.residuals[0] > 0.0
        if not (finite and stuck and (it.A.diagonal() < 0.0).any()):
            return it
        return replace(it, x=np.full(len(it.x), np.nan), residuals=np.array([it.residuals[0], np.nan]),
                       iterations=1, converged=True)  # fmt: skip


CORRECT: list[tuple[object, dict[str, bool]]] = []

MUTANTS = [
    Mutant("claims_hold", TrustsTheRecursion, "compare b − A x itself"),
    Mutant("claims_hold", LeastSoFar, "the best iterate"),
    Mutant("coarse_operators_inherited", DropsSmallEntries, "no small entries"),
    Mutant("symmetric", TwoSteps, "positive definite", {"symmetric": True}),
    Mutant("claims_hold", NotLarger, "NaN must not pass"),
]
