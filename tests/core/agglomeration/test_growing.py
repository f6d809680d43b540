"""Bisectors that make all splits of a run by themselves: the same labels as depth by depth, and checked."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, Mesh, PluginError, samples
from agglo_core.agglomeration.choices import new_run
from agglo_core.agglomeration.goals import CountGoal
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.levels.recursion import recursive_levels
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.compiled.sums import slice_sums
from agglo_core.progress import Progress
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.repair import mend_blocks
from agglo_core.split.geometric import CoordinateBisection

SEEDS = st.integers(0, 10**6)


class DepthByDepth:
    """The splits of ``coordinate``, which the driver asks for one depth after the other, in numpy."""

    def bisect_level(self, level, seeds):
        return CoordinateBisection().bisect_level(level, seeds)

    def bisect_shares(self, level, seeds, shares):
        return CoordinateBisection().bisect_shares(level, seeds, shares)


def fused(hierarchy) -> bool:
    return "grow" in hierarchy.statistics["seconds"]


def assert_alike(given: Mesh | Graph, **targets: Any) -> None:
    """Both ways agree, in labels and in what they tell."""
    one, other = (
        agglo.agglomerate(given, bisector=each, refiners=(), **targets)
        for each in ("coordinate", DepthByDepth())
    )
    assert (fused(one), fused(other)) == (True, False)
    for labels, wanted in zip(one.levels, other.levels, strict=True):
        assert np.array_equal(labels, wanted)
    for key in ("depth", "bisections", "repairs", "fallbacks", "oversized_cells"):
        assert one.statistics[key] == other.statistics[key]
    assert (one.parts, one.targets, one.nested) == (other.parts, other.targets, other.nested)


MESHES: dict[str, Callable[[int, int], Mesh]] = {
    "voronoi": lambda n, seed: samples.voronoi(n + 8, seed=seed),
    "random_triangles": lambda n, seed: samples.random_triangles(n + 8, seed=seed),
    "triangles": lambda n, seed: samples.triangles(1 + n // 20),
    "squares": lambda n, seed: samples.squares(1 + n // 15),
    "hexagons": lambda n, seed: samples.hexagons(2 + n // 20),
    "disconnected": lambda n, seed: samples.disconnected(2 + n // 30),
    "ring": lambda n, seed: samples.ring(3 + n // 3),
    "boxes": lambda n, seed: samples.boxes(1 + n // 40),
    "tetrahedra": lambda n, seed: samples.tetrahedra(1 + n // 60),
}


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(sorted(MESHES)), st.integers(0, 200), SEEDS, st.data())
def test_both_ways_agree_on_meshes(kind: str, n: int, seed: int, data: st.DataObject) -> None:
    mesh = MESHES[kind](n, seed)
    least = int(mesh.graph.components().max()) + 1
    parts = data.draw(st.lists(st.integers(least, mesh.n_cells), min_size=1, max_size=3))
    assert_alike(mesh, n_parts=parts, nested=data.draw(st.booleans()))
    assert_alike(mesh, h_factor=data.draw(st.floats(0.5, 6.0)))


def random_graph(n: int, dim: int, seed: int) -> Graph:
    """Connected pieces, coordinates of which many agree, weights and measures of which some are zero."""
    rng = np.random.default_rng(seed)
    network = nx.Graph()
    network.add_nodes_from(range(n))
    pieces = rng.integers(0, rng.integers(1, 4), n)
    for piece in np.unique(pieces):
        nodes = rng.permutation(np.flatnonzero(pieces == piece)).tolist()
        for place, node in enumerate(nodes[1:], 1):
            others = [nodes[k] for k in rng.integers(max(0, place - 6), place, 2)]
            network.add_edges_from((node, each, {"weight": float(rng.random())}) for each in others)
    matrix = nx.to_scipy_sparse_array(network, nodelist=range(n), format="csr")
    centroids = rng.integers(0, rng.integers(1, 9), (n, dim)) + 1e-9 * rng.random((n, dim))
    return Graph.from_arrays(
        matrix.indptr,
        matrix.indices,
        centroids,
        interface=matrix.data,
        measures=rng.integers(0, rng.integers(1, 4), n),
        weights=rng.integers(0, rng.integers(1, 4), n),
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 90), st.sampled_from([2, 3]), SEEDS, st.data())
def test_both_ways_agree_on_any_graph(n: int, dim: int, seed: int, data: st.DataObject) -> None:
    graph = random_graph(n, dim, seed)
    least = int(graph.components().max()) + 1
    parts = data.draw(st.lists(st.integers(least, n), min_size=1, max_size=3))
    assert_alike(graph, n_parts=parts)
    hierarchy = agglo.agglomerate(graph, bisector="coordinate", refiners=(), n_parts=parts)
    network = nx.from_scipy_sparse_array(graph.to_scipy())
    for labels, count in zip(hierarchy.levels, sorted(parts, reverse=True), strict=True):
        assert np.array_equal(np.unique(labels), np.arange(count))
        for part in range(count):
            assert nx.is_connected(network.subgraph(np.flatnonzero(labels == part).tolist()))
    for level in range(len(parts) - 1):
        assert np.array_equal(hierarchy.parents(level)[hierarchy.levels[level]], hierarchy.levels[level + 1])


def test_the_splits_of_a_small_grid_by_hand() -> None:
    labels = agglo.agglomerate(samples.squares(4), bisector="coordinate", refiners=(), n_parts=(8, 2)).levels
    assert labels[1].reshape(4, 4).tolist() == [[0, 0, 1, 1]] * 4
    assert labels[0].reshape(4, 4).tolist() == [[0, 1, 2, 3]] * 2 + [[4, 5, 6, 7]] * 2


def test_other_pipelines_grow_depth_by_depth() -> None:
    class Fixer(ConnectivityFixer):
        """Who knows what it does."""

    mesh = samples.voronoi(60, seed=1)

    def run(**options: Any) -> bool:
        return fused(agglo.agglomerate(mesh, bisector="coordinate", **options))

    assert run(refiners=(), cells_per_part=6)
    assert not run(cells_per_part=6)
    assert not run(refiners=(), fixer=Fixer(), cells_per_part=6)
    assert run(refiners=(), h_factor=3)
    assert run(refiners=(), polish=False, cells_per_part=6)
    assert run(refiners=(), post_refiners=("interface",), cells_per_part=6)


def test_every_depth_and_fraction_is_reported() -> None:
    mesh = samples.triangles(12)
    graph, goals = mesh.graph, [CountGoal(100), CountGoal(12)]
    told: list[Progress] = []
    seen: list[list[dict[str, Any]]] = []
    for bisector in ("coordinate", DepthByDepth()):
        depths: list[dict[str, Any]] = []
        seen.append(depths)
        chosen = agglo.Pipeline(bisector=bisector, refiners=(), polish=False)
        progress = told.append if bisector == "coordinate" else None
        run = new_run(chosen, agglo.plugins.default(), progress)
        recursive_levels(graph, goals, replace(run, listen=depths.append), PostPass(False, False))
    assert seen[0] == seen[1]
    assert len(seen[0]) > 6
    first = [each.fraction for each in told if each.text.startswith("level 1 of 2")]
    assert first[0] == 0.0
    assert first[1] > 0.0
    assert first[-1] == 1.0
    assert told[-1].text == "level 2 of 2: 100 parts"


def test_an_exception_of_the_listener_ends_the_run() -> None:
    class Enough(Exception):
        """What whoever is told says."""

    def refuse(progress):
        if progress.phase == "agglomerating":
            raise Enough

    with pytest.raises(Enough):
        agglo.agglomerate(samples.squares(9), bisector="coordinate", refiners=(), n_parts=5, progress=refuse)


# --- what others return -----------------------------------------------------------------------------------


class Grows:
    """A bisector that returns these labels, and offers it under any circumstances."""

    def __init__(self, labels) -> None:
        self.labels = labels

    def bisect_level(self, level, seeds):
        raise AssertionError("nobody asks")

    def grow(self, graph, pieces, refiners, fixer):
        return self

    def split(self, quotas, seeds, notify):
        return self.labels, np.array([[1, 8, 0]])


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (None, "grow returned None, expected \\(8,\\) integers"),
        (np.zeros(7, int), "grow returned shape \\(7,\\)"),
        (np.zeros(8), "expected \\(8,\\) integers"),
        (np.array([0, 0, 1, 1, 2, 2, 4, 4]), "grew labels 0..4, but there are 4 parts"),
        (np.array([0, 0, 1, 1, 2, 2, 2, 2]), "split piece 1 into 1 parts, expected 2"),
        (np.array([0, 0, 1, 1, 1, 2, 3, 3]), "grew a part that spans two pieces"),
        (np.array([0, 1, 1, 0, 2, 2, 3, 3]), "left a part disconnected"),
    ],
)
def test_bad_growth_is_refused_and_named(labels, message: str) -> None:
    chains = [[0, 1, 2, 3], [4, 5, 6, 7]]
    network = nx.compose(*map(nx.path_graph, chains))
    matrix = nx.to_scipy_sparse_array(network, nodelist=range(8), format="csr")
    points = np.stack((np.arange(8.0), np.zeros(8)), axis=1)
    graph = Graph.from_arrays(matrix.indptr, matrix.indices, points)
    with pytest.raises(PluginError, match=f"bisector Grows.*{message}"):
        agglo.agglomerate(graph, bisector=Grows(labels), n_parts=4, polish=False)
    good = np.repeat(np.arange(4), 2)
    assert np.array_equal(agglo.agglomerate(graph, bisector=Grows(good), n_parts=4).levels[0], good)


class Keeps:
    """A post-refiner that leaves everything as it is."""

    def refine(self, graph, labels, seeds, target):
        return labels


def test_broken_growth_is_refused_unless_the_polish_connects_it() -> None:
    graph, broken = samples.squares(4).graph, np.repeat([0, 1, 0, 1], 4)  # quadrants along the curve
    with pytest.raises(PluginError, match=r"bisector Grows.*left a part disconnected"):
        agglo.agglomerate(graph, bisector=Grows(broken), n_parts=2, post_refiners=(Keeps(),))
    polished = agglo.agglomerate(graph, bisector=Grows(broken), n_parts=2).levels[0]
    assert graph.components(polished).max() == polished.max() == 1


# --- the kernels ------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 3000), SEEDS)
def test_sums_are_those_of_numpy(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, order = rng.random(n) ** 9, rng.permutation(n)
    offsets = np.unique(np.concatenate(([0, n], rng.integers(0, n, rng.integers(0, 20)))))
    sums = slice_sums(frozen_float(values), frozen_int(order), frozen_int(offsets))
    np.testing.assert_allclose(sums, np.add.reduceat(values[order], offsets[:-1]), rtol=1e-13)


def slow_mend(network: nx.Graph, measures, labels):
    """The largest component of each part stays; rings of the others join whom they share most with."""
    parts, waiting = labels.copy(), []
    for part in np.unique(labels):
        found = nx.connected_components(network.subgraph(np.flatnonzero(labels == part).tolist()))
        _, *loose = sorted(map(list, found), key=lambda nodes: -measures[nodes].sum())
        waiting += loose
    for nodes in waiting:
        parts[nodes] = -1
    while waiting:
        choices = []
        for nodes in waiting:
            shared: dict[int, float] = defaultdict(float)
            for i in nodes:
                for j, edge in network[i].items():
                    if parts[j] >= 0:
                        shared[parts[j]] += edge["weight"]
            choices.append(max(shared, key=lambda part: shared[part]) if shared else -1)
        for nodes, choice in zip(waiting, choices, strict=True):
            parts[nodes] = choice
        waiting = [nodes for nodes, choice in zip(waiting, choices, strict=True) if choice < 0]
    return parts


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 60), st.integers(2, 4), SEEDS)
def test_blocks_are_mended_as_an_obvious_reference_does(n: int, parts: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = random_graph(n, 2, seed)
    level, _ = graph.split(graph.components())
    measures = rng.random(n)
    labels = frozen_int(rng.integers(0, parts, n))
    network = nx.from_scipy_sparse_array(level.to_scipy())
    wanted = np.empty(n, np.int64)
    for start, stop in zip(level.offsets[:-1], level.offsets[1:], strict=True):
        piece = nx.convert_node_labels_to_integers(network.subgraph(range(start, stop)), ordering="sorted")
        wanted[start:stop] = slow_mend(piece, measures[start:stop], labels[start:stop])
    found = mend_blocks(
        level.offsets, level.indptr, level.indices, level.interface, level.centroids,
        frozen_float(measures), labels, parts,
    )  # fmt: skip
    assert np.array_equal(found, wanted)
