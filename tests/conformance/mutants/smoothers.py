"""Correct smoothers, and smoothers that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.sparse.linalg import splu, spsolve_triangular


class Jacobi:
    """Jacobi with damping 4/3 over a bound of the largest eigenvalue."""

    factor = 1.0

    def setup(self, level):
        A, diagonal = level.A, level.A.diagonal()
        damping = self.factor * 4 / (3 * (abs(A).sum(axis=1) / diagonal).max())

        def smooth(b, x):
            for _ in range(level.steps):
                x = x + damping * (b - A @ x) / diagonal
            return x

        return smooth


class Forward:
    """Gauss-Seidel sweep from the first unknown to the last."""

    def setup(self, level):
        A, lower = level.A, sparse.csr_array(sparse.tril(level.A))

        def smooth(b, x):
            for _ in range(level.steps):
                x = x + spsolve_triangular(lower, b - A @ x)
            return x

        return smooth


class BackAndForth:
    """Gauss-Seidel sweep and its mirror image."""

    def setup(self, level):
        A, lower = level.A, sparse.csr_array(sparse.tril(level.A))
        upper = sparse.csr_array(sparse.triu(level.A))

        def smooth(b, x):
            for _ in range(level.steps):
                x = x + spsolve_triangular(lower, b - A @ x)
                x = x + spsolve_triangular(upper, b - A @ x, lower=False)
            return x

        return smooth


class SteepestDescent:
    """Steepest descent along the scaled residual, which is nonlinear."""

    def setup(self, level):
        A, diagonal = level.A, level.A.diagonal()

        def smooth(b, x):
            for _ in range(level.steps):
                r = b - A @ x
                z = r / diagonal
                curvature = z @ (A @ z)
                x = x + (r @ z / curvature) * z if curvature > 0 else x
            return x

        return smooth


class SolvesExactly:
    """Sparse factorisation, which leaves only rounding."""

    def setup(self, level):
        A, solve = level.A, splu(sparse.csc_array(level.A)).solve
        return lambda b, x: x + solve(b - A @ x)


class OneStep(Jacobi):
    """Damped Jacobi that ignores the number of steps."""

    def setup(self, level):
        return super().setup(replace(level, steps=1))


class SmoothsTheInherited(Jacobi):
    def setup(self, level):
        return super().setup(replace(level, A=level.inherited))


class _Changed(Jacobi):
    """Damped Jacobi with a result changed by ``after``."""

    def setup(self, level):
        smooth = super().setup(level)
        return lambda b, x: self.after(smooth(b, x))


class ListOfNumbers(_Changed):
    """Correct: a run accepts lists."""

    def after(self, x):
        return x.tolist()


class Rounded(_Changed):
    def after(self, x):
        return np.rint(x).astype(np.int64)


class AddsALittle(_Changed):
    def after(self, x):
        return x + 1e-6


class ShrinksALittle(_Changed):
    def after(self, x):
        return 0.999 * x


class Undamped(Jacobi):
    factor = 3.0


class TwoThirds(Jacobi):
    """Damping for eigenvalues up to 3, which strongly coupled unknowns of a cell exceed."""

    def setup(self, level):
        A, weights = level.A, 2 / (3 * level.A.diagonal())

        def smooth(b, x):
            for _ in range(level.steps):
                x = x + weights * (b - A @ x)
            return x

        return smooth


class Timid(Jacobi):
    factor = 0.01


class WritesIntoA(Jacobi):
    def setup(self, level):
        level.A.data[:] = level.A.data * (1 + 1e-14)
        return super().setup(level)


class WritesIntoX(Jacobi):
    def setup(self, level):
        smooth = super().setup(level)

        def inplace(b, x):
            x += smooth(b, x) - x
            return x

        return inplace


class MoreEachTime(Jacobi):
    def __init__(self):
        self.times = 0

    def setup(self, level):
        self.times += 1
        self.factor = 1.0 / self.times
        return super().setup(level)


class DrawsTheDamping(Jacobi):
    def setup(self, level):
        self.factor = np.random.default_rng().uniform(0.8, 1.0)
        return super().setup(level)


class NeedsTwoUnknowns(Jacobi):
    def setup(self, level):
        _ = level.A[1, 1]
        return super().setup(level)


class HoldsAFunction(Jacobi):
    def __init__(self):
        self.scale = lambda x: x


class Richardson(Jacobi):
    """Richardson with a step length for matrices with small entries."""

    def setup(self, level):
        A = level.A
        damping = min(1.0, 1.9 / abs(A).sum(axis=1).max()) if abs(A).max() < 1e3 else 0.3

        def smooth(b, x):
            for _ in range(level.steps):
                x = x + min(damping, 0.2) * (b - A @ x)
            return x

        return smooth


class StrongRichardson(Jacobi):
    """Richardson with damping only for even couplings."""

    def setup(self, level):
        A = level.A
        return lambda b, x: x + 0.2 * (b - A @ x) if abs(A).max() > 1e-3 else x


class KeepsTheLevel(Jacobi):
    """Keep the last level in self, shared by all levels."""

    def setup(self, level):
        self.level = level
        return self.smooth

    def smooth(self, b, x):
        return Jacobi().setup(self.level)(b, x)


_ALL = {"deterministic": True, "pickles": True}
CORRECT = [
    (Jacobi, {**_ALL, "symmetric": True}),
    (Forward, _ALL),
    (ListOfNumbers, {**_ALL, "symmetric": True}),
    (BackAndForth, {**_ALL, "symmetric": True}),
    (SteepestDescent, _ALL),
    (SolvesExactly, {**_ALL, "symmetric": True}),
]

MUTANTS = [
    Mutant("surroundings_kept", WritesIntoA, "work on a copy"),
    Mutant("answers", WritesIntoX, "change a copy"),
    Mutant("answers", Rounded, "floats of shape"),
    Mutant("error_reduced", OneStep, "level.steps times"),
    Mutant("solution_kept", SmoothsTheInherited, "with the matrix level.A"),
    Mutant("solution_kept", AddsALittle, "b − A x"),
    Mutant("solution_kept", ShrinksALittle, "residual b − A x alone"),
    Mutant("error_reduced", Undamped, "damp it"),
    Mutant("error_reduced", TwoThirds, "damp it"),
    Mutant("error_reduced", StrongRichardson, "damp it"),
    Mutant("error_reduced", Richardson, "the unit of 1 / A"),
    Mutant("prepared_apart", KeepsTheLevel, "not in self"),
    Mutant("rough_error_damped", Timid, "the rough half"),
    Mutant("smoother_symmetric", Forward, "forwards and then backwards", {"symmetric": True}),
    Mutant("smoother_symmetric", SteepestDescent, "nonlinear", {"symmetric": True}),
    Mutant("same_seed_same_result", DrawsTheDamping, "without a seed"),
    Mutant("same_seed_same_result", MoreEachTime, "keep nothing between calls"),
    Mutant("answers", NeedsTwoUnknowns, "a level of 1 "),
    Mutant("pickles", HoldsAFunction, "no lambdas", {"pickles": True}),
]
