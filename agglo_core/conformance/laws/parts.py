"""Laws for the labels returned by refiners and fixers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.agglomeration.border import broken_blocks
from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base import Broken, Case, Subject, law, require
from agglo_core.conformance.inputs.questions import chunks, large_graphs, plain
from agglo_core.conformance.inputs.speed import TIME_LIMIT, too_slow
from agglo_core.conformance.inputs.strategies import graph_cases
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES, Objective, numbered_parts


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


@law("refiner", "fixer", draw=graph_cases, fixed=large_graphs)
def label_array(subject: Subject, case: Case) -> None:
    """Each block keeps its set of labels."""
    graph, labels = case.given[:2]
    result = plain(subject, case)
    for b, (before, after) in enumerate(zip(chunks(graph, labels), chunks(graph, result), strict=True)):
        had, has = set(before.tolist()), set(after.tolist())
        lost, new = min(had - has, default=None), min(has - had, default=None)
        require(
            lost is None,
            f"on {case.name}, block {b}: part {lost} lost its last cell: refuse a move that empties a part, "
            "and do not renumber labels",
        )
        require(
            new is None,
            f"on {case.name}, block {b}: label {new} is new: a cell may only take a label of its own block",
        )


@law("refiner", "fixer", draw=graph_cases, fixed=large_graphs)
def components_not_raised(subject: Subject, case: Case) -> None:
    """No part has more connected components than before, and after a fixer each part is connected."""
    graph, labels = case.given[:2]
    had = loose_parts(graph, labels)
    for (block, part), pieces in loose_parts(graph, plain(subject, case)).items():
        fixed = subject.kind == "fixer"
        require(
            pieces <= (1 if fixed else had.get((block, part), 0)),
            f"on {case.name}: part {part} of block {block} is in {pieces} pieces: "
            + (
                "give every piece but the largest to a neighbouring part"
                if fixed
                else "move a cell only if its neighbours in its part stay connected"
            ),
        )


def loose_parts(graph: Graph, labels: Int) -> dict[tuple[int, int], int]:
    """Return the number of connected components per part (block, label)."""
    # Count the components by block and label of their first cell.
    numbers = np.unique(labels, return_inverse=True)[1]
    _, first = np.unique(graph.components(numbers), return_index=True)
    keys, counts = np.unique(np.stack((graph.block_ids, labels))[:, first], axis=1, return_counts=True)
    return {(int(b), int(p)): int(c) for (b, p), c in zip(keys.T, counts, strict=True)}


def _has_objective(subject: Subject) -> bool:
    """Return True if the objective of a refiner is one of graphs, not a metric of meshes."""
    return subject.build().objective in OBJECTIVES


@law(
    "refiner",
    draw=lambda subject: graph_cases(subject, blocks=(1, 2, 5, 40) if _has_objective(subject) else (1,)),
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
    before, after = (np.atleast_1d(value(graph, each)) for each in (labels, plain(subject, case, tool)))
    worst = np.argmax(after - before - 1e-9 * np.abs(before))
    require(
        after[worst] <= before[worst] + 1e-9 * abs(before[worst]),
        f"{name} went from {before[worst]:.6g} to {after[worst]:.6g}: return the given labels where no "
        "improvement was found",
    )


def _in_blocks(objective: Objective) -> Callable[[Graph, Int], Float]:
    """Return a function of graph and labels that evaluates the objective on each block separately."""

    def value(graph: Graph, labels: Int) -> Float:
        parts = numbered_parts(graph, labels)
        block = np.empty(int(parts.max()) + 1, np.int64)
        block[parts] = graph.block_ids
        combined = np.add if objective.combined == "sum" else np.maximum
        first = np.unique(block, return_index=True)[1]
        result: Float = combined.reduceat(objective.of_parts(graph, parts), first)
        return result

    return value


def _sum_of_metric(subject: Subject, tool: Any, case: Case) -> Callable[[Graph, Int], float]:
    """Return a function of graph and labels that sums a metric over the parts, so that lower is better."""
    metric = getattr(tool, "metric", None) or subject.metric(tool.objective)
    require(
        metric is not None,
        f"objective is {tool.objective!r}; expected {', '.join(OBJECTIVES)} or the name of a metric",
    )
    sign = 1.0 if metric.better == "low" else -1.0
    return lambda graph, labels: sign * float(metric.measure(case.mesh, numbered_parts(graph, labels)).sum())


@law("fixer", draw=graph_cases, fixed=large_graphs)
def connected_left_alone(subject: Subject, case: Case) -> None:
    """Labels stay unchanged in blocks whose parts are all connected."""
    graph, labels = case.given
    broken = np.isin(graph.block_ids, broken_blocks(graph, labels))
    changed = np.flatnonzero((plain(subject, case) != labels) & ~broken)
    require(
        not len(changed),
        f"{len(changed)} cells changed part in blocks whose parts were all connected: leave such blocks "
        "unchanged",
    )


@law(
    "refiner",
    draw=graph_cases,
    when=lambda subject: bool(getattr(subject.build(), "tests_moves", False)),
)
def moves_tested(subject: Subject, case: Case) -> None:
    """With ``tests_moves`` no part becomes wider than ``target.h_star``."""
    graph, labels, _, target = case.given
    if target.h_star is None:
        return
    parts = numbered_parts(graph, labels)
    result = numbered_parts(graph, frozen_int(plain(subject, case)))
    before, after = graph.part_diameters(parts), graph.part_diameters(result)
    limit = max(target.h_star, float(before.max())) * (1.0 + 1e-9)
    require(
        after.max() <= limit,
        f"a part of diameter {after.max():.6g} was made, at most {limit:.6g} are allowed: refuse such "
        "moves, or leave out tests_moves",
    )
