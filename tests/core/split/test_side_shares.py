"""Counts that are no power of two: pieces are cut at the share of the parts that each side is to hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, PluginError, samples
from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.graph.blocks import split_at_median
from agglo_core.split.side_shares import shift_cuts, side_shares

BISECTORS = (
    "kmeans",
    "kmeans_sklearn",
    "metis",
    ("spectral", {"split": "median"}),
    "coordinate",
    "inertial",
    "sweep",
    "gnn",
    "gnn_paper",
)
SHARES = st.floats(0.05, 0.49)
VORONOI = samples.voronoi(600, seed=1)


def largest(labels: Int, sizes: Any = None) -> float:
    """Size of the largest part over the mean."""
    of_parts = np.bincount(labels, sizes)
    return float(of_parts.max() / of_parts.mean())


@pytest.mark.parametrize("bisector", BISECTORS, ids=str)
@pytest.mark.parametrize("parts", [3, 7])
def test_parts_are_even(bisector: Any, parts: int) -> None:
    assert largest(agglo.agglomerate(VORONOI, bisector=bisector, n_parts=parts).levels[0]) < 1.24


@pytest.mark.parametrize("bisector", ["kmeans", "coordinate", "inertial", "metis"])
def test_solid_parts_for_odd_counts_are_even(bisector: str) -> None:
    mesh = samples.tetrahedra(5)
    for parts in (3, 5, 7):
        assert largest(agglo.agglomerate(mesh, bisector=bisector, n_parts=parts).levels[0]) < 1.25


@pytest.mark.parametrize("bisector", ["kmeans", "coordinate", "metis", "inertial"])
@pytest.mark.parametrize("refiners", [("interface",), ()])
def test_parts_share_out_what_the_run_balances(bisector: str, refiners: tuple[str, ...]) -> None:
    people = np.random.default_rng(0).lognormal(0.0, 0.5, VORONOI.n_cells)
    for options in ({"weights": people}, {"balance": "measure"}):
        labels = agglo.agglomerate(
            VORONOI, bisector=bisector, n_parts=3, refiners=refiners, polish=False, **options
        ).levels[0]
        sizes = people if "weights" in options else VORONOI.cell_measures
        assert largest(labels, sizes) < 1.12


def test_levels_of_counts_are_even() -> None:
    fine, coarse = agglo.agglomerate(VORONOI, n_parts=(12, 3)).levels
    assert largest(coarse) < 1.1
    assert largest(fine) < 1.28
    assert len(np.unique(np.stack((fine, coarse)), axis=1)[0]) == 12


def test_regions_are_divided_evenly() -> None:
    left = VORONOI.cell_centroids[:, 0] < 0.5
    labels = agglo.agglomerate(VORONOI, n_parts=6, regions=left).levels[0]
    for region in (left, ~left):
        assert largest(np.unique(labels[region], return_inverse=True)[1]) < 1.12


def test_parts_that_a_partition_lacks_are_made_up_evenly() -> None:
    class Whole:
        """A partition into fewer parts than the target."""

        def partition(self, graph: Graph, target: agglo.Target, seed: int) -> Int:
            return np.zeros(graph.n, np.int64)

    labels = agglo.agglomerate(VORONOI, bisector=Whole(), method="kway", n_parts=3, polish=False).levels[0]
    assert largest(labels) < 1.05


class Halves:
    """A bisector that only halves, graph by graph."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> Int:
        return split_at_median(graph, graph.centroids[:, 0], graph.centroids)


class Thirds(Halves):
    """One that cuts at shares, too, and records them."""

    def __init__(self) -> None:
        self.requests: list[list[float]] = []

    def bisect_shares(self, level: Graph, seeds: Any, shares: Any) -> Int:
        self.requests.append(shares.tolist())
        return split_at_median(level, level.centroids[:, 0], level.centroids, shares)


def test_bisectors_that_only_halve_give_even_parts() -> None:
    for parts in (3, 5, 7):
        hierarchy = agglo.agglomerate(VORONOI, bisector=Halves(), n_parts=parts, polish=False)
        assert largest(hierarchy.levels[0]) < 1.15


def test_a_bisector_is_given_the_shares_of_odd_quotas_alone() -> None:
    one = Thirds()
    hierarchy = agglo.agglomerate(VORONOI, bisector=one, n_parts=7, refiners=(), polish=False)
    assert largest(hierarchy.levels[0]) < 1.15
    assert one.requests == [[pytest.approx(3 / 7)], [pytest.approx(1 / 3)]]
    for parts in (2, 8, 64):
        again = Thirds()
        agglo.agglomerate(VORONOI, bisector=again, n_parts=parts)
        assert again.requests == []


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda n: np.zeros(n - 1, int), "returned shape"),
        (lambda n: np.full(n, 2), "expected 0 and 1"),
        (lambda n: np.zeros(n, int), "put all 600 cells of a piece on one side"),
    ],
)
def test_what_it_returns_is_checked(returned: Any, message: str) -> None:
    class Wrong(Halves):
        def bisect_shares(self, level: Graph, seeds: Any, shares: Any) -> Any:
            return returned(level.n)

    with pytest.raises(PluginError, match=message):
        agglo.agglomerate(VORONOI, bisector=Wrong(), n_parts=3)


