"""Solvers: correct ones, and those that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, spsolve_triangular

from agglo_core import OptionError
from agglo_core.conformance.reference import TwoPointFlux
from agglo_core.problems import Diffusion, Linear


class LinearOnly(TwoPointFlux):
    """Takes systems of one unknown per cell, as many algebraic methods do."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Linear) or len(problem.b) != hierarchy.graph.n:
            raise OptionError("a Linear problem of one unknown per cell is wanted")
        return super().solve(problem, hierarchy)


class DiffusionOnly(TwoPointFlux):
    """Takes what it discretises itself."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Diffusion):
            raise OptionError("a Diffusion is wanted")
        return super().solve(problem, hierarchy)


class RefusesAll(TwoPointFlux):
    def solve(self, problem, hierarchy):
        raise OptionError("not today")


class SquaresOnly(TwoPointFlux):
    """Refuses some diffusion problems of the plane and takes others."""

    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and np.ptp(hierarchy.graph.measures) > 1e-9:
            raise OptionError("cells of one size are wanted")
        return super().solve(problem, hierarchy)


class NotLinear(LinearOnly):
    """Scales what a large right-hand side gives."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if (problem.b > 2.0).any():
            it = replace(it, x=1.5 * it.x)
        return it


class NoFirstResidual(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, residuals=it.residuals[1:])


class StopsEarly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, x=1.01 * it.x)


class OtherSystem(TwoPointFlux):
    """Doubles the right-hand side of a linear system and solves that."""

    def solve(self, problem, hierarchy):
        linear = isinstance(problem, Linear)
        return super().solve(replace(problem, b=2 * problem.b) if linear else problem, hierarchy)


class OptimisticResidual(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        x = it.x * (1 + 1e-6)
        return replace(it, x=x)


class AlwaysConverged(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, converged=True, reason="done")


class TransposedP(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        (A, P), *rest = it.operators
        return replace(it, operators=[(A, P.T), *rest])


class NumbersOnly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and not isinstance(problem.kappa, float):
            problem = replace(problem, kappa=1.0)
        return super().solve(problem, hierarchy)


class ForgetsKappa(TwoPointFlux):
    def solve(self, problem, hierarchy):
        problem = replace(problem, kappa=1.0) if isinstance(problem, Diffusion) else problem
        return super().solve(problem, hierarchy)


class OneComponentOnly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        if hierarchy.graph.components().max() > 0:
            raise RuntimeError("the mesh must be connected")
        return super().solve(problem, hierarchy)


class GaussSeidel(TwoPointFlux):
    def aspreconditioner(self, problem, hierarchy):
        A = self.solve(problem, hierarchy).A
        lower = sparse.csr_array(sparse.tril(A))
        return LinearOperator(A.shape, matvec=lambda r: spsolve_triangular(lower, r), dtype=float)


CORRECT = [
    (TwoPointFlux, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (LinearOnly, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (DiffusionOnly, {"deterministic": True, "3d": True, "pickles": True}),
]

MUTANTS = [
    Mutant("answers", RefusesAll, "refuses every problem"),
    Mutant("answers", SquaresOnly, "cells of one size"),
    Mutant("solution_record", NoFirstResidual, "the first is that of the start"),
    Mutant("solves", StopsEarly, "direct solution"),
    Mutant("own_system_kept", OtherSystem, "undo any scaling"),
    Mutant("true_residual", OptimisticResidual, "recompute it from x"),
    Mutant("failure_flagged", AlwaysConverged, "compare the true residual"),
    Mutant("operators_chain", TransposedP, "expected"),
    Mutant("field_forms_agree", NumbersOnly, "than as numbers"),
    Mutant("linear_in_the_data", ForgetsKappa, "twice the coefficient"),
    Mutant("linear_in_the_data", NotLinear, "twice the right-hand side"),
    Mutant("disconnected_solved", OneComponentOnly, "must be connected"),
    Mutant("symmetric", GaussSeidel, "mirror", {"symmetric": True}),
]
