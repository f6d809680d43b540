"""Time refiners and fixers on meshes of increasing size, so that slow components get small cases only."""

from __future__ import annotations

import time
from typing import NamedTuple

from agglo_core.conformance.base import Case, Subject
from agglo_core.conformance.base.asking import ask
from agglo_core.conformance.inputs.cases import graph_case
from agglo_core.conformance.inputs.drawn import DrawnGraph, DrawnMesh
from agglo_core.registry.containment import PLUGIN_FAILURES

TIME_LIMIT = 20.0
"""CPU seconds allowed to a refiner or fixer for 5,000 cells; built-in components take milliseconds."""

_SIZES = (64, 128, 256, 512, 1024, 2048, 5000)
_FEWEST = 250  # cells: smaller meshes may take as long
_BOTHER = 0.25  # CPU seconds: slower cases are not repeated


class Slow(NamedTuple):
    """Test case that took too long: cells, seconds, and the largest number of cells still acceptable."""

    cells: int
    seconds: float
    most: int


def too_slow(subject: Subject) -> Slow | None:
    """Return the first size at which a refiner or fixer exceeds its share of the time limit, or None.

    The result is cached. Laws judge answers and errors.
    """
    if subject.kind not in ("refiner", "fixer"):
        return None
    if "speed" not in subject.cache:
        most, slow = 0, None
        seconds_for(subject, _SIZES[0])  # compile kernels off the clock
        for cells in _SIZES:
            seconds = seconds_for(subject, cells)
            if seconds > TIME_LIMIT * max(cells, _FEWEST) / 5000:
                slow = Slow(cells, seconds, most)
                break
            most = cells if seconds <= _BOTHER else most
        subject.cache["speed"] = slow
    result: Slow | None = subject.cache["speed"]
    return result


def drop_slow_cases(subject: Subject, test_cases: list[Case]) -> list[Case]:
    """Return the test cases that are small enough for the measured speed of the component."""
    slow = too_slow(subject)
    return [case for case in test_cases if slow is None or case.given[0].n <= slow.most]


def seconds_for(subject: Subject, cells: int) -> float:
    """Return the CPU seconds of a call for a number of cells, or 0 if it fails."""
    recipe = DrawnGraph(DrawnMesh(cells=cells, jitter=0.25))
    case = graph_case(subject.kind, recipe, "noisy", max(cells // 16, 1), "both")
    tool, start = subject.build(), time.process_time()
    try:
        ask(subject.kind, tool, case)
    except PLUGIN_FAILURES:
        return 0.0
    return time.process_time() - start
