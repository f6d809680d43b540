"""Laws for the sides and direct partitions returned by a bisector."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.agglomeration.border import one_sided_blocks
from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.base.asking import for_target
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import seeds_for
from agglo_core.conformance.inputs.hard_cases import crowd_case, large_cases
from agglo_core.conformance.inputs.questions import answer, as_array, in_words, large_graphs, plain, same
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.conformance.process.fresh_import import import_again
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.protocols import Target

_SIZES = (1e-3, 0.03, 0.15, 0.5, 3.0, 8.0, 500.0)
_TARGETS = (
    *(Target(parts=parts) for parts in (2, 3, 5, 16, 400)),
    *(Target(h_star=size) for size in _SIZES),
    *(Target(parts=16, h_star=size) for size in (0.03, 3.0)),
)


def one_sided(graph: Graph, sides: NDArray[Any]) -> Int:
    """Return the blocks of at least two cells whose cells are all on the same side."""
    alike = one_sided_blocks(graph, frozen_int(sides))
    return alike[graph.sizes[alike] > 1]


def has_for_target(subject: Subject) -> bool:
    """Return True for a bisector with a method ``for_target``."""
    return _bisects(subject) and subject.has("for_target")


def _bisects(subject: Subject) -> bool:
    return subject.has("bisect_level") or subject.has("bisect")


@drawn_law("bisector", draw=graph_cases, fixed=large_graphs)
def side_array(subject: Subject, case: Case) -> None:
    """Sides form an array of integers, booleans or floats of shape (n,), with one side per cell."""
    result = answer(subject, subject.build(), case)
    sides = as_array(result)
    require(
        sides.shape == (case.size,) and sides.dtype.kind in "iubf",
        f"on {case.name}: it returned {in_words(result)}, expected an array of shape ({case.size},) of "
        "integers, booleans or floats: one side for each cell",
    )


@drawn_law("bisector", draw=graph_cases)
def side_values(subject: Subject, case: Case) -> None:
    """Sides are 0 and 1, or floats from 0 to 1 for the probability of side 1."""
    sides = np.asarray(answer(subject, subject.build(), case))
    low, high = sides.min(), sides.max()
    if sides.dtype.kind == "f":
        require(
            low >= 0 and high <= 1,
            f"on {case.name}: floats lie in {low:g}..{high:g}, expected probabilities of side 1 in 0..1: "
            "map scores there (1 / (1 + np.exp(-scores))), or return integers (scores > 0)",
        )
    require(
        low >= 0 and high <= 1,
        f"on {case.name}: sides are {low}..{high}, expected 0 and 1: subtract the smallest label",
    )


@law("bisector", when=has_for_target)
def told_the_target(subject: Subject) -> None:
    """The bisector returned by for_target splits pieces in two, unaffected by calls for other targets."""
    # Expected answers: from a freshly imported component for each target.
    test_cases = [_long_piece(), *large_cases("bisector")[1:], crowd_case("bisector", 40)]
    expected = {}
    for target in _targets_taken(subject):
        with import_again(subject) as unused:
            tool = for_target(unused.build(), target)
            expected[target] = [_both_sides(subject, tool, case, target) for case in test_cases]
    # Compare with the answers of a single object, for both orders of the targets.
    for order in (list(expected), list(reversed(expected))):
        _require_independent_targets(subject, test_cases, {target: expected[target] for target in order})


def _require_independent_targets(
    subject: Subject, test_cases: list[Case], expected: dict[Target, list[NDArray[Any]]]
) -> None:
    """Require that calls of ``for_target`` affect neither each other nor the object itself."""
    tool = subject.build()
    before = [plain(subject, tool, case) for case in test_cases]
    tools = [tool]
    for target, answers in expected.items():
        tools.append(for_target(tool, target))
        require(
            _answers_as_before(subject, tools[-1], test_cases, answers),
            f"for {target} its answer changes once for_target was called for another target: key any cache "
            "by the whole target",
        )
    require(
        all(
            map(_answers_as_before, repeat(subject), tools, repeat(test_cases), [before, *expected.values()])
        ),
        "its answer changes after for_target was called for another target: return a new object, and leave "
        "self unchanged",
    )


def _answers_as_before(
    subject: Subject, tool: Any, test_cases: list[Case], answers: list[NDArray[Any]]
) -> bool:
    return all(
        same(plain(subject, tool, case), expected) for case, expected in zip(test_cases, answers, strict=True)
    )


def _targets_taken(subject: Subject) -> list[Target]:
    """Return the targets that ``for_target`` of the component accepts."""
    targets = []
    for target in _TARGETS:
        with suppress(AggloError):
            for_target(subject.build(), target)
            targets.append(target)
    require(targets, "for_target refuses every target, both counts and sizes: return self instead")
    return targets


def _long_piece() -> Case:
    """Return a test case with a piece three times as long as wide, so that cuts along and across differ."""
    return Case("a long piece", (small_meshes.grid(15, 5, jitter=0.2).graph, seeds_for(1)))


def _both_sides(subject: Subject, tool: Any, case: Case, target: Target) -> NDArray[Any]:
    sides = plain(subject, tool, case)
    is_binary = set(np.unique(sides).tolist()) <= {0, 1}
    require(
        is_binary, f"on {case.name}, for {target}: its sides are {np.unique(sides)[:4]}, expected 0 and 1"
    )
    require(
        subject.fallback or not len(one_sided(case.given[0], sides)),
        f"on {case.name}, for {target}: all cells of a piece are on one side",
    )
    return sides


@drawn_law(
    "bisector",
    draw=graph_cases,
    fixed=large_graphs,
    when=lambda subject: _bisects(subject) and not subject.fallback,
)
def two_sides(subject: Subject, case: Case) -> None:
    """Both sides of a piece with at least two cells are nonempty, unless a fallback is declared."""
    graph = case.given[0]
    bad = one_sided(graph, plain(subject, subject.build(), case))
    require(
        not len(bad),
        f"on {case.name}: all cells of a piece of {graph.sizes[bad].max(initial=0)} cells are on one side: "
        "split at the median where your rule finds no cut, or declare fallback='inertial' (Component) for a "
        "model that may fail",
    )


_PARTS = (2, 3, 7)


def _partitions(subject: Subject) -> bool:
    return subject.partitions


def _whole_graphs(subject: Subject) -> Any:
    return graph_cases(subject, one_block=True)


@drawn_law("bisector", draw=_whole_graphs, fixed=lambda _: large_cases("bisector"), when=_partitions)
def kway_labels(subject: Subject, case: Case) -> None:
    """A direct partition returns integer labels from 0 to parts − 1, of shape (n,)."""
    graph = case.given[0]
    for parts in {1, *(k for k in _PARTS if k <= graph.n), min(graph.n, 300)}:
        result = _partition(subject, case, parts)
        labels = as_array(result)
        require(
            labels.shape == (graph.n,) and labels.dtype.kind in "iub",
            f"on {case.name}: partition returned {in_words(result)}, expected ({graph.n},) integers",
        )
        require(
            labels.min() >= 0 and labels.max() < parts,
            f"on {case.name}: labels {labels.min()}..{labels.max()} for {parts} parts, expected "
            f"0..{parts - 1}",
        )


@drawn_law("bisector", draw=_whole_graphs, when=_partitions)
def kway_parts(subject: Subject, case: Case) -> None:
    """At least half of the requested parts are nonempty if no cell has the weight of half a part."""
    weights = case.given[0].weights
    for parts in (k for k in _PARTS if 2 * k <= len(weights) and 2 * k * weights.max() <= weights.sum()):
        n_nonempty = len(np.unique(_partition(subject, case, parts)))
        require(
            2 * n_nonempty >= parts and n_nonempty > 1,
            f"on {case.name}: {n_nonempty} parts are nonempty of {parts}: target.parts is the number "
            "requested",
        )


def _partition(subject: Subject, case: Case, parts: int) -> Any:
    """Call ``partition`` of a bisector while its other methods are hidden."""
    tool = subject.build()

    class OnlyPartition:
        def partition(self, graph: object, target: object, seed: int) -> object:
            return tool.partition(graph, Target(parts=parts), seed)

    return answer(subject, OnlyPartition(), replace(case, name=f"{case.name} in {parts} parts"))
