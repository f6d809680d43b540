"""What a refiner must not make worse."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Int
from agglo_core.conformance import bench
from agglo_core.conformance.cases import Case, cases, level_case
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import Broken, require
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES, numbered_parts
from agglo_core.measure.agglomerates import quality
from agglo_core.registry import default

__all__ = ["OBJECTIVES", "PATIENCE", "loose_parts"]

PATIENCE = 20.0
"""Seconds a refiner may take for 5,000 cells; ours takes milliseconds."""


@law("refiner")
def components_not_raised(subject: Subject) -> None:
    """No part falls into more pieces than it had."""
    for case in [*cases("refiner"), level_case("refiner")]:
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
    """The objective it names is one of the table, or a metric; it never worsens."""
    tool = subject.build()
    value = _value(tool)
    for case in [*cases("refiner"), *([] if _metric(tool) else [level_case("refiner")])]:
        labels = case.given[1]
        before = value(case, labels)
        after = value(case, plain(subject, subject.build(), case))
        require(
            after <= before + 1e-9 * abs(before),
            f"on {case.name}: {tool.objective} went from {before:.6g} to {after:.6g}: return the labels you "
            "were given where you found nothing better",
        )


def _metric(tool: Any) -> Any:
    """The metric that a refiner pursues; None if its objective is one of the table."""
    if tool.objective in OBJECTIVES:
        return None
    own = getattr(tool, "metric", None)
    if own is not None:
        return own
    try:
        return default().build("metric", tool.objective)
    except AggloError:
        known = ", ".join(OBJECTIVES)
        raise Broken(f"objective is {tool.objective!r}; the suite knows {known}, and metrics") from None


def _value(tool: Any) -> Callable[[Case, Int], float]:
    """What a refiner lowers, given a case and labels: of a metric, the sum over the parts of its mesh."""
    metric = _metric(tool)
    if metric is None:
        return lambda case, labels: OBJECTIVES[tool.objective].value(case.given[0], labels)
    sign = -1.0 if metric.better == "high" else 1.0
    meshes = {mesh.name: mesh for mesh in bench.plane_meshes()}

    def total(case: Case, labels: Int) -> float:
        parts = numbered_parts(case.given[0], labels)
        (values,) = quality(meshes[case.name], parts, [metric]).values()
        return sign * float(values.sum())

    return total


@law("refiner")
def bounded_time(subject: Subject) -> None:
    """It is done with 5,000 cells in 20 seconds."""
    case = level_case("refiner")
    answer(subject, subject.build(), cases("refiner")[0])  # kernels compile here, off the clock
    start = time.perf_counter()
    answer(subject, subject.build(), case)
    taken = time.perf_counter() - start
    require(
        taken <= PATIENCE,
        f"{case.given[0].n} cells took {taken:.1f} s, allowed are {PATIENCE:g}: bound the number of sweeps "
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
