"""Test cases for the laws of quality metrics, and metric values computed by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi, sqrt
from typing import Final

import numpy as np

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base import Case
from agglo_core.conformance.inputs import small_meshes

_ISOPERIMETRIC = (
    (pi / 4,) * 4,
    (pi / 4, 3 * pi / 16),
    (3 * pi / 16, pi / 4),
    (pi / 4, pi / 16),
    (3 * pi / 16, pi / 8),
    (pi / 8, pi / 8),
)

HAND: Final[Mapping[str, Sequence[Sequence[float]]]] = {
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
    "solidity": ((1, 1, 1, 1), (1, 1), (6 / 7, 1), (1, 16 / 25), (1, 2 / 5), (2 / 3, 2 / 3)),
    "polsby_popper": _ISOPERIMETRIC,
    "isoperimetric_quotient": _ISOPERIMETRIC,
}
"""Values in the cases of :func:`by_hand`, for metrics whose name has one common meaning."""


def by_hand() -> list[Case]:
    """Return the test cases whose metric values are computed by hand, in parts of unit squares."""
    row, column = np.divmod(np.arange(16), 4)
    ring = np.ones((5, 5), int)
    ring[1:4, 1:4] = 0
    return [
        Case("four squares", (small_meshes.grid(4, 4), frozen_int(row // 2 * 2 + column // 2))),
        Case("a square and a bar", (small_meshes.grid(4, 1), frozen_int([0, 1, 1, 1]))),
        Case("an L and a square", (small_meshes.grid(2, 2), frozen_int([0, 0, 0, 1]))),
        Case("a square with a ring around it", (small_meshes.grid(5, 5), frozen_int(ring.ravel()))),
        Case("a bar between two squares", (small_meshes.grid(5, 1), frozen_int([1, 0, 0, 0, 1]))),
        Case("squares that touch in a point", (small_meshes.grid(2, 2), frozen_int([0, 1, 1, 0]))),
    ]


def layouts(framed: bool) -> tuple[Case, list[Case]]:
    """Return sixteen square parts, and worse parts of equal cell counts: bars, zigzags, scattered cells.

    If ``framed``, part 16 surrounds them, so that no other part touches the boundary.
    """
    width = framed * 2
    mesh = small_meshes.grid(16 + 2 * width, 16 + 2 * width)
    row, column = np.divmod(np.arange(256), 16)
    worse = {
        "bars": row,
        "zigzags": row // 4 * 4 + (column + 2 * (row % 2)) % 16 // 4,
        "loose cells": row % 4 * 4 + column % 4,
    }

    def case(name: str, labels: np.ndarray) -> Case:
        around = np.pad(labels.reshape(16, 16), width, constant_values=16)
        return Case(name, (mesh, frozen_int(around.ravel())))

    squares = case("squares", row // 4 * 4 + column // 4)
    return squares, [case(name, labels) for name, labels in worse.items()]
