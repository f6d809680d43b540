"""Correct two-sided smoother, and two-sided smoothers that break one law first."""

from __future__ import annotations

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.sparse.linalg import spsolve_triangular


class _Sweeps:
    """Forward sweep before, backward sweep after the correction, and both as a plain smoother."""

    def __init__(self, level):
        self.A, self.steps = level.A, level.steps
        self.lower, self.upper = sparse.csr_array(sparse.tril(self.A)), sparse.csr_array(sparse.triu(self.A))

    def before(self, b):
        x = np.zeros(len(b))
        for _ in range(self.steps):
            x = x + spsolve_triangular(self.lower, b - self.A @ x)
        return x, b - self.A @ x

    def after(self, b, x):
        for _ in range(self.steps):
            x = x + spsolve_triangular(self.upper, b - self.A @ x, lower=False)
        return x

    def __call__(self, b, x):
        for _ in range(self.steps):
            x = x + spsolve_triangular(self.lower, b - self.A @ x)
        return _Sweeps.after(self, b, x)


class TwoSided:
    """Set up the class ``of`` on a level."""

    of = _Sweeps

    def setup(self, level):
        return self.of(level)


class NoAfter(TwoSided):
    class of(_Sweeps):
        after = None

        def __call__(self, b, x):
            return _Sweeps.after(self, b, x + spsolve_triangular(self.lower, b - self.A @ x))


class ReturnsX(TwoSided):
    class of(_Sweeps):
        def before(self, b):
            return super().before(b)[0]


class ResidualOfZero(TwoSided):
    class of(_Sweeps):
        def before(self, b):
            return super().before(b)[0], b.copy()


class BestStep(TwoSided):
    class of(_Sweeps):
        def before(self, b):
            x = super().before(b)[0]
            x = x * ((x @ b) / (x @ (self.A @ x) + 1e-300))
            return x, b - self.A @ x


class SameWayBack(TwoSided):
    class of(_Sweeps):
        def after(self, b, x):
            return x + spsolve_triangular(self.lower, b - self.A @ x)


class ForgetsX(TwoSided):
    class of(_Sweeps):
        def after(self, b, x):
            return spsolve_triangular(self.upper, b, lower=False)

        def __call__(self, b, x):
            return _Sweeps.__call__(_Plain(self), b, x)


class _Plain(_Sweeps):
    def __init__(self, other):
        self.__dict__.update(other.__dict__)


class UsesUpB(TwoSided):
    class of(_Sweeps):
        def before(self, b):
            x, r = super().before(b)
            if b.flags.writeable:
                b[:] = r
                r = b
            return x, r


class ZeroesB(TwoSided):
    class of(_Sweeps):
        def after(self, b, x):
            x = super().after(b, x)
            if b.flags.writeable:
                b[:] = 0.0
            return x


CORRECT = [(TwoSided, {"deterministic": True, "pickles": True, "symmetric": True})]

MUTANTS = [
    Mutant("both_sides", NoAfter, "there is no after"),
    Mutant("both_sides", ReturnsX, "the pair (x, b − A x)"),
    Mutant("both_sides", ResidualOfZero, "b − A x for the returned x"),
    Mutant("after_mirrors_before", BestStep, "no step length"),
    Mutant("after_mirrors_before", SameWayBack, "in reverse order"),
    Mutant("after_mirrors_before", ForgetsX, "use only the residual"),
    Mutant("both_sides", UsesUpB, "use a copy"),
    Mutant("both_sides", ZeroesB, "use a copy"),
]
