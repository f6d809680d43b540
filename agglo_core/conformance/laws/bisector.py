"""Laws of the sides that a bisector returns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.agglomeration.border import one_sided_blocks
from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, every_graph, in_words, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import require
from agglo_core.graph import Graph


__all__ = ["one_sided"]


def one_sided(graph: Graph, sides: NDArray[Any]) -> Int:
    """Blocks of two cells or more that are all on one side."""
    alike = one_sided_blocks(graph, frozen_int(sides))
    return alike[graph.sizes[alike] > 1]


def _bisects(subject: Subject) -> bool:
    return subject.has("bisect_level") or subject.has("bisect")


@law("bisector")
def side_array(subject: Subject) -> None:
    """It returns one side per cell: an array of integers, booleans or floats of shape (n,)."""
    for case in every_graph(subject):
        given = answer(subject, subject.build(), case)
        require(
            isinstance(given, np.ndarray) and given.shape == (case.size,) and given.dtype.kind in "iubf",
            f"on {case.name}: it returned {in_words(given)}, expected an array of shape ({case.size},) of "
            "integers, booleans or floats: np.asarray(sides) makes one of a list",
        )


@law("bisector")
def side_values(subject: Subject) -> None:
    """Sides are 0 and 1; floats are the probability of side 1, from 0 to 1."""
    for case in every_graph(subject):
        given = np.asarray(answer(subject, subject.build(), case))
        low, high = given.min(), given.max()
        if given.dtype.kind == "f":
            require(
                low >= 0 and high <= 1,
                f"on {case.name}: floats lie in {low:g}..{high:g}, expected probabilities of side 1 in 0..1: "
                "map scores there (1 / (1 + np.exp(-scores))), or return integers (scores > 0)",
            )
        require(
            low >= 0 and high <= 1,
            f"on {case.name}: sides are {low}..{high}, expected 0 and 1: subtract the smallest label",
        )


@law("bisector", when=_bisects)
def two_sides(subject: Subject) -> None:
    """Both sides of a piece have a cell wherever it has two cells (with a declared fallback: mostly)."""
    bad, pieces = [], 0
    for case in every_graph(subject):
        graph = case.given[0]
        alike = one_sided(graph, plain(subject, subject.build(), case))
        pieces += graph.n_blocks
        bad += [f"{case.name}, a piece of {graph.sizes[block]} cells" for block in alike]
    allowed = pieces // 2 if subject.fallback else 0
    require(
        len(bad) <= allowed,
        f"on {'; '.join(bad[:3])}: all cells came out on one side: split at the median where your rule finds no "
        "cut, or declare fallback='inertial' (Component) for a model that may fail",
    )
