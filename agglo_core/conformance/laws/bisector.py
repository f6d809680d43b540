"""Laws of the sides that a bisector returns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.agglomeration.border import one_sided_blocks
from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.case import Case
from agglo_core.conformance.hard_cases import crowded, unusual_cases
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, as_array, every_graph, in_words, plain, same
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import require
from agglo_core.graph import Graph
from agglo_core.protocols import Target

__all__ = ["one_sided"]


_TARGETS = (Target(parts=2), Target(h_star=0.5), Target(parts=400), Target(h_star=500.0))


def one_sided(graph: Graph, sides: NDArray[Any]) -> Int:
    """Blocks of two cells or more that are all on one side."""
    alike = one_sided_blocks(graph, frozen_int(sides))
    return alike[graph.sizes[alike] > 1]


def _bisects(subject: Subject) -> bool:
    return subject.has("bisect_level") or subject.has("bisect")


@law("bisector")
def side_array(subject: Subject) -> None:
    """It returns one side per cell: an array of integers, booleans or floats of shape (n,)."""
    for case in every_graph(subject):
        given = answer(subject, subject.build(), case)
        sides = as_array(given)
        require(
            sides.shape == (case.size,) and sides.dtype.kind in "iubf",
            f"on {case.name}: it returned {in_words(given)}, expected an array of shape ({case.size},) of "
            "integers, booleans or floats: one side for each cell",
        )


@law("bisector")
def side_values(subject: Subject) -> None:
    """Sides are 0 and 1; floats are the probability of side 1, from 0 to 1."""
    for case in every_graph(subject):
        given = np.asarray(answer(subject, subject.build(), case))
        low, high = given.min(), given.max()
        if given.dtype.kind == "f":
            require(
                low >= 0 and high <= 1,
                f"on {case.name}: floats lie in {low:g}..{high:g}, expected probabilities of side 1 in 0..1: "
                "map scores there (1 / (1 + np.exp(-scores))), or return integers (scores > 0)",
            )
        require(
            low >= 0 and high <= 1,
            f"on {case.name}: sides are {low}..{high}, expected 0 and 1: subtract the smallest label",
        )


def _told(subject: Subject) -> bool:
    return _bisects(subject) and (subject.has("for_target") or subject.has("aim"))


@law("bisector", when=_told)
def told_the_target(subject: Subject) -> None:
    """What for_target returns splits pieces in two, whatever target others are told, as does the original."""
    tool = subject.build()
    asked = [*unusual_cases("bisector")[:2], crowded("bisector", 40)]
    tools = [tool]
    before = [[plain(subject, tool, case) for case in asked]]
    for target in _TARGETS:
        tools.append(_for_target(tool, target))
        before.append([_both_sides(subject, tools[-1], case, target) for case in asked])
        fresh = _for_target(subject.build(), target)
        require(
            all(same(plain(subject, fresh, case), one) for case, one in zip(asked, before[-1], strict=True)),
            f"for {target} it answers otherwise once for_target was called for another target: what it keeps "
            "must be keyed by the whole target",
        )
    for told, answers in zip(tools, before, strict=True):
        after = [plain(subject, told, case) for case in asked]
        require(
            all(map(same, answers, after)),
            "it answers otherwise after for_target was called for another target: return a new object, and "
            "leave self as it is",
        )


def _for_target(tool: Any, target: Target) -> Any:
    """The bisector for a target; Broken if it is none."""
    told = (getattr(tool, "for_target", None) or tool.aim)(target)
    bisects = any(callable(getattr(told, name, None)) for name in ("bisect_level", "bisect"))
    require(
        bisects and not isinstance(told, type),
        f"for {target} it returned {in_words(told)}, expected an object with bisect_level or bisect",
    )
    return told


def _both_sides(subject: Subject, tool: Any, case: Case, target: Target) -> NDArray[Any]:
    sides = plain(subject, tool, case)
    known = set(np.unique(sides).tolist()) <= {0, 1}
    require(known, f"on {case.name}, for {target}: its sides are {np.unique(sides)[:4]}, expected 0 and 1")
    require(
        subject.fallback or not len(one_sided(case.given[0], sides)),
        f"on {case.name}, for {target}: a piece came out on one side",
    )
    return sides


@law("bisector", when=_bisects)
def two_sides(subject: Subject) -> None:
    """Both sides of a piece have a cell wherever it has two cells (with a declared fallback: mostly)."""
    bad, pieces = [], 0
    for case in every_graph(subject):
        graph = case.given[0]
        alike = one_sided(graph, plain(subject, subject.build(), case))
        pieces += graph.n_blocks
        bad += [f"{case.name}, a piece of {graph.sizes[block]} cells" for block in alike]
    allowed = pieces // 2 if subject.fallback else 0
    require(
        len(bad) <= allowed,
        f"on {'; '.join(bad[:3])}: all cells came out on one side: split at the median where your rule finds "
        "no cut, or declare fallback='inertial' (Component) for a model that may fail",
    )
