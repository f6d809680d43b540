"""The law that every component obeys: a level is its blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agglo_core.arrays import frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import level_case, part_of_level
from agglo_core.conformance.inputs.hard_cases import crowded, many_parts
from agglo_core.conformance.inputs.questions import chunks, in_space, plain, same
from agglo_core.conformance.inputs.speed import too_slow


@law("bisector", "refiner", "fixer")
def a_level_is_its_blocks(subject: Subject) -> None:
    """The result of a block is the same alone, beside blocks of any size, and in any order of blocks."""
    levels = [
        (level_case(subject.kind), (0, 1, 2, 30, 60)),
        (crowded(subject.kind, 40), (0, 3, 9, 20, 21, 39)),
    ]
    if subject.kind == "bisector" and subject.has("bisect_level"):
        levels.append((many_parts(subject.kind), (3, 0, 255, 4095, 4097, 4999)))
    levels += [(case, (0, 1, 2)) for case in in_space(subject) if case.given[0].n_blocks == 3]
    for case, chosen in levels if too_slow(subject) is None else [_few_blocks(levels[0][0])]:
        _same_in_any_company(subject, case, chosen)


def _without_others(case: Case) -> Case:
    """The question with points of other blocks, which the graph still holds, moved onto one of its own."""
    graph, *rest = case.given
    own = np.unique(graph.vertices)
    points = np.repeat(graph.points[own[:1]], len(graph.points), axis=0)
    points[own] = graph.points[own]
    return Case(case.name, (replace(graph, points=frozen_float(points)), *rest))


def _few_blocks(level: Case) -> tuple[Case, Sequence[int]]:
    """Some of the small blocks of a level, for what is too slow for more."""
    return part_of_level(level, np.arange(1, 13)), (0, 3, 11)


def _same_in_any_company(subject: Subject, case: Case, chosen: Sequence[int]) -> None:
    """The chosen blocks of a level alone, and up to 21 blocks in another order."""
    graph = case.given[0]
    remedy = (
        "take sums, extremes and scales within each block (graph.block_ids, graph.offsets), never over the "
        "whole level, and keep nothing from the block before"
    )
    tool = subject.build()
    together = chunks(graph, plain(subject, tool, case))
    for block in chosen:
        alone = plain(subject, subject.build(), _without_others(part_of_level(case, [block])))
        require(
            same(alone, together[block]),
            f"a block of {len(alone)} cells has another result alone than in a level: {remedy}",
        )
    others = np.random.default_rng(3).permutation(np.delete(np.arange(graph.n_blocks), chosen[0]))
    order = np.insert(others[:20], min(7, len(others)), chosen[0])
    shuffled = part_of_level(case, order)
    for block, part in zip(order, chunks(shuffled.given[0], plain(subject, tool, shuffled)), strict=True):
        require(
            same(part, together[block]),
            f"a block of {len(part)} cells has another result in another order of blocks: {remedy}",
        )
