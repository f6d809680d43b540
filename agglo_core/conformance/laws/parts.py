"""Laws of what refiners and fixers keep: one label per cell, and the parts of each block."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.questions import answer, as_array, chunks, every_graph, in_words, plain
from agglo_core.conformance.inputs.speed import TIME_LIMIT, too_slow
from agglo_core.graph import Graph


def same_parts(graph: Graph, before: NDArray[Any], after: NDArray[Any]) -> bool:
    """Whether each block has the labels it had."""
    pairs = zip(chunks(graph, before), chunks(graph, after), strict=True)
    return all(set(had.tolist()) == set(has.tolist()) for had, has in pairs)


@law("refiner", "fixer")
def bounded_time(subject: Subject) -> None:
    """It takes at most 20 seconds for 5,000 cells, and fewer cells in proportion."""
    slow = too_slow(subject)
    if slow is not None:
        raise Broken(
            f"{slow.cells:,} cells took {slow.seconds:.1f} s, allowed are {TIME_LIMIT:g} for 5,000: look at "
            "cells on the border of parts alone, bound the number of sweeps, update instead of computing anew"
        )


@law("refiner", "fixer")
def label_array(subject: Subject) -> None:
    """It returns one label per cell: an array of integers of shape (n,)."""
    for case in every_graph(subject):
        given = answer(subject, subject.build(), case)
        labels = as_array(given)
        require(
            labels.shape == (case.size,) and labels.dtype.kind in "iub",
            f"on {case.name}: it returned {in_words(given)}, expected an array of integers of shape "
            f"({case.size},): one label for each cell",
        )


@law("refiner", "fixer")
def parts_kept(subject: Subject) -> None:
    """Each block has the labels it had: none is created, none loses its last cell."""
    for case in every_graph(subject):
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
