"""The refiner balance: parts of equal size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from ragged_parts import grown

import agglo_core as agglo
from agglo_core import Graph, samples
from agglo_core.arrays import Int, frozen_float, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.balance import BalanceRefiner
from agglo_core.refine.balance_paths import even_out

KINDS = {
    "triangles": lambda seed: samples.random_triangles(150, seed=seed).graph,
    "voronoi": lambda seed: samples.voronoi(250, seed=seed).graph,
    "tetrahedra": lambda seed: samples.tetrahedra(4).graph,
}


def evened(graph: Graph, labels: Int, **options: Any) -> Int:
    parts = int(labels.max()) + 1
    return BalanceRefiner(**options).refine(graph, labels, np.zeros(1, np.uint64), Target(parts=parts))


@given(st.sampled_from(sorted(KINDS)), st.integers(0, 10_000), st.integers(2, 8))
@settings(max_examples=30, deadline=None)
def test_ragged_parts_become_even_as_far_as_cells_can_leave(kind: str, seed: int, parts: int) -> None:
    graph = KINDS[kind](seed % 50)
    labels = grown(graph, seed, parts)
    after = evened(graph, labels, tolerance=0.0)
    before, cells = (np.bincount(each, minlength=parts) for each in (labels, after))
    assert len(np.unique(graph.components(after))) == parts
    assert cells.min() > 0
    assert (cells**2).sum() <= (before**2).sum()


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("seed", range(5))
def test_numbers_of_cells_of_compact_parts_become_the_same(kind: str, seed: int) -> None:
    graph = KINDS[kind](seed)
    labels = agglo.agglomerate(graph, n_parts=6).levels[0]
    cells = np.bincount(evened(graph, labels, tolerance=0.0))
    assert cells.max() - cells.min() <= (1 if graph.n % 6 else 0)


@pytest.mark.parametrize("size", ["cells", "measure"])
def test_nothing_moves_within_the_tolerance(size: str) -> None:
    graph = samples.squares(12).graph
    labels = (np.arange(144) >= 66).astype(np.int64)  # 66 and 78 of 72: 8 % off
    np.testing.assert_array_equal(evened(graph, labels, size=size, tolerance=0.09), labels)
    after = evened(graph, labels, size=size, tolerance=0.05)
    assert np.abs(np.bincount(after) - 72).max() <= 3


def test_cells_go_through_parts_between() -> None:
    graph = samples.strip(12).graph
    labels = np.array([0] * 6 + [1, 1] + [2, 2] + [3, 3])
    np.testing.assert_array_equal(evened(graph, labels), np.repeat([0, 1, 2, 3], 3))


def test_weights_are_evened_out() -> None:
    graph = samples.voronoi(400, seed=5).graph
    weights = np.where(graph.centroids[:, 0] > 0.0, 4.0, 1.0)
    graph = replace(graph, weights=weights)
    labels = agglo.agglomerate(samples.voronoi(400, seed=5), n_parts=8, polish=False).levels[0]
    before, after = (np.bincount(each, weights) for each in (labels, evened(graph, labels, size="weights")))
    assert np.abs(before / before.mean() - 1.0).max() > 0.5
    assert np.abs(after / after.mean() - 1.0).max() < 0.05


def heaviest(labels: Int, sizes: Any) -> float:
    """Size of the largest part over the mean."""
    of_parts = np.bincount(labels, sizes)
    return float(of_parts.max() / of_parts.mean())


DISTRICTS: dict[str, dict[str, Any]] = {
    "post-refiner": {"post_refiners": (("balance", {"size": "weights"}),)},
    "post-refiner, default": {"post_refiners": ("balance",)},
    "before fm": {"post_refiners": ("balance", ("fm", {"tolerance": 0.02}))},
    "refiner of splits": {"refiners": ("balance",), "polish": False, "n_parts": 8},
    "descent": {"post_refiners": ("balance", ("descent", {"objective": "balance"}))},
    "direct": {"method": "kway", "post_refiners": ("balance",)},
    "constraint": {"max_cells": 400, "post_refiners": ("balance",)},
}


@pytest.mark.parametrize("case", sorted(DISTRICTS))
def test_weights_given_to_a_run_are_evened_out(case: str) -> None:
    mesh = samples.voronoi(1200, seed=1)
    people = np.random.default_rng(0).lognormal(3.0, 1.0, mesh.n_cells)
    hierarchy = agglo.agglomerate(mesh, **{"n_parts": 12, "weights": people} | DISTRICTS[case])
    assert heaviest(hierarchy.levels[0], people) < 1.06
    assert hierarchy.statistics["imbalance"] == [pytest.approx(heaviest(hierarchy.levels[0], people))]


def test_the_default_evens_out_what_the_run_balances() -> None:
    mesh = samples.random_triangles(400, seed=3)
    graph = replace(mesh.graph, weights=mesh.cell_measures * np.where(mesh.cell_centroids[:, 0] > 0.5, 5, 1))
    for balance in ("cells", "measure", "weights"):
        labels = agglo.agglomerate(graph, n_parts=6, balance=balance, post_refiners=("balance",)).levels[0]
        others = {"cells", "measure", "weights"} - {balance}
        assert heaviest(labels, graph.node_sizes(balance)) < 1.02
        assert min(heaviest(labels, graph.node_sizes(each)) for each in others) > 1.03


def test_weights_of_the_graph_hold_where_the_run_has_none() -> None:
    mesh = samples.voronoi(1200, seed=1)
    people = np.random.default_rng(0).lognormal(3.0, 1.0, mesh.n_cells)
    graph = replace(mesh.graph, weights=people)
    size = (("balance", {"size": "weights"}),)
    assert heaviest(agglo.agglomerate(graph, n_parts=12, post_refiners=size).levels[0], people) < 1.06


def test_metis_balances_measures_where_the_run_does() -> None:
    mesh = samples.random_triangles(400, seed=3)
    graph = replace(mesh.graph, weights=np.where(mesh.cell_centroids[:, 0] > 0.5, 5.0, 1.0))
    labels = agglo.agglomerate(
        graph, bisector="metis", n_parts=2, balance="measure", refiners=(), polish=False
    ).levels[0]
    assert heaviest(labels, graph.measures) < 1.02


def test_the_objective_it_names_says_how_even_sizes_are() -> None:
    graph = samples.random_triangles(300, seed=1).graph
    labels = agglo.agglomerate(graph, n_parts=10).levels[0]
    for size, objective in (
        ("cells", "cell_balance"),
        ("measure", "measure_balance"),
        ("weights", "balance"),
        (None, "run_balance"),
    ):
        after = evened(graph, labels, size=size, tolerance=0.0)
        assert OBJECTIVES[objective](graph, after) < OBJECTIVES[objective](graph, labels)
        assert BalanceRefiner(size=size).objective == objective
    cells = np.bincount(labels).astype(float)
    assert OBJECTIVES["cell_balance"](graph, labels) == pytest.approx((cells**2).sum())


def test_compact_parts_stay_compact() -> None:
    graph = samples.voronoi(4000, seed=3).graph
    labels = agglo.agglomerate(graph, n_parts=20).levels[0]
    after = evened(graph, labels, tolerance=0.0)
    assert OBJECTIVES["compactness"](graph, after) < 1.15 * OBJECTIVES["compactness"](graph, labels)


def test_components_are_evened_out_each_by_itself() -> None:
    mesh = samples.disconnected(6)
    labels = agglo.agglomerate(mesh, n_parts=6, post_refiners=(("balance", {"tolerance": 0.0}),)).levels[0]
    assert np.bincount(labels).tolist() == [12] * 6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": "area"}, "balance: size must be one of cells, measure, weights; given 'area'"),
        ({"tolerance": -1.0}, "balance: tolerance must be a number, 0 or more, not -1.0"),
        ({"tolerance": True}, "balance: tolerance must be a number, 0 or more, not True"),
    ],
)
def test_options_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        BalanceRefiner(**options)


def test_cells_handed_on_again_and_again_fit_the_list_of_moves() -> None:
    """Thirty light cells go from part to part on one way, with more moves than there are cells.

    In Python, where a row too many is an error; a compiled kernel would write beyond its array.
    """
    light = range(1, 31)
    pairs = (
        [(0, i) for i in light] + [(i, 31) for i in light] + [(i, 32) for i in light] + [(31, 32), (32, 33)]
    )
    pairs += [(i, j) for i in light for j in light if i < j]
    neighbours: list[list[int]] = [[] for _ in range(34)]
    for i, j in pairs:
        neighbours[i].append(j)
        neighbours[j].append(i)
    indptr = np.concatenate(([0], np.cumsum([len(cells) for cells in neighbours])))
    indices = np.concatenate([np.sort(cells) for cells in neighbours]).astype(np.int32)
    places = np.array([[0, 0], *([0.9, 0.001 * i] for i in light), [0.5, 0], [1.2, 0], [3, 0]], float)
    weights = np.array([10, *[0.1] * 30, 10, 1e-6, 7])
    labels = np.array([0] * 31 + [1, 1, 2])
    block, mean, room = np.zeros(3, np.int64), np.array([weights.sum() / 3]), np.array([0.01])
    graph = frozen_int(indptr), frozen_index(indices), frozen_float(places)
    parts = frozen_int(labels), frozen_int(block), frozen_float(mean), frozen_float(room)
    slow = even_out.py_func(*graph, frozen_float(weights), *parts)
    assert slow.tolist() == even_out(*graph, frozen_float(weights), *parts).tolist()
    sizes = np.bincount(slow, weights)
    assert np.ptp(sizes) < np.ptp(np.bincount(labels, weights))
