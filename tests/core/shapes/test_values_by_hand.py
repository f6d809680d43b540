"""Values of metrics by hand: squares, bars, an L, a ring and parts in two pieces."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from agglo_core.conformance.inputs.metric_cases import by_hand
from agglo_core.registry import default

VALUES = {
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
"""Values by metric, then by the case and part of ``by_hand``."""


@pytest.mark.parametrize("name", VALUES)
def test_values_by_hand(name: str) -> None:
    metric = default().build("metric", name)
    for case, expected in zip(by_hand(), VALUES[name], strict=True):
        np.testing.assert_allclose(metric.measure(*case.given), expected, atol=1e-9, err_msg=case.name)
