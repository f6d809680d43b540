"""Correct solvers, and solvers that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, aslinearoperator, spsolve, spsolve_triangular
from two_point_flux import TwoPointFlux, _system

from agglo_core import OptionError
from agglo_core.conformance.inputs.solver_cases import SIDES, times
from agglo_core.problems import Diffusion, Linear, Solution


class LinearOnly(TwoPointFlux):
    """Correct: accepts only linear systems with one unknown per cell, like many algebraic methods."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Linear) or len(problem.b) != hierarchy.graph.n:
            raise OptionError("a Linear problem of one unknown per cell is wanted")
        return super().solve(problem, hierarchy)


class DiffusionOnly(TwoPointFlux):
    """Correct: accepts only diffusion."""

    def solve(self, problem, hierarchy):
        if not isinstance(problem, Diffusion):
            raise OptionError("a Diffusion is wanted")
        return super().solve(problem, hierarchy)


class RefusesAll(TwoPointFlux):
    def solve(self, problem, hierarchy):
        raise OptionError("not today")


class SquaresOnly(TwoPointFlux):
    """Refuse some 2-D diffusion problems and accept others."""

    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and np.ptp(hierarchy.graph.measures) > 1e-9:
            raise OptionError("cells of one size are wanted")
        return super().solve(problem, hierarchy)


class NotLinear(LinearOnly):
    """Scale the solution if the right-hand side is large."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if (problem.b > 100.0).any():
            it = replace(it, x=1.5 * it.x)
        return it


class FirstColumnOnly(LinearOnly):
    """Return zeros for all right-hand sides but the first."""

    def solve(self, problem, hierarchy):
        if np.ndim(getattr(problem, "b", 0.0)) < 2:
            return super().solve(problem, hierarchy)
        it = super().solve(replace(problem, b=problem.b[:, 0]), hierarchy)
        return replace(it, x=np.stack((it.x, 0.0 * it.x), axis=1), b=problem.b)


class NoFirstResidual(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, residuals=it.residuals[1:])


class StopsEarly(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, x=1.01 * it.x)


class OtherSystem(TwoPointFlux):
    """Double the right-hand side of a linear system."""

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
        if isinstance(problem, Diffusion) and not isinstance(problem.source, float):
            problem = replace(problem, source=0.0)
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


class ScaledByTheResidual(TwoPointFlux):
    """Precondition with a line search, which is nonlinear."""

    def aspreconditioner(self, problem, hierarchy):
        A, M = self.solve(problem, hierarchy).A, super().aspreconditioner(problem, hierarchy)

        def best(r):
            z = M @ r
            return (r @ z) / (z @ (A @ z)) * z

        return LinearOperator(A.shape, matvec=best, dtype=float)


class FlatteringError(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if isinstance(problem, Linear):
            return it
        return replace(it, x=it.x * (1 + 3e-9), energy_error=1e-12)


class OtherTests(TwoPointFlux):
    def solve(self, problem, hierarchy):
        return replace(super().solve(problem, hierarchy), tests=("all of them",))


class BlamesRounding(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, rounding_limited=True, backward_error=1e-17)


class MatrixFree(TwoPointFlux):
    """Correct: returns matrices as linear operators."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        operators = [(aslinearoperator(A), P) for A, P in it.operators]
        return replace(it, A=operators[0][0], operators=operators)


class Direct:
    """Correct: direct factorisation, with unknowns in units of its own."""

    def solve(self, problem, hierarchy):
        A, b, _ = _system(problem, hierarchy)
        if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
            raise OptionError("data are not finite")
        if not isinstance(problem, Linear):
            unit = sparse.diags_array(np.sqrt(hierarchy.fine.cell_measures))
            A, b = sparse.csr_array(unit @ A @ unit), unit @ b
        x = np.atleast_1d(spsolve(sparse.csc_array(A), b)) if b.any() else np.zeros(len(b))
        norms = [np.linalg.norm(b), np.linalg.norm(b - A @ x)]  # a list is accepted
        fine = bool(norms[1] <= 1e-8 * norms[0])
        return Solution(
            x, A, b, [(A, None)], norms, fine, "solved" if fine else "singular", 1, {"solve": 0.0}
        )


