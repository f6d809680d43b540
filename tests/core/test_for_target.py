"""Bisectors that are told what the pieces are to become."""

from __future__ import annotations

import warnings
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
def test_a_bisector_that_is_told_splits_for_one_target_after_the_other(given, wanted):
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


def test_the_old_name_aim_goes_on_working_and_warns_once_for_each_class():
    def old_style():
        class Old:
            def __init__(self, used, target=None):
                self.used, self.target = used, target

            def aim(self, target):
                return Old(self.used, target)

            def bisect(self, graph, rng):
                self.used.append(self.target)
                return halves(graph)

        Old.__qualname__ = f"Old{id(Old)}"
        return Old

    used, one, other = [], old_style(), old_style()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for tool in (one(used), one(used), other(used)):
            agglo.agglomerate(GRID, bisector=tool, n_parts=(4, 2))
    assert {each.category for each in caught} == {DeprecationWarning}
    messages = [str(each.message) for each in caught if "aim(target)" in str(each.message)]
    assert len(messages) == 2
    for message, tool in zip(messages, (one, other), strict=True):
        assert message.startswith(f"{tool.__module__}.{tool.__qualname__}")
        assert "for_target(target)" in message
    assert set(used) == {agglo.Target(parts=2), agglo.Target(parts=4)}
