"""The recursion: quotas, stopping rules, one tree for several targets, seeds, connected components."""

from __future__ import annotations

import random
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, Mesh, OptionError, samples
from agglo_core.agglomeration.goals import CountGoal, SizeGoal, apportion
from agglo_core.arrays import frozen_float, frozen_int


class Random:
    """A bisector that uses its generator and nothing else, and looks at every block on its own."""

    def bisect(self, graph, rng):
        sides = rng.integers(0, 2, graph.n)
        sides[rng.permutation(graph.n)[:2]] = [0, 1]
        return sides


def cloud(measures, n=None):
    n = len(measures)
    points = np.stack((np.arange(n), np.zeros(n)), axis=1)
    return Graph.from_arrays(np.zeros(n + 1, int), [], points, measures=measures)


# --- quotas -----------------------------------------------------------------------------------------


def children_of(quota, left, right):
    """Quotas of the two sides of one block, with the given cell measures."""
    graph = cloud([*left, *right])
    offsets = frozen_int([0, len(left), graph.n])
    goal = CountGoal(quota)
    state, finished = goal.assess(graph, frozen_int(np.arange(graph.n)), offsets, frozen_float([quota]))
    assert np.array_equal(finished, state == 1)
    return [int(k) for k in state]


@pytest.mark.parametrize(
    ("quota", "left", "right", "expected"),
    [
        (2, [1], [1], [1, 1]),
        (2, [100], [1], [1, 1]),  # at least one each
        (4, [1] * 4, [1] * 4, [2, 2]),
        (4, [3] * 4, [1] * 4, [3, 1]),
        (5, [1] * 6, [1] * 4, [3, 2]),
        (10, [9], [1] * 20, [1, 9]),  # one cell takes one part at most
        (10, [1] * 9, [91], [9, 1]),
        (10, [1] * 5, [1] * 5, [5, 5]),
        (7, [1] * 3, [97] * 4, [3, 4]),  # as many parts as cells: a part for each
        (16, [1] * 128, [1] * 128, [8, 8]),
    ],
)
def test_a_split_shares_its_quota_by_measure(quota, left, right, expected):
    assert children_of(quota, left, right) == expected


@given(st.data())
def test_split_quotas_add_up_and_fit(data):
    measure = st.floats(0, 1e6) | st.just(1.0)
    left, right = (data.draw(st.lists(measure, min_size=1, max_size=12)) for _ in range(2))
    quota = data.draw(st.integers(2, len(left) + len(right)))
    first, second = children_of(quota, left, right)
    assert first + second == quota
    assert 1 <= first <= len(left)
    assert 1 <= second <= len(right)
    total = sum(left) + sum(right)
    if total > 0:
        ideal = quota * sum(left) / total
        low, high = max(1, quota - len(right)), min(quota - 1, len(left))
        assert abs(first - np.clip(ideal, low, high)) <= 0.5 + 1e-9


def ideal_shares(k, measures, cells):
    """Multiples of the measures by one factor, limited to 1 and the cells, that add up to k."""

    def limited(factor):
        return np.clip(factor * np.asarray(measures), 1, cells)

    low, high = 0.0, 1e6
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if limited(middle).sum() <= k else (low, middle)
    return limited(low)


def fairest(k, measures, cells):
    """Least sum of squared distances from the ideal shares, over all ways to share k parts."""
    ideal = ideal_shares(k, measures, cells)
    choices = product(*(range(1, c + 1) for c in cells))
    return min(((np.array(q) - ideal) ** 2).sum() for q in choices if sum(q) == k)


@given(st.data())
def test_apportion_is_as_fair_as_any(data):
    cells = data.draw(st.lists(st.integers(1, 6), min_size=1, max_size=4))
    measures = [data.draw(st.sampled_from([0.01, 0.5, 1.0, 1.0, 2.5, 7.0])) for _ in cells]
    k = data.draw(st.integers(len(cells), sum(cells)))
    quotas = apportion(k, frozen_float(measures), frozen_int(cells))
    assert quotas.sum() == k
    assert ((quotas >= 1) & (quotas <= cells)).all()
    ideal = ideal_shares(k, measures, cells)
    assert ((quotas - ideal) ** 2).sum() <= fairest(k, measures, cells) * (1 + 1e-9) + 1e-9


