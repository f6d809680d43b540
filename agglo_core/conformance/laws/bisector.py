"""Laws for the sides and direct partitions returned by a bisector."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.agglomeration.border import one_sided_blocks
from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.conformance.base import Case, Subject, law, require, require_array
from agglo_core.conformance.inputs.cases import kway_case, large_cases
from agglo_core.conformance.inputs.questions import answer, chunks, large_graphs, plain, require_form
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.conformance.laws.parts import loose_parts
from agglo_core.graph import Graph


def one_sided(graph: Graph, sides: NDArray[Any]) -> Int:
    """Return the blocks of at least two cells whose cells are all on the same side."""
    alike = one_sided_blocks(graph, frozen_int(sides))
    return alike[graph.sizes[alike] > 1]


def bisects(subject: Subject) -> bool:
    return subject.has("bisect_level") or subject.has("bisect")


@law("bisector", draw=graph_cases, fixed=large_graphs, examples=60)
def side_array(subject: Subject, case: Case) -> None:
    """Sides are integers or booleans 0 and 1, or probabilities of side 1."""
    sides = require_form(subject, case, answer(subject, case))
    low, high = sides.min(), sides.max()
    remedy = "subtract the smallest label"
    if sides.dtype.kind == "f":
        remedy = "floats are probabilities of side 1: map scores to 0..1, or return scores > 0"
    require(low >= 0 and high <= 1, f"sides are {low}..{high}, expected 0..1: {remedy}")


@law(
    "bisector",
    draw=graph_cases,
    fixed=large_graphs,
    when=lambda subject: bisects(subject) and not subject.fallback,
)
def two_sides(subject: Subject, case: Case) -> None:
    """Both sides of a piece with at least two cells are nonempty, unless a fallback is declared."""
    graph = case.given[0]
    bad = one_sided(graph, plain(subject, case))
    require(
        not len(bad),
        f"all cells of a piece of {graph.sizes[bad].max(initial=0)} cells are on one side: split at the "
        "median where your rule finds no cut, and return any halving of indistinguishable cells, or "
        "declare fallback='inertial' (Component) for a model that may fail",
    )


@law("bisector", draw=graph_cases, fixed=large_graphs, promise="connected")
def connected(subject: Subject, case: Case) -> None:
    """Both sides of a connected graph are connected."""
    sides = plain(subject, case).astype(np.int64)
    pieces = max(loose_parts(case.given[0], sides).values())
    require(pieces == 1, f"a side is in {pieces} pieces: drop the promise connected")


@law("bisector", draw=graph_cases, fixed=large_graphs, promise="balanced")
def balanced(subject: Subject, case: Case) -> None:
    """The weight share of a side differs from 1/2 by at most the promised tolerance plus one cell."""
    tolerance = subject.promised("balanced")
    allowed = 0.0 if tolerance is True or tolerance is None else float(tolerance)
    graph, sides = case.given[0], plain(subject, case)
    for weights, block_sides in zip(chunks(graph, graph.weights), chunks(graph, sides), strict=True):
        total = weights.sum()
        deviation = abs(weights[block_sides == 1].sum() - 0.5 * total)
        require(
            deviation <= allowed * total + weights.max() + 1e-9 * total,
            f"the weight of a side differs from half of {total:.3g} by {deviation:.3g}, promised is a share "
            f"of {allowed:g} plus one cell: promise a wider tolerance",
        )


@law("bisector", draw=graph_cases, examples=50, when=lambda subject: subject.has("bisect_shares"))
def shares_kept(subject: Subject, case: Case) -> None:
    """By ``bisect_shares`` a side of each block has its share of the mass, up to a tenth and one cell."""
    graph, tool = case.given[0], subject.build()
    if not np.array_equal(graph.weights, graph.mass):
        return  # bisectors may balance weights where these differ from the mass
    shares = frozen_float(np.resize((0.1, 0.5, 1.0 / 3.0), graph.n_blocks))
    by_share = SimpleNamespace(bisect_level=lambda level, seeds: tool.bisect_shares(level, seeds, shares))
    sides = plain(subject, case, by_share)
    for b, (mass, side) in enumerate(zip(chunks(graph, graph.mass), chunks(graph, sides), strict=True)):
        wanted, found = shares[b] * mass.sum(), mass[side == 1].sum()
        deviation = min(abs(found - wanted), abs(mass.sum() - found - wanted))
        require(
            deviation <= 0.1 * mass.sum() + mass.max(),
            f"on {case.name}, block {b}: the share {shares[b]:.3g} was requested, and the sides have "
            f"{found:.3g} and {mass.sum() - found:.3g} of the mass {mass.sum():.3g}",
        )


def _partitions(subject: Subject) -> bool:
    return subject.partitions


def _whole_graphs(subject: Subject) -> Any:
    return graph_cases(subject, blocks=(1,))


@law(
    "bisector", draw=_whole_graphs, fixed=lambda _: large_cases("bisector")[:2], when=_partitions, examples=50
)
def kway_labels(subject: Subject, case: Case) -> None:
    """A direct partition returns integer labels from 0 to parts − 1, of shape (n,)."""
    graph = case.given[0]
    for parts in {1, min(graph.n, 3), min(graph.n, 300)}:
        kway = kway_case(case, parts)
        labels = require_array(answer(subject, kway), (graph.n,), "iub", what=f"on {kway.name}: partition")
        require(
            labels.min() >= 0 and labels.max() < parts,
            f"on {kway.name}: labels {labels.min()}..{labels.max()}, expected 0..{parts - 1}",
        )


@law("bisector", draw=_whole_graphs, promise="kway", when=_partitions, examples=50)
def kway_parts(subject: Subject, case: Case) -> None:
    """At least half of the requested parts are nonempty if no cell has the weight of half a part."""
    weights = case.given[0].weights
    for parts in (k for k in (2, 3, 7) if 2 * k <= len(weights) and 2 * k * weights.max() <= weights.sum()):
        n_nonempty = len(np.unique(plain(subject, kway_case(case, parts))))
        require(
            2 * n_nonempty >= parts and n_nonempty > 1,
            f"{n_nonempty} parts are nonempty of {parts}: target.parts is the number requested",
        )
