"""Components that fail in another process, or for another target."""

from __future__ import annotations

from copy import copy

import numpy as np
from conformance.mutants.bisectors import Halves
from conformance.mutants.metrics import Extent
from conformance.mutants.mutant import Mutant

from agglo_core import OptionError

# --- other processes --------------------------------------------------------------------------------


class SeedsByName(Halves):
    """Draw a direction from the hash of a string, which differs between processes."""

    def bisect(self, graph, rng):
        seed = abs(hash(("direction", int(rng.integers(2**62)))))
        key = graph.centroids @ np.random.default_rng(seed).standard_normal(graph.dim)
        sides = np.zeros(graph.n, int)
        sides[np.argsort(key, kind="stable")[graph.n // 2 :]] = 1
        return sides


AXES = {}


class KeepsItsAxisInTheModule(Halves):
    """Keep the axis in the module, so that a pickled copy only has its key."""

    def __init__(self):
        self.key = "axis"
        AXES[self.key] = 1

    def bisect(self, graph, rng):
        order = np.argsort(graph.centroids[:, AXES.get(self.key, 0)], kind="stable")
        sides = np.zeros(graph.n, int)
        sides[order[(graph.n + 1) // 2 :]] = 1
        return sides

    def __setstate__(self, state):
        self.__dict__.update(state)


class ReadsItsSource(Extent):
    """Read a file of the repository by its path relative to the current folder."""

    def measure(self, mesh, labels):
        with open("pyproject.toml", encoding="utf-8") as file:
            file.read()
        return super().measure(mesh, labels)


# --- targets ----------------------------------------------------------------------------------------


class Along(Halves):
    """Cut off a share of the weight, across the longest side or across the shortest."""

    def __init__(self, across=False, share=0.5):
        self.across, self.share = across, share

    def bisect(self, graph, rng):
        axes = np.argsort(np.ptp(graph.centroids, axis=0), kind="stable")
        order = np.argsort(graph.centroids[:, axes[0 if self.across else -1]], kind="stable")
        weights = graph.weights[order]
        weights = weights if weights.sum() > 0.0 else np.ones(graph.n)
        sides = np.empty(graph.n, int)
        sides[order] = np.cumsum(weights) - 0.5 * weights > self.share * weights.sum()
        sides[order[0]], sides[order[-1]] = 0, int(graph.n > 1)
        return sides


class OneForAllSizes(Along):
    """Cut across for small parts, but cache results by number of parts, which is None for any size."""

    def __init__(self):
        super().__init__()
        self.made = {}

    def for_target(self, target):
        small = target.h_star is not None and target.h_star < 0.2
        return self.made.setdefault(target.parts, Along(small))


class InProportion(Along):
    """Cut off a third of the weight on the way to three parts."""

    def __init__(self):
        super().__init__()

    def for_target(self, target):
        return Along(share=(target.parts // 2) / target.parts) if target.parts else self


class KeepsALambda(Along):
    def __init__(self):
        super().__init__()

    def for_target(self, target):
        told = copy(self)
        told.share_of = lambda parts: 1.0 / parts
        return told


class RefusesAllTargets(Halves):
    def for_target(self, target):
        raise OptionError("not for targets")


class NoDust(Halves):
    """Correct: refuses unsupported targets."""

    def for_target(self, target):
        if target.h_star is not None and target.h_star < 0.01:
            raise OptionError(f"h_star is at least 0.01, given {target.h_star}")
        return copy(self)


CORRECT = [(NoDust, {"deterministic": True, "3d": True, "pickles": True})]

MUTANTS = [
    Mutant("same_in_another_process", SeedsByName, "built for another process"),
    Mutant("same_in_another_process", KeepsItsAxisInTheModule, "pickled for another", {"pickles": True}),
    Mutant("same_in_another_process", ReadsItsSource, "pyproject.toml"),
    Mutant("told_the_target", OneForAllSizes, "whole target"),
    Mutant("told_the_target", RefusesAllTargets, "refuses every target"),
    Mutant("told_the_target", InProportion, "parts=3", {"balanced": 0.02}),
    Mutant("told_the_target", KeepsALambda, "no lambdas", {"pickles": True}),
]
