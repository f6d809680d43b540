"""Parts for solvers, found by annealing: small moments of inertia, short interfaces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.anneal.rounds import Ramps
from agglo_core.anneal.solver_annealing import SolverAnnealing
from agglo_core.anneal.start_parts import Rival, Start, connected_parts, parts_within
from agglo_core.arrays import Int, frozen_int, splitmix
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.progress import TimeLimit
from agglo_core.protocols import Target
from agglo_core.refine.balance import BalanceRefiner
from agglo_core.refine.compactness.refiner import CompactnessRefiner
from agglo_core.refine.part_sizes import FREE, Balance

_ROUNDING = 1e-9


class Effort(NamedTuple):
    """Draws for each cell, and how often all is annealed, each time by other random numbers."""

    draws: int
    times: int = 1


EFFORTS = {"fast": Effort(300), "good": Effort(3000), "best": Effort(10_000, 3)}
"""By name: about 8, 80 and 800 µs for a cell."""

_RAMPS, _BALANCED = Ramps(2.0, 0.05, 0.0, 0.0), Ramps(2.0, 0.05, 0.3, 3.0)
"""Temperatures: at first what is there hardly matters, at last nothing is left to chance. Penalties are for
the squares of how many cells parts are beyond their bounds."""


def solver_parts(
    graph: Graph,
    target: Target,
    seed: int,
    effort: str,
    start: Start,
    rival: Rival,
    limit: TimeLimit,
    balance: Balance = FREE,
) -> Int:
    """Labels of a connected graph: the best for solvers that was found, the rival's included.

    With a size there are as many parts as the start has, or the rival if that has fewer; with a count so
    many, balanced if that is asked for.
    """
    other = rival(graph, target)
    first = _first(graph, target, start, other)
    best, least = other, (True, np.inf)
    for each in (other, first) if first is not other else (other,):
        labels = _finished(graph, each, target, balance)
        worth = _worth(graph, labels, balance)
        if worth < least:
            best, least = labels, worth
    size = np.inf if target.h_star is None else target.h_star * (1 + _ROUNDING)
    tool, much = SolverAnnealing(graph, size, balance), EFFORTS[effort]
    inner, ramps = tool.inward(first), _BALANCED if balance.asked else _RAMPS
    for each in splitmix(np.uint64(seed) + np.arange(much.times, dtype=np.uint64)).tolist():
        if limit.over():
            break
        annealed = tool.annealed(inner, ramps, much.draws, each, limit)
        labels = _finished(graph, tool.outward(annealed), target, balance)
        worth = _worth(graph, labels, balance)
        if worth < least:
            best, least = labels, worth
    return best


def _first(graph: Graph, target: Target, start: Start, other: Int) -> Int:
    """What annealing starts from: the start if it meets the target with no more parts than the other."""
    parts = int(other.max()) + 1
    first = connected_parts(graph, start(graph, min(parts, target.parts or parts)))
    if target.h_star is not None:
        first = parts_within(graph, first, target.h_star)
        return first if int(first.max()) < parts else other
    return first if int(first.max()) + 1 == parts else other


def _worth(graph: Graph, labels: Int, balance: Balance) -> tuple[bool, float]:
    """The less the better: those in balance before all others, then by the objective."""
    off = not balance.holds(graph.node_sizes(balance.size), labels)
    return off, OBJECTIVES["solver"].value(graph, labels)


def _finished(graph: Graph, labels: Int, target: Target, balance: Balance) -> Int:
    """Labels with sizes evened out as far as asked for, else after the default polish.

    The polish counts where it lowers the objective and keeps to the target.
    """
    k = int(labels.max()) + 1
    if balance.asked:
        even = BalanceRefiner(balance.size, balance.tolerance)
        return even.refine_parts(graph, labels, frozen_int(np.zeros(k)), target)
    after = CompactnessRefiner().refine_parts(graph, labels, frozen_int(np.zeros(k)), target)
    if len(np.unique(graph.components(after))) > k:
        return labels
    if target.h_star is not None and graph.part_diameters(after).max() > target.h_star * (1 + _ROUNDING):
        return labels
    value = OBJECTIVES["solver"].value
    return after if value(graph, after) < value(graph, labels) else labels
