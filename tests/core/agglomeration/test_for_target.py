"""Bisectors that are told what the pieces are to become."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import PluginError, samples

GRID = samples.squares(4)


def halves(graph):
    return np.arange(graph.n) % 2


class Told:
    """Splits in halves, and notes what for."""

    def __init__(self, used, target=None):
        self.used = used
        self.target = target

    def for_target(self, target):
        return Told(self.used, target)

    def bisect(self, graph, rng):
        self.used.append(self.target)
        return halves(graph)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"h_star": (0.3, 0.6)}, [{"h_star": 0.6}, {"h_star": 0.3}]),
        ({"h_star": (0.3, 0.6), "nested": False}, [{"h_star": 0.3}, {"h_star": 0.6}]),
        ({"n_parts": (4, 2)}, [{"parts": 2}, {"parts": 4}]),
    ],
)
def test_a_bisector_gets_one_target_after_the_other(given, wanted):
    used = []
    agglo.agglomerate(GRID, bisector=Told(used), **given)
    assert [target for target, _ in groupby(used)] == [agglo.Target(**each) for each in wanted]


def test_a_for_target_that_fails_is_named():
    class Blind(Told):
        def for_target(self, target):
            raise ValueError("no idea")

    with pytest.raises(PluginError, match="bisector Blind raised ValueError: no idea"):
        agglo.agglomerate(GRID, bisector=Blind([]), n_parts=2)


@pytest.mark.parametrize("answer", [None, 3, Told, object()])
def test_for_target_must_return_a_bisector(answer):
    class Lost(Told):
        def for_target(self, target):
            return answer

    with pytest.raises(PluginError, match=r"bisector Lost: for_target returned .*bisect_level or bisect"):
        agglo.agglomerate(GRID, bisector=Lost([]), n_parts=2)