def test_apportion_by_hand():
    assert apportion(6, frozen_float([3, 2, 1]), frozen_int([9, 9, 9])).tolist() == [3, 2, 1]
    assert apportion(5, frozen_float([3, 2, 1]), frozen_int([9, 9, 9])).sum() == 5
    assert apportion(3, frozen_float([1e9, 1e-9, 1e-9]), frozen_int([9, 9, 9])).tolist() == [1, 1, 1]
    assert apportion(9, frozen_float([1e9, 1, 1]), frozen_int([2, 9, 1])).tolist() == [2, 6, 1]
    # what is left beside pieces of one part each is divided in proportion: 75 and 25, not 99 and 1
    masses = frozen_float([600.0, 200.0, *np.ones(100)])
    quotas = apportion(200, masses, frozen_int(masses))
    assert quotas.tolist() == [75, 25] + [1] * 100
    assert apportion(4, frozen_float([0, 0]), frozen_int([5, 5])).tolist() == [2, 2]
    assert (
        apportion(10**6, frozen_float(np.ones(1000)), frozen_int(np.full(1000, 2000))).tolist()
        == [1000] * 1000
    )


def test_apportion_refuses_what_cannot_be():
    with pytest.raises(OptionError, match=r"\b2\b.*few.*\b3\b|few.*\b2\b.*\b3\b"):
        apportion(2, frozen_float([1, 1, 1]), frozen_int([5, 5, 5]))
    with pytest.raises(OptionError, match=r"\b7\b.*many.*\b6\b|many.*\b7\b.*\b6\b"):
        apportion(7, frozen_float([1, 1]), frozen_int([3, 3]))


def test_fewer_parts_than_components_are_refused():
    mesh = samples.disconnected(3)
    for method in ("recursive", "kway"):
        with pytest.raises(OptionError, match="few"):
            agglo.agglomerate(mesh, n_parts=1, method=method)
        assert agglo.agglomerate(mesh, n_parts=2, method=method).parts == [2]


@pytest.mark.parametrize("method", ["recursive", "kway"])
@pytest.mark.parametrize("target", [{"n_parts": 3}, {"h_star": 2.0}])
def test_cells_without_measure_are_still_shared(method, target):
    """Zero measures (a graph of loads, say) fall back on numbers of cells."""
    n = 6
    indptr, indices = np.cumsum([0, 1, 2, 2, 2, 2, 1]), [1, 0, 2, 1, 3, 2, 4, 3, 5, 4]
    points = np.stack((np.arange(n), np.zeros(n)), axis=1)
    for measures in (np.zeros(n), [0, 0, 0, 0, 0, 1.0]):
        graph = Graph.from_arrays(indptr, indices, points, measures=measures)
        labels = agglo.agglomerate(graph, method=method, **target).levels[0]
        assert len(set(graph.components(labels))) == labels.max() + 1
        if "n_parts" in target:
            assert labels.max() + 1 == 3


# --- sizes ------------------------------------------------------------------------------------------


def test_a_size_is_met_up_to_rounding_and_not_beyond():
    grid = samples.squares(4).graph
    order, offsets = frozen_int(np.arange(16)), frozen_int([0, 16])
    for h_star, small_enough in [(np.sqrt(2), True), (np.sqrt(2) * (1 - 5e-10), True), (1.414213, False)]:
        diameter, finished = SizeGoal(h_star).assess(grid, order, offsets)
        assert diameter == pytest.approx([np.sqrt(2)])
        assert finished.tolist() == [small_enough]
    _, finished = SizeGoal(1e-3).assess(grid, order, frozen_int([0, 1, 16]))
    assert finished.tolist() == [True, False]  # a single cell is finished whatever its size


def test_single_cells_larger_than_the_target_stay_alone_and_are_counted(caplog):
    points = [[0, 0], [4, 0], [4, 4], [0, 4], [4.5, 0], [4.5, 0.5], [4, 0.5], [5, 0], [5, 0.5]]
    cells = [[0, 1, 6, 2, 3], [1, 4, 5, 6], [4, 7, 8, 5]]
    mesh = Mesh.from_polygons(points, cells)
    for method in ("recursive", "kway"):
        result = agglo.agglomerate(mesh, h_star=[1.2, 2.0], method=method, merge=True)
        assert [labels.tolist() for labels in result.levels] == [[0, 1, 1], [0, 1, 1]]
        assert result.statistics["oversized_cells"] == 1
    assert "1 cell" in caplog.text


def test_the_whole_mesh_may_be_one_part_and_every_cell_its_own():
    mesh = samples.voronoi(40, seed=1)
    result = agglo.agglomerate(mesh, h_star=[1e-9, 1e9])
    np.testing.assert_array_equal(result.levels[0], np.arange(40))
    assert not result.levels[1].any()
    assert agglo.agglomerate(mesh, n_parts=[1, 40]).parts == [40, 1]


# --- one tree ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("bisector", ["kmeans", "spectral", "inertial", "coordinate", "metis", Random()])
def test_levels_of_one_tree_are_the_levels_of_separate_runs(bisector):
    """Splits depend on the place in the tree alone, so a coarser target stops the same recursion."""
    mesh = samples.random_triangles(60, seed=5)
    factors = (1.2, 2, 2, 3.5)
    how = {"bisector": bisector, "seed": 4, "polish": False}
    together = agglo.agglomerate(mesh, h_factor=factors, **how)
    assert len(together.levels) == 4
    for level, factor in enumerate(factors):
        alone = agglo.agglomerate(mesh, h_factor=factor, **how)
        np.testing.assert_array_equal(together.levels[level], alone.levels[0])
    apart = agglo.agglomerate(mesh, h_factor=factors, **how, nested=False)
    for one, other in zip(together.levels, apart.levels, strict=True):
        np.testing.assert_array_equal(one, other)


