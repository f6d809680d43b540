"""Values of metrics worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi, sqrt
from typing import Final

_OWN: Final[Mapping[str, Sequence[Sequence[float]]]] = {
    "UF": ((1, 1, 1, 1), (sqrt(0.2), 1), (1, 0.5), (0.6, 1), (sqrt(10 / 26), 1), (1, 1)),
    "CR": (
        (sqrt(0.5),) * 4,
        (sqrt(0.5), sqrt(0.1)),
        (sqrt(2) - 1, sqrt(0.5)),
        (sqrt(0.5), (2 * sqrt(2) - 2) / 5),
        (sqrt(1 / 10), sqrt(1 / 26)),
        (sqrt(1 / 8),) * 2,
    ),
    "CRc": (
        (sqrt(0.5),) * 4,
        (sqrt(0.5), sqrt(0.1)),
        (1 / 6, sqrt(0.5)),
        (sqrt(0.5), 0),
        (sqrt(0.1), 0),
        (0, 0),
    ),
    "interface_length": ((4, 4, 4, 4), (1, 1), (2, 2), (12, 12), (2, 2), (4, 4)),
    "cut": ((4, 4, 4, 4), (1, 1), (2, 2), (12, 12), (2, 2), (4, 4)),
    "ncut": ((1 / 3,) * 4, (1, 1 / 5), (1 / 3, 1), (1 / 3, 3 / 11), (1 / 3, 1), (1, 1)),
    "components": ((1, 1, 1, 1), (1, 1), (1, 1), (1, 1), (1, 2), (2, 2)),
    "cells": ((4, 4, 4, 4), (1, 3), (3, 1), (9, 16), (3, 2), (2, 2)),
    "J": (
        (3 / pi,) * 4,
        (3 / pi, 9 / (5 * pi)),
        (27 / (11 * pi), 3 / pi),
        (3 / pi, 24 / (17 * pi)),
        (9 / (5 * pi), 6 / (25 * pi)),
        (3 / (2 * pi),) * 2,
    ),
    "isoperimetric": (
        (pi / 4,) * 4,
        (pi / 4, 3 * pi / 16),
        (3 * pi / 16, pi / 4),
        (pi / 4, pi / 16),
        (3 * pi / 16, pi / 8),
        (pi / 8, pi / 8),
    ),
    "convexity": ((1, 1, 1, 1), (1, 1), (6 / 7, 1), (1, 16 / 25), (1, 2 / 5), (2 / 3, 2 / 3)),
    "star_shapedness": ((1, 1, 1, 1), (1, 1), (1 / 3, 1), (1, 0), (1, 0), (0, 0)),
    "box_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1, 1), (1, 1), (1 / 3, 1 / 5), (1 / 2, 1 / 2)),
    "edge_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1 / 2, 1), (1, 3 / 5), (1 / 3, 1), (1, 1)),
    "face_ratio": ((1, 1, 1, 1), (1, 1 / 3), (1 / 2, 1), (1, 3 / 5), (1 / 3, 1), (1, 1)),
}

PLAIN: Final[Mapping[str, Sequence[Sequence[float]]]] = {
    "area": ((4, 4, 4, 4), (1, 3), (3, 1), (9, 16), (3, 2), (2, 2)),
    "perimeter": ((8, 8, 8, 8), (4, 8), (8, 4), (12, 32), (8, 8), (8, 8)),
    "diameter": (
        (sqrt(8),) * 4,
        (sqrt(2), sqrt(10)),
        (sqrt(8), sqrt(2)),
        (sqrt(18), sqrt(50)),
        (sqrt(10), sqrt(26)),
        (sqrt(8), sqrt(8)),
    ),
    "solidity": _OWN["convexity"],
    "polsby_popper": _OWN["isoperimetric"],
    "isoperimetric_quotient": _OWN["isoperimetric"],
}
"""The same of names that mean one thing to everybody."""

HAND: Final = {**_OWN, **PLAIN}
"""Values in the cases :func:`agglo_core.conformance.inputs.metric_cases.by_hand`, by the name of the metric.

Four squares of 2 by 2 cells; a square beside a 3 by 1 bar; an L of three squares around a square; a square
of 3 by 3 in a ring one cell wide; a 3 by 1 bar between the two squares of one part; two parts of two squares
that touch in a point.
"""
