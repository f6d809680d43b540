"""Laws of the direct partitions that a bisector may offer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.hard_cases import unusual_cases
from agglo_core.conformance.inputs.questions import answer, as_array, in_words
from agglo_core.protocols import Target

_PARTS = (2, 3, 7)


def _partitions(subject: Subject) -> bool:
    return subject.partitions


@law("bisector", when=_partitions)
def kway_labels(subject: Subject) -> None:
    """A direct partition returns integer labels from 0 to parts − 1, shape (n,)."""
    for case in [*cases("bisector"), *unusual_cases("bisector")]:
        graph = case.given[0]
        for parts in {1, *(k for k in _PARTS if k <= graph.n), min(graph.n, 300)}:
            given = _partition(subject, case, parts)
            labels = as_array(given)
            require(
                labels.shape == (graph.n,) and labels.dtype.kind in "iub",
                f"on {case.name}: partition returned {in_words(given)}, expected ({graph.n},) integers",
            )
            require(
                labels.min() >= 0 and labels.max() < parts,
                f"on {case.name}: labels {labels.min()}..{labels.max()} for {parts} parts, expected "
                f"0..{parts - 1}",
            )


@law("bisector", when=_partitions)
def kway_parts(subject: Subject) -> None:
    """At least half of the parts asked for come out, if no cell outweighs a part (gaps are closed later)."""
    for case in [*cases("bisector"), *unusual_cases("bisector")]:
        weights = case.given[0].weights
        for parts in (k for k in _PARTS if 2 * k <= len(weights) and k * weights.max() <= weights.sum()):
            used = len(np.unique(_partition(subject, case, parts)))
            require(
                2 * used >= parts and used > 1,
                f"on {case.name}: {used} parts came out of {parts}: target.parts is how many are wanted",
            )


def _partition(subject: Subject, case: Case, parts: int) -> Any:
    """What ``partition`` returns, asked through a component that has nothing else."""
    tool = subject.build()

    class OnlyPartition:
        def partition(self, graph: object, target: object, seed: int) -> object:
            return tool.partition(graph, Target(parts=parts), seed)

    return answer(subject, OnlyPartition(), replace(case, name=f"{case.name} in {parts} parts"))