def test_several_counts_go_coarsest_first_and_repeats_stay():
    mesh = samples.random_triangles(60, seed=5)
    result = agglo.agglomerate(mesh, n_parts=[5, 20, 5, 1])
    assert result.parts == [20, 5, 5, 1]
    np.testing.assert_array_equal(result.levels[1], result.levels[2])
    np.testing.assert_array_equal(result.levels[2], agglo.agglomerate(mesh, n_parts=5).levels[0])
    assert [each["n_parts"] for each in result.targets] == [20, 5, 5, 1]


def test_levels_that_are_not_nested_say_so():
    mesh = samples.random_triangles(60, seed=5)
    loose = agglo.agglomerate(mesh, n_parts=[5, 20], nested=False)
    assert not loose.nested
    with pytest.raises(ValueError, match="not nested"):
        loose.parents(0)
    for level, k in enumerate((20, 5)):
        np.testing.assert_array_equal(loose.levels[level], agglo.agglomerate(mesh, n_parts=k).levels[0])
    assert loose.overlap(0).sum() == pytest.approx(1.0)


# --- seeds ------------------------------------------------------------------------------------------


def test_the_seed_decides_and_nothing_else():
    mesh = samples.voronoi(80, seed=6)
    state = random.getstate(), np.random.get_state()[1].copy()  # noqa: NPY002
    runs = [agglo.agglomerate(mesh, bisector=Random(), h_factor=2, seed=s).levels[0] for s in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    assert random.getstate() == state[0]
    np.testing.assert_array_equal(np.random.get_state()[1], state[1])  # noqa: NPY002


def test_every_piece_has_a_seed_of_its_own():
    seen = []

    class Spy:
        def bisect_level(self, level, seeds):
            assert seeds.dtype == np.uint64
            assert seeds.shape == (level.n_blocks,)
            seen.extend(seeds.tolist())
            sides = np.arange(level.n) - level.offsets[level.block_ids]
            return (2 * sides >= np.diff(level.offsets)[level.block_ids]).astype(int)

    agglo.agglomerate(samples.disconnected(12), bisector=Spy(), n_parts=200)
    assert len(seen) == len(set(seen)) == 198


@pytest.mark.parametrize("bisector", ["kmeans", "spectral", "inertial", "coordinate"])
def test_a_disconnected_mesh_is_its_components_run_alone(bisector):
    one, two = samples.random_triangles(40, seed=1), samples.voronoi(50, seed=2)
    both = Mesh.from_polygons(
        np.concatenate((one.points, 0.7 * two.points + [3.0, 1.0])),
        [*_cells(one), *(cell + len(one.points) for cell in _cells(two))],
    )
    alone = [
        agglo.agglomerate(one, bisector=bisector, h_star=0.4).levels[0],
        agglo.agglomerate(two, bisector=bisector, h_star=0.4 / 0.7).levels[0],
    ]
    together = agglo.agglomerate(both, bisector=bisector, h_star=0.4).levels[0]
    np.testing.assert_array_equal(together, np.concatenate((alone[0], alone[1] + alone[0].max() + 1)))


def _cells(mesh):
    loops = mesh.boundary_loops
    return np.split(loops.vertices, loops.loop_offsets[1:-1])


@settings(max_examples=30)
@given(st.integers(2, 60), st.integers(0, 2**32 - 1), st.data())
def test_any_graph_is_divided_exactly(n, seed, data):
    """Trees, stars, loops, clouds of isolated nodes: exact counts, connected parts."""
    rng = np.random.default_rng(seed)
    edges = np.unique(np.sort(rng.integers(0, n, (data.draw(st.integers(0, 2 * n)), 2)), axis=1), axis=0)
    edges = edges[edges[:, 0] < edges[:, 1]]
    both = np.concatenate((edges, edges[:, ::-1]))
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    indptr = np.searchsorted(both[:, 0], np.arange(n + 1))
    graph = Graph.from_arrays(indptr, both[:, 1], rng.random((n, 2)), measures=rng.random(n))
    least = int(graph.components().max()) + 1
    k = data.draw(st.integers(least, n))
    for bisector in ("kmeans", "coordinate", "spectral", Random()):
        labels = agglo.agglomerate(graph, bisector=bisector, n_parts=k).levels[0]
        assert labels.max() + 1 == k
        assert graph.components(labels).max() + 1 == k
