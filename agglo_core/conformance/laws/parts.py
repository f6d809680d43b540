"""Laws of what refiners and fixers keep: one label per cell, and the parts of each block."""

from __future__ import annotations

import numpy as np

from agglo_core.conformance.cases import cases, level_case
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, chunks, in_words, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import require


@law("refiner", "fixer")
def label_array(subject: Subject) -> None:
    """It returns one label per cell: an array of integers of shape (n,)."""
    for case in cases(subject.kind):
        given = answer(subject, subject.build(), case)
        require(
            isinstance(given, np.ndarray) and given.shape == (case.size,) and given.dtype.kind in "iu",
            f"on {case.name}: it returned {in_words(given)}, expected an array of integers of shape "
            f"({case.size},): np.asarray(labels) makes one of a list",
        )


@law("refiner", "fixer")
def parts_kept(subject: Subject) -> None:
    """Each block has the labels it had: none is created, none loses its last cell."""
    for case in [*cases(subject.kind), level_case(subject.kind)]:
        graph, labels = case.given[:2]
        result = plain(subject, subject.build(), case)
        for b, (before, after) in enumerate(zip(chunks(graph, labels), chunks(graph, result), strict=True)):
            had, has = set(before.tolist()), set(after.tolist())
            where = f"on {case.name}, block {b}: "
            require(
                had <= has,
                f"{where}part {min(had - has, default=0)} lost its last cell: refuse a move that empties a "
                "part, and do not renumber labels",
            )
            require(
                has <= had,
                f"{where}label {min(has - had, default=0)} is new: a cell may only take a label that "
                "its own block has",
            )
