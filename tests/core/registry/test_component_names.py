"""Components of a run by name: in the registry of the program, or in one that is given."""

from __future__ import annotations

import re

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Component, PluginError, hookimpl, samples

GRID = samples.squares(4)


class OneSided:
    def bisect(self, graph, rng):
        return np.zeros(graph.n)


class Declared:
    @hookimpl
    def agglo_components(self):
        target = f"{__name__}:OneSided"
        return [
            Component(kind="bisector", name="lazy", target=target),
            Component(kind="bisector", name="lazy_but_mended", target=target, fallback="inertial"),
        ]


@pytest.fixture
def declared():
    """A registered plugin with two bisectors that leave everything on one side."""
    registry = agglo.plugins.default()
    registry.register(Declared(), "idle")
    yield
    registry.unregister("idle")


@pytest.mark.usefixtures("declared")
def test_components_of_plugins_are_called_by_their_full_name():
    expected = re.escape("bisector 'lazy' (plugin 'idle', registered by hand)")
    with pytest.raises(PluginError, match=expected):
        agglo.agglomerate(GRID, bisector="lazy", n_parts=2)


@pytest.mark.usefixtures("declared")
def test_a_declared_fallback_is_used():
    result = agglo.agglomerate(GRID, bisector="lazy_but_mended", n_parts=4)
    assert result.parts == [4]
    assert result.statistics["fallbacks"] == 3


def test_in_tree_components_are_called_by_their_full_name(monkeypatch):
    monkeypatch.setattr(
        "agglo_kmeans.kmeans.KMeans.bisect_level", lambda self, level, seeds: np.zeros(level.n)
    )
    monkeypatch.setattr("agglo_kmeans.kmeans.KMeans.grow", lambda *_: None)
    with pytest.raises(PluginError, match=r"bisector 'kmeans' \(plugin 'kmeans', distribution agglo"):
        agglo.agglomerate(GRID, n_parts=2)


# --- a registry of one's own ------------------------------------------------------------------------


class Halving:
    @hookimpl
    def agglo_components(self):
        here = f"{__name__}:"
        return [
            Component(kind="bisector", name="halving", target=here + "EvenOdd"),
            Component(kind="bisector", name="slices", target=here + "Slices"),
            Component(kind="bisector", name="lazy", target=here + "OneSided", fallback="halving"),
            Component(kind="fixer", name="mend", target="agglo_core.refine.connectivity:ConnectivityFixer"),
        ]

    @hookimpl
    def agglo_level_done(self, info):
        self.told.append(info["pieces"])


class EvenOdd:
    def bisect(self, graph, rng):
        return np.arange(graph.n) % 2


class Slices:
    def partition(self, graph, target, seed):
        return np.zeros(graph.n, int)


@pytest.fixture
def own():
    """A registry of its own: what it knows, the program does not, and the other way round."""
    plugin, registry = Halving(), agglo.Registry()
    plugin.told = []
    registry.register(plugin, "own")
    return registry, plugin.told


@pytest.mark.parametrize("bisector", ["halving", "lazy"])
def test_names_are_looked_up_in_the_registry_given(own, bisector):
    registry, told = own
    options = {"bisector": bisector, "refiners": (), "polish": False, "fixer": "mend", "n_parts": 4}
    hierarchy = agglo.agglomerate(GRID, **options, registry=registry)
    assert hierarchy.parts == [4]
    assert len(told) == hierarchy.statistics["depth"] > 0  # who listens there has been told of each depth
    assert agglo.Pipeline(**options).run(GRID, registry).parts == [4]
    with pytest.raises(PluginError, match=f"no bisector is named '{bisector}'"):
        agglo.agglomerate(GRID, **options)
    with pytest.raises(PluginError, match="no bisector is named 'kmeans'"):
        agglo.agglomerate(GRID, n_parts=4, registry=registry)


def test_what_a_direct_partition_needs_besides_is_named(own):
    with pytest.raises(PluginError, match=r"'slices'.* cannot bisect and needs 'inertial': no bisector"):
        agglo.agglomerate(
            GRID, bisector="slices", refiners=(), fixer="mend", method="kway", n_parts=4, registry=own[0]
        )


def test_an_unknown_name_in_a_registry_names_what_it_has(own):
    with pytest.raises(PluginError, match="available: halving, lazy, slices"):
        agglo.agglomerate(GRID, bisector="kmeans", n_parts=2, registry=own[0])
