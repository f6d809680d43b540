"""Correct estimators, and estimators that break one law first."""

from __future__ import annotations

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import OptionError
from agglo_core.adaptivity.estimators import GradientJump, Residual
from agglo_polydg_mg.hierarchical import Hierarchical


class RefusesAll(Residual):
    def indicate(self, solution):
        raise OptionError("there is no such solution")


class PerUnknown(Residual):
    def indicate(self, solution):
        return np.repeat(super().indicate(solution), 3)


class Signed(Residual):
    def indicate(self, solution):
        return -super().indicate(solution)


class Nothing(Residual):
    def indicate(self, solution):
        return 0.0 * super().indicate(solution)


class ByTheFirstCell(Residual):
    """Give the terms of cells with odd numbers to the cell before."""

    def indicate(self, solution):
        values = np.array(super().indicate(solution))
        odd = np.arange(1, len(values), 2)
        values[odd - 1] = np.hypot(values[odd - 1], values[odd])
        values[odd] = 0.0
        return values


class ForgetsTheData(Residual):
    """Take the whole boundary values for jumps."""

    def indicate(self, solution):
        values = np.array(super().indicate(solution))
        cells = solution.mesh.face_cells[solution.mesh.outer_faces, 0]
        values[cells] += np.abs(solution.evaluate(solution.mesh.cell_centroids[cells]))
        return values


class WithoutTheCoefficient(Residual):
    def indicate(self, solution):
        return super().indicate(solution) / np.sqrt(float(solution.problem.kappa))


CORRECT = [
    (each, {"deterministic": True, "3d": True, "pickles": True})
    for each in (Residual, GradientJump, Hierarchical)
]

MUTANTS = [
    Mutant("answers", RefusesAll, "refuses every solution"),
    Mutant("answers", PerUnknown, "floats of shape (20,)"),
    Mutant("one_per_cell", Signed, "expected finite numbers"),
    Mutant("one_per_cell", Nothing, "all indicators are 0"),
    Mutant("follows_numbering", ByTheFirstCell, "renumbered cells change an indicator"),
    Mutant("zero_for_exact", ForgetsTheData, "the estimate of the exact solution"),
    Mutant("near_the_error", WithoutTheCoefficient, "with kappa 1000"),
]
