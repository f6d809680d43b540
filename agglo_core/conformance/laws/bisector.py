"""Laws of the sides that a bisector returns."""

from __future__ import annotations

import numpy as np

from agglo_core.conformance.cases import cases
from agglo_core.conformance.law import law
from agglo_core.conformance.questions import answer, in_words, plain
from agglo_core.conformance.subject import Subject
from agglo_core.conformance.verdict import require


def _bisects(subject: Subject) -> bool:
    return subject.has("bisect_level") or subject.has("bisect")


@law("bisector")
def side_array(subject: Subject) -> None:
    """It returns one side per cell: an array of integers, booleans or floats of shape (n,)."""
    for case in cases("bisector"):
        given = answer(subject, subject.build(), case)
        require(
            isinstance(given, np.ndarray) and given.shape == (case.size,) and given.dtype.kind in "iubf",
            f"on {case.name}: it returned {in_words(given)}, expected an array of shape ({case.size},) of "
            "integers, booleans or floats: np.asarray(sides) makes one of a list",
        )


@law("bisector")
def side_values(subject: Subject) -> None:
    """Sides are 0 and 1; floats are the probability of side 1, from 0 to 1."""
    for case in cases("bisector"):
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
    """Both sides have a cell wherever there are two cells (with a declared fallback: mostly)."""
    bad = []
    questions = cases("bisector")
    for case in questions:
        if len(np.unique(plain(subject, subject.build(), case))) < 2:
            bad.append(case.name)
    allowed = len(questions) // 2 if subject.fallback else 0
    require(
        len(bad) <= allowed,
        f"on {', '.join(bad)}: all cells came out on one side: split at the median where your rule finds no "
        "cut, or declare fallback='inertial' (Component) for a model that may fail",
    )
