"""Laws of what a refiner must not make worse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Float, Int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import every_graph, in_space, plain
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES, Objective, numbered_parts


@law("refiner")
def components_not_raised(subject: Subject) -> None:
    """No part falls into more pieces than it had."""
    for case in every_graph(subject):
        graph, labels = case.given[:2]
        after = plain(subject, subject.build(), case)
        worse = in_more_pieces(subject.kind, graph, labels, after)
        require(
            not worse,
            f"on {case.name}: part {worse and worse[0][1]} fell apart into "
            f"{worse and worse[0][2]} pieces: move a cell only if its neighbours in its part stay joined",
        )


@law("refiner")
def objective_kept(subject: Subject) -> None:
    """The objective it names gets worse in no block: one of the suite's (interface, …), or a metric's sum."""
    tool = subject.build()
    name = tool.objective
    everywhere = [*every_graph(subject), *in_space(subject)]
    for case in everywhere if name in OBJECTIVES else cases("refiner"):
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


def in_more_pieces(kind: str, graph: Graph, before: Int, after: Int) -> list[tuple[int, int, int]]:
    """Block, label and pieces of parts in more pieces than they had; of a fixer, than one."""
    had, has = loose_parts(graph, before), loose_parts(graph, after)
    allowed = {part: 1 if kind == "fixer" else had.get(part, 0) for part in has}
    return sorted((*part, pieces) for part, pieces in has.items() if pieces > allowed[part])


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