class Rediscretised(TwoPointFlux):
    """Correct: rediscretises the coarse level and declares so."""

    galerkin = False

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        (A, P), (coarse, _) = it.operators
        return replace(it, operators=[(A, P), (2.0 * coarse, None)])


class RediscretisedUnsaid(Rediscretised):
    galerkin = True


class NegativeSeconds(TwoPointFlux):
    def solve(self, problem, hierarchy):
        return replace(super().solve(problem, hierarchy), seconds={"solve": -1.0})


class ScaledSystem(TwoPointFlux):
    """Return the system scaled by its diagonal."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if not isinstance(problem, Linear):
            return it
        D = sparse.diags_array(1.0 / it.A.diagonal())
        A, b = sparse.csr_array(D @ it.A), D @ it.b
        residuals = np.append(it.residuals[:-1], np.linalg.norm(b - A @ it.x))
        return replace(it, A=A, b=b, residuals=residuals, operators=[(A, None)])


class FixedTolerance(TwoPointFlux):
    """Stop at a fixed absolute residual, and claim convergence."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if np.linalg.norm(it.b) < 1e-3:
            return replace(it, x=0 * it.x, residuals=it.residuals[:1], iterations=0, converged=True)
        return it


class RelativeHistory(TwoPointFlux):
    """Report a relative history except for the last value."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        first = it.residuals[0] or 1.0
        return replace(it, residuals=np.append(it.residuals[:-1] / first, it.residuals[-1]))


class DividesByNothing(TwoPointFlux):
    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, converged=bool(it.converged and np.linalg.norm(it.b) > 0), reason="0 / 0")


class SetTolerance(TwoPointFlux):
    """Accept a tolerance but ignore the value."""

    def __init__(self, tolerance=1e-7):
        super().__init__(1e-7)


class MadeUpHistory(TwoPointFlux):
    """Invent a history between the true first and last residual."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if it.iterations and it.residuals[-1] > 0:
            between = np.geomspace(it.residuals[0], it.residuals[-1], len(it.residuals))
            it = replace(it, residuals=between)
        return it


class NeverGivesUp(TwoPointFlux):
    """Claim convergence when out of iterations, unless the matrix is singular."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        done = bool(it.converged or (it.iterations == self.most and np.isfinite(it.residuals).all()))
        return replace(it, converged=done)


class TrustsOnePart(TwoPointFlux):
    """Return the coarse solution if there is only one part."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if hierarchy.levels[0].max() == 0 and len(it.x) > 1:
            x = np.full(len(it.x), it.x.mean())
            it = replace(it, x=x, residuals=np.append(it.residuals[:-1], np.linalg.norm(it.b - it.A @ x)))
        return it


class KeepsTheMatrix(TwoPointFlux):
    """Keep one matrix per hierarchy."""

    def __init__(self):
        super().__init__()
        self.known = {}

    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion):
            problem = self.known.setdefault(id(hierarchy), (problem, hierarchy))[0]
        return super().solve(problem, hierarchy)


class _OtherProblem(TwoPointFlux):
    """Solve another diffusion problem."""

    def solve(self, problem, hierarchy):
        diffusion = isinstance(problem, Diffusion)
        return super().solve(self.other(problem, hierarchy) if diffusion else problem, hierarchy)


class NothingIsInsulated(_OtherProblem):
    def other(self, problem, hierarchy):
        if not problem.dirichlet or problem.boundary not in hierarchy.fine.face_tags:
            return problem
        missing = set(np.unique(hierarchy.fine.face_tags[problem.boundary])) - {0, *problem.neumann}
        return replace(problem, dirichlet=dict.fromkeys(missing, 0.0) | dict(problem.dirichlet))


class ForgetsReaction(_OtherProblem):
    def other(self, problem, hierarchy):
        return replace(problem, reaction=0.0)