def test_shares_by_quota() -> None:
    shares = side_shares(100)
    assert shares[[1, 2, 3, 4, 5, 6, 7, 15, 16]].tolist() == [
        0.5,
        0.5,
        1 / 3,
        0.5,
        0.4,
        0.5,
        3 / 7,
        7 / 15,
        0.5,
    ]
    for parts in (0, 1, 2, 64):
        assert set(side_shares(parts)) == {0.5}


@settings(max_examples=25, deadline=None)
@given(
    st.integers(2, 200), st.sampled_from([2, 3]), st.integers(0, 10**6), st.booleans(), st.floats(0.05, 0.49)
)
def test_a_moved_cut_leaves_the_share_to_the_lighter_side(
    n: int, dim: int, seed: int, lattice: bool, share: float
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((2 * n, dim))
    points = np.rint(2 * points) if lattice else points
    graph = Graph.from_arrays(
        np.zeros(2 * n + 1, int), [], points, measures=rng.integers(0, rng.integers(1, 4), 2 * n)
    )
    level = graph.subgraph(np.arange(2 * n), [0, n, 2 * n])
    sides = frozen_int(rng.integers(0, 2, 2 * n))
    after = shift_cuts(level, sides, frozen_int([1]), frozen_float([0.5, share]))
    assert np.array_equal(after[:n], sides[:n])
    mass = level.mass[n:] if level.mass[n:].any() else np.ones(n)
    light = min(mass[after[n:] == side].sum() for side in (0, 1))
    assert 0 < after[n:].sum() < n
    assert abs(light - share * mass.sum()) <= max(mass.max(), 0.051 * share * mass.sum())
    alone = shift_cuts(level.take([1]), sides[n:], frozen_int([0]), frozen_float([share]))
    assert np.array_equal(after[n:], alone)


def test_a_row_of_cells_by_hand() -> None:
    strip = samples.strip(9).graph
    for halves in (np.arange(9) >= 5, np.arange(9) < 5):
        sides = shift_cuts(strip, frozen_int(halves), frozen_int([0]), frozen_float([1 / 3]))
        lighter = sides[8]
        assert (sides == lighter).tolist() == [False] * 6 + [True] * 3


def test_a_cut_near_its_share_stays() -> None:
    strip, sides = samples.strip(100).graph, frozen_int(np.arange(100) >= 66)
    assert np.array_equal(shift_cuts(strip, sides, frozen_int([0]), frozen_float([1 / 3])), sides)
    assert shift_cuts(strip, sides, frozen_int([0]), frozen_float([0.3])).sum() in (30, 70)


def test_equal_cells_are_taken_across_the_line() -> None:
    """Of a column that is cut, the cells at one end go to one side, whatever their numbers."""
    squares = samples.squares(4)
    order = np.random.default_rng(3).permutation(16)
    graph = squares.graph.subgraph(order, [0, 16])
    x, y = np.rint(4 * squares.cell_centroids[order] - 0.5).T
    sides = shift_cuts(graph, frozen_int(x >= 2), frozen_int([0]), frozen_float([6 / 16]))
    light = sides == np.argmin(np.bincount(sides))
    assert light.sum() == 6
    column = light & (np.bincount(x.astype(int), light)[x.astype(int)] == 2)
    assert sorted(y[column].tolist()) in ([0, 1], [2, 3])


def test_sides_with_one_centroid_and_no_mass_are_cut_all_the_same() -> None:
    graph = Graph.from_arrays(np.zeros(10, int), [], np.zeros((9, 2)), measures=np.zeros(9))
    sides = shift_cuts(graph, frozen_int(np.arange(9) < 4), frozen_int([0]), frozen_float([1 / 3]))
    assert sorted(np.bincount(sides).tolist()) == [3, 6]


def test_a_share_of_the_mass_lies_below_the_cut() -> None:
    graph = samples.strip(10).graph.with_mass([1, 1, 1, 1, 6, 1, 1, 1, 1, 2])
    for share, below in ((0.25, 4), (0.4, 4), (0.5, 5), (0.75, 7)):
        sides = split_at_median(graph, graph.centroids[:, 0], graph.centroids, np.array([share]))
        assert (1 - sides).sum() == below
