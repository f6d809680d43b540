"""Correct discretisations, and discretisations that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant

from agglo_core import OptionError
from agglo_polydg_mg.polydg import PolyDG


class WithoutSamples(PolyDG):
    sample = None


class BlocksOfUnknowns(PolyDG):
    def assemble(self, problem, mesh):
        system = super().assemble(problem, mesh)
        return replace(system, block_offsets=np.arange(system.n + 1), mesh=None)


class HalvesProjections(PolyDG):
    def project(self, mesh, function):
        return 0.5 * super().project(mesh, function)


class SamplesCorners(PolyDG):
    def sample(self, mesh, x):
        samples = super().sample(mesh, x)
        return replace(samples, values=samples.values[:3])


class RefusesAll(PolyDG):
    def assemble(self, problem, mesh):
        raise OptionError("there is no such problem")


CORRECT = [(PolyDG, {"deterministic": True, "3d": True, "pickles": True})]

MUTANTS = [
    Mutant("answers", RefusesAll, "refuses every problem"),
    Mutant("has_all_methods", WithoutSamples, "no method sample"),
    Mutant("system_fits_mesh", BlocksOfUnknowns, "block_offsets holds the unknowns of cell c"),
    Mutant("constants_kept", HalvesProjections, "evaluate of the projection of 3"),
    Mutant("constants_kept", SamplesCorners, "sample of the projection of 3"),
]