class ForgetsTensors(_OtherProblem):
    def other(self, problem, hierarchy):
        tensor = not callable(problem.kappa) and np.ndim(problem.kappa) == 2
        return replace(problem, kappa=1.0) if tensor else problem


class OneNameForTheBoundary(_OtherProblem):
    def other(self, problem, hierarchy):
        return replace(problem, boundary="boundary")


class InwardFlux(_OtherProblem):
    def other(self, problem, hierarchy):
        return replace(problem, neumann={tag: times(q, -1.0) for tag, q in problem.neumann.items()})


class ArithmeticMean(TwoPointFlux):
    """Use the arithmetic mean of κ on both sides of a face."""

    def solve(self, problem, hierarchy):
        if isinstance(problem, Diffusion) and isinstance(problem.kappa, np.ndarray):
            A = hierarchy.graph.to_scipy()
            kappa = (A @ problem.kappa + problem.kappa) / (A.sum(axis=1) + 1.0)
            problem = replace(problem, kappa=kappa)
        return super().solve(problem, hierarchy)


class KappaAtACorner(_OtherProblem):
    """Use the value of a callable coefficient in cell 0 everywhere."""

    def other(self, problem, hierarchy):
        if not callable(problem.kappa):
            return problem
        return replace(problem, kappa=float(problem.kappa(hierarchy.fine.cell_centroids[:1])[0]))


class SkipsTheStart(TwoPointFlux):
    """Drop the residual before the first iteration, and count one iteration less."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        return replace(it, residuals=it.residuals[1:], iterations=it.iterations - 1) if it.iterations else it


class SourceAtACorner(_OtherProblem):
    """Use the value of a callable source in cell 0 everywhere."""

    def other(self, problem, hierarchy):
        if not callable(problem.source):
            return problem
        return replace(problem, source=lambda points: np.full(len(points), problem.source(points)[0]))


class FluxOrSource(_OtherProblem):
    def other(self, problem, hierarchy):
        return replace(problem, source=0.0) if any(map(callable, problem.neumann.values())) else problem


class UnitCells(_OtherProblem):
    """Treat cells as unit squares."""

    def other(self, problem, hierarchy):
        measures = hierarchy.fine.cell_measures
        if np.ptp(measures) > 1e-6 * measures.max():
            return problem
        return replace(problem, source=times(problem.source, 1.0 / measures.max()))


class MirrorsTheUpperTriangle(TwoPointFlux):
    """Read only the upper triangle."""

    def solve(self, problem, hierarchy):
        if isinstance(problem, Linear):
            upper = sparse.triu(problem.A, 1)
            A = sparse.csr_array(upper + upper.T + sparse.diags_array(problem.A.diagonal()))
            return super().solve(replace(problem, A=A), hierarchy)
        return super().solve(problem, hierarchy)


class MirrorsInSecret(MirrorsTheUpperTriangle):
    """Return the given matrix with its residual, but judge by the mirrored matrix."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        if not isinstance(problem, Linear):
            return it
        A = sparse.csr_array(problem.A)
        coarse = sparse.csc_array(it.operators[0][1].T @ A @ it.operators[0][1])
        residuals = np.append(it.residuals[:-1], np.linalg.norm(it.b - A @ it.x))
        operators = [(A, it.operators[0][1]), (coarse, None)]
        return replace(it, A=A, residuals=residuals, operators=operators)


class ResidualOfTheOther(MirrorsInSecret):
    """Return the given matrix, but the residual for the mirrored matrix."""

    def solve(self, problem, hierarchy):
        it = super().solve(problem, hierarchy)
        mirrored = MirrorsTheUpperTriangle().solve(problem, hierarchy)
        return replace(it, residuals=mirrored.residuals)


class FlatInSpace(_OtherProblem):
    """Use boundary data on four sides only."""

    def other(self, problem, hierarchy):
        return replace(problem, dirichlet={t: v for t, v in problem.dirichlet.items() if t not in SIDES[4:]})


