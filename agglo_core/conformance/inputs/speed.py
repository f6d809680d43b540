"""Time a refiner or fixer on meshes of increasing size, so that slow components get small cases only."""

from __future__ import annotations

import time
from dataclasses import dataclass

from agglo_core.conformance.base.asking import ask
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import labelled_case, level_case
from agglo_core.conformance.inputs.unusual_graphs import clumps
from agglo_core.registry.containment import PLUGIN_FAILURES

TIME_LIMIT = 20.0
"""CPU seconds allowed to a refiner or fixer for 5,000 cells; built-in components take milliseconds."""

_TIMED = ("refiner", "fixer")
_SIZES = ((8, 8), (16, 8), (16, 16), (32, 16), (32, 32), (64, 32))  # then a level of 4,960 cells
_FEWEST = 250  # cells: smaller meshes may take as long
_BOTHER = 0.25  # CPU seconds: slower cases are not repeated


@dataclass(frozen=True)
class Slow:
    """Test case that took too long: cells, seconds, and the largest number of cells still acceptable."""

    cells: int
    seconds: float
    most: int


def too_slow(subject: Subject) -> Slow | None:
    """Return the first test case that exceeds its share of the time limit, or None if none does.

    The cell counts double from case to case, and the result is cached. Laws judge answers and errors.
    """
    if subject.kind not in _TIMED:
        return None
    if not subject.pace:
        subject.pace.append(_measure_pace(subject))
    result: Slow | None = subject.pace[0]
    return result


def drop_slow_cases(subject: Subject, test_cases: list[Case]) -> list[Case]:
    """Return the test cases that are small enough for the measured speed of the component."""
    slow = too_slow(subject)
    return test_cases if slow is None else [case for case in test_cases if case.given[0].n <= slow.most]


def _measure_pace(subject: Subject) -> Slow | None:
    most = 0
    _seconds(subject, _case(subject.kind, *_SIZES[0]))  # compile kernels off the clock
    for place in range(len(_SIZES) + 1):
        case = _case(subject.kind, *_SIZES[place]) if place < len(_SIZES) else level_case(subject.kind)
        cells = case.given[0].n
        seconds = _seconds(subject, case)
        if seconds > TIME_LIMIT * max(cells, _FEWEST) / 5000:
            return Slow(cells, seconds, most)
        most = cells if seconds <= _BOTHER else most
    return None


def _seconds(subject: Subject, case: Case) -> float:
    tool, start = subject.build(), time.process_time()
    try:
        ask(subject.kind, tool, case)
    except PLUGIN_FAILURES:
        return 0.0
    return time.process_time() - start


def _case(kind: str, nx: int, ny: int) -> Case:
    graph = small_meshes.grid(nx, ny, jitter=0.2).graph
    return labelled_case(kind, graph, f"{graph.n} cells", clumps(graph, graph.n // 16, strays=0.02), "both")
