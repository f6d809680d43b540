"""Laws that take their time: large meshes, and how the time grows with them."""

from __future__ import annotations

import time

import numpy as np

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import asked, seeds_for
from agglo_core.conformance.inputs.questions import answer, plain
from agglo_core.conformance.inputs.unusual_graphs import clumps
from agglo_core.conformance.laws.bisector import one_sided
from agglo_core.conformance.laws.parts import same_parts
from agglo_core.conformance.laws.refiner import in_more_pieces
from agglo_core.graph import Graph

_SMALL, _LARGE = (50, 40), (100, 80)  # cells across and up
_HUGE = (250, 200)  # their square is more than 32 bits hold
_STEEP = 1.7  # power of the number of cells; n log n is some 1.1, 2 is quadratic
_NOTICEABLE = 0.5  # CPU seconds for the larger mesh below which nothing is held against a component


def _wanted(subject: Subject) -> bool:
    return subject.thorough


@law("bisector", "refiner", "fixer", when=_wanted)
def large_meshes(subject: Subject) -> None:
    """On 50,000 cells it answers as on few: both sides, all parts, none in more pieces than before."""
    case = _case(subject.kind, _HUGE)
    graph = case.given[0]
    values = plain(subject, subject.build(), case)
    if subject.kind == "bisector":
        apart = not len(one_sided(graph, values))
        require(apart or subject.fallback, f"on {case.name}: all cells came out on one side")
        return
    labels = case.given[1]
    require(same_parts(graph, labels, values), f"on {case.name}: the parts are no longer those they were")
    worse = in_more_pieces(subject.kind, graph, labels, values)
    require(not worse, f"on {case.name}: {len(worse)} parts are in more pieces than they may be")


@law("refiner", "fixer", when=_wanted)
def time_grows_with_the_mesh(subject: Subject) -> None:
    """Four times as many cells take far less than sixteen times as long."""
    answer(subject, subject.build(), _case(subject.kind, (12, 10)))  # kernels compile here, off the clock
    small, large = (_seconds(subject, _case(subject.kind, size)) for size in (_SMALL, _LARGE))
    power = np.log(large / max(small, 1e-4)) / np.log(4.0)
    require(
        large < _NOTICEABLE or power < _STEEP,
        f"2,000 cells took {small:.2f} s and 8,000 took {large:.2f} s, as the number of cells to the power "
        f"of {power:.1f}: look at cells on the border of parts alone, and update instead of computing anew",
    )


def _case(kind: str, size: tuple[int, int]) -> Case:
    graph: Graph = small_meshes.grid(*size, jitter=0.2).graph
    name = f"{graph.n} cells"
    if kind == "bisector":
        return Case(name, (graph, seeds_for(1)))
    return asked(kind, graph, name, clumps(graph, min(graph.n // 100, 80), strays=0.02), "both")


def _seconds(subject: Subject, case: Case) -> float:
    """CPU time of an answer: the least of three, as a busy machine only ever adds to it."""
    taken = []
    for _ in range(3):
        tool, start = subject.build(), time.process_time()
        answer(subject, tool, case)
        taken.append(time.process_time() - start)
        if taken[-1] > 5.0:  # no noise is that large
            break
    return min(taken)
