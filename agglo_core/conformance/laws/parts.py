"""Laws for the labels returned by refiners and fixers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import (
    answer,
    as_array,
    chunks,
    in_words,
    large_graphs,
    plain,
)
from agglo_core.conformance.inputs.speed import TIME_LIMIT, too_slow
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES, Objective, numbered_parts


def same_parts(graph: Graph, before: NDArray[Any], after: NDArray[Any]) -> bool:
    """Return True if each block has the same label set before and after."""
    pairs = zip(chunks(graph, before), chunks(graph, after), strict=True)
    return all(set(had.tolist()) == set(has.tolist()) for had, has in pairs)


@law("refiner", "fixer")
def bounded_time(subject: Subject) -> None:
    """A call takes at most 20 CPU seconds for 5,000 cells, and proportionally less for fewer cells."""
    slow = too_slow(subject)
    if slow is not None:
        raise Broken(
            f"{slow.cells:,} cells took {slow.seconds:.1f} CPU seconds, at most {TIME_LIMIT:g} are allowed "
            "for 5,000 cells: visit only cells on the border of parts, bound the number of sweeps, and "
            "update values instead of recomputing them"
        )


@drawn_law("refiner", "fixer", draw=graph_cases, fixed=large_graphs)
def label_array(subject: Subject, case: Case) -> None:
    """Labels form an array of integers of shape (n,), with one label per cell."""
    result = answer(subject, subject.build(), case)
    labels = as_array(result)
    require(
        labels.shape == (case.size,) and labels.dtype.kind in "iub",
        f"on {case.name}: it returned {in_words(result)}, expected an array of integers of shape "
        f"({case.size},): one label for each cell",
    )


@drawn_law("refiner", "fixer", draw=graph_cases, fixed=large_graphs)
def parts_kept(subject: Subject, case: Case) -> None:
    """Each block keeps its set of labels: none is added and none loses its last cell."""
    graph, labels = case.given[:2]
    result = plain(subject, subject.build(), case)
    for b, (before, after) in enumerate(zip(chunks(graph, labels), chunks(graph, result), strict=True)):
        had, has = set(before.tolist()), set(after.tolist())
        prefix = f"on {case.name}, block {b}: "
        require(
            had <= has,
            f"{prefix}part {min(had - has, default=0)} lost its last cell: refuse a move that empties a "
            "part, and do not renumber labels",
        )
        require(
            has <= had,
            f"{prefix}label {min(has - had, default=0)} is new: a cell may only take a label that "
            "its own block has",
        )


@drawn_law("refiner", draw=graph_cases, fixed=large_graphs)
def components_not_raised(subject: Subject, case: Case) -> None:
    """No part has more connected components than before."""
    graph, labels = case.given[:2]
    after = plain(subject, subject.build(), case)
    worse = in_more_pieces(subject.kind, graph, labels, after)
    require(
        not worse,
        f"on {case.name}: part {worse and worse[0][1]} fell apart into {worse and worse[0][2]} pieces: "
        "move a cell only if its neighbours in its part stay connected",
    )


def _has_objective(subject: Subject) -> bool:
    """Return True if the objective of a refiner is one of graphs, not a metric of meshes."""
    return subject.build().objective in OBJECTIVES


@drawn_law(
    "refiner",
    draw=lambda subject: graph_cases(subject, one_block=not _has_objective(subject)),
    fixed=lambda subject: large_graphs(subject) if _has_objective(subject) else [],
)
def objective_kept(subject: Subject, case: Case) -> None:
    """The declared objective (interface, … or the sum of a metric over the parts) worsens in no block."""
    tool = subject.build()
    name = tool.objective
    if name not in OBJECTIVES and case.mesh is None:
        return
    graph, labels = case.given[:2]
    value = _in_blocks(OBJECTIVES[name]) if name in OBJECTIVES else _sum_of_metric(subject, tool, case)
    before = value(graph, labels)
    after = value(graph, plain(subject, subject.build(), case))
    # Compare blocks: the worst block must not increase beyond rounding.
    worst = np.argmax(after - before - 1e-9 * np.abs(before))
    was, became = np.atleast_1d(before)[worst], np.atleast_1d(after)[worst]
    require(
        became <= was + 1e-9 * abs(was),
        f"on {case.name}: {name} went from {was:.6g} to {became:.6g}: return the given labels where no "
        "improvement was found",
    )


def _in_blocks(objective: Objective) -> Callable[[Graph, Int], Any]:
    """Return a function of graph and labels that evaluates the objective on each block separately."""

    def value(graph: Graph, labels: Int) -> Float:
        parts = numbered_parts(graph, labels)
        block = np.empty(int(parts.max()) + 1, np.int64)
        block[parts] = graph.block_ids
        values = objective.of_parts(graph, parts)
        combined = np.add if objective.combined == "sum" else np.maximum
        result: Float = combined.reduceat(values, np.unique(block, return_index=True)[1])
        return result

    return value


def _sum_of_metric(subject: Subject, tool: Any, case: Case) -> Callable[[Graph, Int], float]:
    """Return a function of graph and labels that sums a metric over the parts of a test mesh.

    The sign is set so that lower is better.
    """
    metric = getattr(tool, "metric", None) or subject.metric(tool.objective)
    require(
        metric is not None,
        f"objective is {tool.objective!r}; expected {', '.join(OBJECTIVES)} or the name of a metric",
    )
    mesh = case.mesh
    sign = 1.0 if metric.better == "low" else -1.0
    return lambda graph, labels: sign * float(metric.measure(mesh, numbered_parts(graph, labels)).sum())


def in_more_pieces(kind: str, graph: Graph, before: Int, after: Int) -> list[tuple[int, int, int]]:
    """List each part (block, label) with more connected components than before, and their number.

    For a fixer, list each part with more than a single component.
    """
    had, has = loose_parts(graph, before), loose_parts(graph, after)
    limits = {part: 1 if kind == "fixer" else had.get(part, 0) for part in has}
    return sorted((*part, pieces) for part, pieces in has.items() if pieces > limits[part])


def loose_parts(graph: Graph, labels: Int) -> dict[tuple[int, int], int]:
    """Return the number of connected components per part (block, label)."""
    # Connected components of the graph without edges between parts.
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    inside = labels[rows] == labels[graph.indices]
    links = sparse.coo_array(
        (np.ones(inside.sum()), (rows[inside], graph.indices[inside])), shape=(graph.n, graph.n)
    )
    _, piece = connected_components(links, directed=False)
    # Count the components by block and label of their first cell.
    _, first = np.unique(piece, return_index=True)
    keys, counts = np.unique(np.stack((graph.block_ids, labels))[:, first], axis=1, return_counts=True)
    return {(int(b), int(p)): int(c) for (b, p), c in zip(keys.T, counts, strict=True)}


@drawn_law("fixer", draw=graph_cases, fixed=large_graphs)
def parts_connected(subject: Subject, case: Case) -> None:
    """Every part is connected after the call."""
    pieces = loose_parts(case.given[0], plain(subject, subject.build(), case))
    loose = [part for part in pieces if pieces[part] > 1]
    require(
        not loose,
        f"on {case.name}: {len(loose)} parts are still disconnected, for instance part "
        f"{loose and loose[0][1]} of block {loose and loose[0][0]}: give every piece but the largest to "
        "a neighbouring part",
    )


@drawn_law("fixer", draw=graph_cases, fixed=large_graphs)
def connected_left_alone(subject: Subject, case: Case) -> None:
    """Labels stay unchanged in blocks whose parts are all connected."""
    graph, labels = case.given
    broken = np.isin(graph.block_ids, broken_blocks(graph, labels))
    changed = np.flatnonzero((plain(subject, subject.build(), case) != labels) & ~broken)
    require(
        not len(changed),
        f"on {case.name}: {len(changed)} cells changed part in blocks whose parts were all connected: "
        "leave such blocks unchanged",
    )


@law("fixer")
def disconnected_block_refused(subject: Subject) -> None:
    """A disconnected block is refused with a ValueError, because no labels can fix it."""
    graph = small_meshes.two_grids().graph
    case = replace(cases("fixer")[0], name="two components", given=(graph, frozen_int(np.zeros(graph.n))))
    try:
        plain(subject, subject.build(), case)
    except Broken as error:
        if isinstance(error.__cause__, ValueError):
            return
        raise
    raise Broken("a disconnected block was accepted: raise a ValueError, because no labels can fix it")
