"""Laws of what a refiner must not make worse."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Float, Int
from agglo_core.conformance import small_meshes
from agglo_core.conformance.case import Case
from agglo_core.conformance.cases import cases, level_case
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, every_graph, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import require
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES, Objective, numbered_parts

__all__ = ["OBJECTIVES", "TIME_LIMIT", "loose_parts"]

TIME_LIMIT = 20.0
"""Seconds a refiner may take for 5,000 cells; ours takes milliseconds."""


@law("refiner")
def components_not_raised(subject: Subject) -> None:
    """No part falls into more pieces than it had."""
    for case in every_graph(subject):
        graph, labels = case.given[:2]
        before = loose_parts(graph, labels)
        after = loose_parts(graph, plain(subject, subject.build(), case))
        worse = sorted(part for part in after if after[part] > before.get(part, 0))
        require(
            not worse,
            f"on {case.name}: part {worse and worse[0][1]} fell apart into "
            f"{worse and after[worse[0]]} pieces: move a cell only if its neighbours in its part stay joined",
        )


@law("refiner")
def objective_kept(subject: Subject) -> None:
    """The objective it names gets worse in no block: one of the suite's (interface, …), or a metric's sum."""
    tool = subject.build()
    name = tool.objective
    for case in every_graph(subject) if name in OBJECTIVES else cases("refiner"):
        graph, labels = case.given[:2]
        value = _in_blocks(OBJECTIVES[name]) if name in OBJECTIVES else _sum_of_metric(subject, tool, case)
        before = value(graph, labels)
        after = value(graph, plain(subject, subject.build(), case))
        worst = np.argmax(after - before - 1e-9 * np.abs(before))
        was, became = np.atleast_1d(before)[worst], np.atleast_1d(after)[worst]
        require(
            became <= was + 1e-9 * abs(was),
            f"on {case.name}: {name} went from {was:.6g} to {became:.6g}: return the labels you were given "
            "where you found nothing better",
        )


def _in_blocks(objective: Objective) -> Callable[[Graph, Int], Any]:
    """The objective of each block, as if it stood alone."""

    def value(graph: Graph, labels: Int) -> Float:
        parts = numbered_parts(graph, labels)
        block = np.empty(int(parts.max()) + 1, np.int64)
        block[parts] = graph.block_ids
        values = objective.of_parts(graph, parts)
        combined = np.add if objective.combined == "sum" else np.maximum
        found: Float = combined.reduceat(values, np.unique(block, return_index=True)[1])
        return found

    return value


def _sum_of_metric(subject: Subject, tool: Any, case: Case) -> Callable[[Graph, Int], float]:
    """Sum of the values of a metric, lower is better, on the mesh of a question."""
    metric = getattr(tool, "metric", None) or subject.metric(tool.objective)
    require(
        metric is not None,
        f"objective is {tool.objective!r}; the suite knows {', '.join(OBJECTIVES)}, and the metrics by name",
    )
    mesh = next(mesh for mesh in small_meshes.plane_meshes() if mesh.name == case.name)
    sign = 1.0 if metric.better == "low" else -1.0
    return lambda graph, labels: sign * float(metric.measure(mesh, numbered_parts(graph, labels)).sum())


@law("refiner")
def bounded_time(subject: Subject) -> None:
    """It takes at most 20 seconds for 5,000 cells."""
    case = level_case("refiner")
    answer(subject, subject.build(), cases("refiner")[0])  # kernels compile here, off the clock
    start = time.perf_counter()
    answer(subject, subject.build(), case)
    taken = time.perf_counter() - start
    require(
        taken <= TIME_LIMIT,
        f"{case.given[0].n} cells took {taken:.1f} s, allowed are {TIME_LIMIT:g}: bound the number of sweeps "
        "and look at boundary cells alone",
    )


def loose_parts(graph: Graph, labels: Int) -> dict[tuple[int, int], int]:
    """Number of connected pieces of each part (block, label)."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    inside = labels[rows] == labels[graph.indices]
    links = sparse.coo_array(
        (np.ones(inside.sum()), (rows[inside], graph.indices[inside])), shape=(graph.n, graph.n)
    )
    _, piece = connected_components(links, directed=False)
    _, first = np.unique(piece, return_index=True)
    keys, counts = np.unique(np.stack((graph.block_ids, labels))[:, first], axis=1, return_counts=True)
    return {(int(b), int(p)): int(c) for (b, p), c in zip(keys.T, counts, strict=True)}