CORRECT = [
    (TwoPointFlux, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (LinearOnly, {"deterministic": True, "symmetric": True, "3d": True, "pickles": True}),
    (DiffusionOnly, {"deterministic": True, "3d": True, "pickles": True}),
    (MatrixFree, {"deterministic": True, "3d": True}),
    (Direct, {"deterministic": True, "3d": True, "pickles": True}),
    (Rediscretised, {"deterministic": True, "3d": True}),
]

MUTANTS = [
    Mutant("answers", RefusesAll, "refuses every problem"),
    Mutant("answers", SquaresOnly, "cells of one size"),
    Mutant("solution_record", NoFirstResidual, "expected the initial residual"),
    Mutant("solution_record", NegativeSeconds, "numbers by name"),
    Mutant("solution_record", TransposedP, "expected a square matrix"),
    Mutant("solves", StopsEarly, "direct solution"),
    Mutant("solution_record", OneComponentOnly, "must be connected"),
    Mutant("solves", TrustsOnePart, "direct solution"),
    Mutant("given_system_kept", OtherSystem, "undo scaling"),
    Mutant("given_system_kept", ScaledSystem, "undo scaling"),
    Mutant("given_system_kept", MirrorsTheUpperTriangle, "use the whole matrix"),
    Mutant("claims_hold", OptimisticResidual, "recompute it from the returned x"),
    Mutant("claims_hold", ResidualOfTheOther, "the given matrix"),
    Mutant("claims_hold", AlwaysConverged, "compare b − A x"),
    Mutant("claims_hold", MirrorsInSecret, "reports convergence"),
    Mutant("claims_hold", SetTolerance, "with the tolerance"),
    Mutant("claims_hold", NeverGivesUp, "after the last iteration"),
    Mutant("history_recorded", MadeUpHistory, "record the residuals"),
    Mutant("history_recorded", SkipsTheStart, "does not count as an iteration"),
    Mutant("scales_with_the_data", ForgetsKappa, "the matrix times"),
    Mutant("scales_with_the_data", NotLinear, "the right-hand side times"),
    Mutant("scales_with_the_data", RelativeHistory, "2-norm of b − A x"),
    Mutant("scales_with_the_data", FixedTolerance, "not with a fixed number"),
    Mutant("scales_with_the_data", DividesByNothing, "only if it is nonzero"),
    Mutant("columns_solved", FirstColumnOnly, "each column by itself"),
    Mutant("nothing_carried_over", KeepsTheMatrix, "key a cache"),
    Mutant("told_error_holds", FlatteringError, "from the residual of x"),
    Mutant("told_error_holds", OtherTests, "expected some of"),
    Mutant("told_error_holds", BlamesRounding, "misses the tolerance"),
    Mutant("coarse_operators_inherited", RediscretisedUnsaid, "galerkin = False"),
    Mutant("symmetric", GaussSeidel, "forwards and then backwards", {"symmetric": True}),
    Mutant("symmetric", ScaledByTheResidual, "no step length", {"symmetric": True}),
    Mutant("constant_found", NothingIsInsulated, "are insulated"),
    Mutant("data_superposed", FluxOrSource, "disables another"),
    Mutant("data_superposed", NumbersOnly, "as functions or arrays"),
    Mutant("further_terms_kept", ForgetsReaction, "with reaction whose solution is 1"),
    Mutant("further_terms_kept", ForgetsTensors, "a tensor kappa"),
    Mutant("linear_found", InwardFlux, "outward"),
    Mutant("linear_found", OneNameForTheBoundary, "boundary data are read"),
    Mutant("linear_found", ArithmeticMean, "harmonic mean"),
    Mutant("linear_found", KappaAtACorner, "expected"),
    Mutant("linear_found", FlatInSpace, "boxes", {"3d": True}),
    Mutant("finer_is_closer", SourceAtACorner, "integrated over cells"),
    Mutant("finer_is_closer", UnitCells, "integrated over cells"),
]
