"""Recursions made in place by one kernel: guarantees, thread counts, and shapes as good as depth by depth."""

from __future__ import annotations

from typing import Any

import networkx as nx
import numpy as np
import pytest
from growth_checks import assert_kept, grown, length, lumpy_graph
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, Mesh, OptionError, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.split import piece_growth
from agglo_core.split.piece_refinement import refine_sides
from agglo_core.split.piece_splits import (
    HEAVY,
    SAMPLED,
    PieceGraph,
    Pieces,
    Sides,
    cells_beside,
    is_connected,
    new_workspace,
    reach_of_cells,
    sides_connected,
    units_of,
)
from agglo_core.threads import thread_count, using_threads
from agglo_kmeans.kmeans import KMeans

SEEDS = st.integers(0, 10**6)
BISECTIONS = ("kmeans", {"curve": False})


class DepthByDepth:
    """2-means, which the driver asks for one depth after the other."""

    def bisect_level(self, level, seeds):
        return KMeans().bisect_level(level, seeds)


@settings(max_examples=25, deadline=None)
@given(st.integers(3, 90), st.sampled_from([2, 3]), SEEDS, st.booleans(), st.data())
def test_counts_are_exact_on_any_graph(
    n: int, dim: int, seed: int, refined: bool, data: st.DataObject
) -> None:
    graph = lumpy_graph(n, dim, seed)
    least = int(graph.components().max()) + 1
    parts = data.draw(st.lists(st.integers(least, n), min_size=1, max_size=3))
    hierarchy = grown(graph, refiners=("interface",) if refined else (), n_parts=parts)
    assert hierarchy.parts == sorted(parts, reverse=True)
    assert_kept(hierarchy)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(["voronoi", "random_triangles"]), st.integers(20, 400), SEEDS, st.data())
def test_no_part_is_wider_than_h_star(kind: str, n: int, seed: int, data: st.DataObject) -> None:
    mesh = getattr(samples, kind)(n, seed=seed)
    factors = data.draw(st.lists(st.floats(0.5, 6.0), min_size=1, max_size=3, unique=True))
    hierarchy = grown(mesh, h_factor=sorted(factors))
    assert_kept(hierarchy)
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        wide = mesh.graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
        assert (np.bincount(labels)[wide] == 1).all()
    widths = mesh.graph.part_diameters(np.arange(mesh.n_cells))
    finest = hierarchy.targets[0]["h_star"] * (1 + 1e-9)
    assert hierarchy.statistics["oversized_cells"] == (widths > finest).sum()


@pytest.mark.parametrize("mesh", [samples.boxes(5), samples.tetrahedra(4)], ids=lambda mesh: mesh.name)
def test_space(mesh: Mesh) -> None:
    hierarchy = grown(mesh, n_parts=(25, 5))
    assert hierarchy.parts == [25, 5]
    assert_kept(hierarchy)
    assert_kept(grown(mesh, h_factor=(2.0, 4.0)))


@pytest.mark.parametrize("smallest", [1e-3, 1e-7, 1e-11])
def test_layers_finer_than_single_precision(smallest: float) -> None:
    lines = np.concatenate(([0.0], np.geomspace(smallest, 1.0, 24)))
    points = np.stack(np.meshgrid(lines, lines, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (25 * np.arange(24)[:, None] + np.arange(24)).ravel()
    mesh = Mesh.from_polygons(points, np.stack((first, first + 25, first + 26, first + 1), axis=1))
    for refiners in (("interface",), ()):
        hierarchy = grown(mesh, cells_per_part=(6, 48), refiners=refiners)
        assert hierarchy.parts == [96, 12]
        assert_kept(hierarchy)
    assert_kept(grown(mesh, h_star=(0.01, 0.3)))


MESHES = {
    "triangles": lambda seed: samples.random_triangles(3000, seed=seed),
    "voronoi": lambda seed: samples.voronoi(5000, seed=seed),
    "tetrahedra": lambda seed: samples.tetrahedra(10),
}


@pytest.mark.parametrize("kind", MESHES)
def test_shapes_are_as_good_as_depth_by_depth(kind: str) -> None:
    """On pieces of more cells than are looked at one by one, too."""
    for target in ({"cells_per_part": 16}, {"h_factor": 4.0}):
        mesh = MESHES[kind](7)
        one, other = (
            agglo.agglomerate(mesh, bisector=each, **target) for each in (BISECTIONS, DepthByDepth())
        )
        cuts = [length(mesh.graph, each.levels[0]) for each in (one, other)]
        assert cuts[0] == pytest.approx(cuts[1], rel=0.03)
        assert one.parts[0] == pytest.approx(other.parts[0], rel=0.03)


def test_labels_do_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = samples.squares(210)
    found = []
    for count in (1, 2, 5):
        with using_threads(count):
            found.append(grown(mesh, cells_per_part=(20, 200)).levels)
    for levels in found[1:]:
        for labels, wanted in zip(levels, found[0], strict=True):
            assert np.array_equal(labels, wanted)
    monkeypatch.setenv("AGGLO_THREADS", "3")
    assert thread_count() == 3
    with using_threads(2):
        assert thread_count() == 2
    for wrong in ("0", "two", ""):
        monkeypatch.setenv("AGGLO_THREADS", wrong)
        with pytest.raises(OptionError, match="AGGLO_THREADS must be a whole number, 1 or more"):
            thread_count()
    with pytest.raises(OptionError, match="threads must be"), using_threads(0):
        pass


def test_progress_is_reported_for_large_meshes() -> None:
    told: list[float] = []
    agglo.agglomerate(
        samples.squares(280),
        bisector=BISECTIONS,
        cells_per_part=30,
        progress=lambda now: told.append(now.fraction) if now.phase == "agglomerating" else None,
    )
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert len(told) >= 3
    assert told == sorted(told)


def test_other_pipelines_grow_depth_by_depth() -> None:
    class Refiner(InterfaceRefiner):
        """Who knows what it does."""

    class Fixer(ConnectivityFixer):
        """Or this one."""

    def grows(**options: Any) -> bool:
        hierarchy = agglo.agglomerate(samples.voronoi(60, seed=1), cells_per_part=6, **options)
        return "grow" in hierarchy.statistics["seconds"]

    assert grows()
    assert grows(refiners=(("interface", {"floor": 0.5}),))
    assert not grows(refiners=(Refiner(),))
    assert not grows(refiners=("interface", "interface"))
    assert not grows(fixer=Fixer())


# --- the kernels, against obvious references --------------------------------------------------------------


def piece_graph(graph: Graph) -> PieceGraph:
    csr = graph.indptr, graph.indices, graph.interface
    return PieceGraph(*csr, graph.centroids, graph.measures, graph.weights, None, None)


def tagged(graph: Graph, sides: np.ndarray) -> np.ndarray:
    return np.where(sides, 2 * graph.n - 1, 0).astype(np.int32)


@settings(max_examples=25, deadline=None)
@given(st.integers(8, 150), SEEDS)
def test_refinement_shortens_the_interface_and_breaks_nothing(n: int, seed: int) -> None:
    mesh = samples.voronoi(n, seed=seed)
    graph, rng = mesh.graph, np.random.default_rng(seed)
    height = graph.centroids @ rng.standard_normal(2)
    sides = height + 0.1 * rng.standard_normal(n) > np.median(height)
    tag, workspace = tagged(graph, sides), new_workspace(n)
    boundary = workspace.boundary
    cells, left, right = np.arange(n, dtype=np.int32), 0, 2 * n - 1
    boundary[:n] = cells
    edge = cells_beside(graph.indptr, graph.indices, tag, left, right, boundary, n)
    dense = graph.to_scipy().toarray()
    beside = ((dense > 0) & (sides[:, None] != sides)).any(axis=1)
    assert np.array_equal(boundary[:edge], np.flatnonzero(beside))
    size = np.bincount(sides, graph.measures, minlength=2)
    floor = 0.85 * size.min()
    both = Sides(size, np.bincount(sides, minlength=2).astype(np.int64), np.ones(3))
    pieces, whole = Pieces(cells, tag, np.zeros((n, 4), np.int32)), piece_graph(graph)
    edge, stamp = refine_sides(whole, pieces, left, right, both, 0.85, edge, workspace, 1)
    after = tag == right
    network = nx.from_scipy_sparse_array(graph.to_scipy())

    def counts(mask: np.ndarray) -> list[int]:
        parts = (network.subgraph(np.flatnonzero(mask == side).tolist()) for side in (False, True))
        return [nx.number_connected_components(part) for part in parts]

    assert length(graph, after) <= length(graph, sides) * (1 + 1e-12)
    assert all(now <= before for now, before in zip(counts(after), counts(sides), strict=True))
    found = np.bincount(after, graph.measures, minlength=2)
    assert found.min() >= floor * (1 - 1e-12)
    np.testing.assert_allclose(size, found, rtol=1e-9)
    beside = ((dense > 0) & (after[:, None] != after)).any(axis=1)
    assert set(np.flatnonzero(beside)) <= set(boundary[:edge].tolist())
    assert sides_connected(whole, pieces, 0, n, edge, workspace, stamp) == (counts(after) == [1, 1])


@pytest.mark.parametrize("unit", [1.0, 2.0**-160, 2.0**160])
def test_reach_is_the_distance_of_the_furthest_neighbour(unit: float) -> None:
    graph = samples.voronoi(80, seed=3).graph
    reach = np.empty(graph.n, np.float32)
    reach_of_cells(graph.indptr, graph.indices, frozen_float(unit * graph.centroids), 1.0 / unit, reach)
    for cell in range(graph.n):
        near = graph.indices[graph.indptr[cell] : graph.indptr[cell + 1]]
        furthest = np.linalg.norm(graph.centroids[near] - graph.centroids[cell], axis=1).max()
        assert furthest <= reach[cell] <= 1.001 * furthest


def test_cells_that_stand_for_all_are_spread() -> None:
    graph = samples.random_triangles(3000, seed=7).graph
    length, weight, sample = units_of(graph.centroids, graph.weights)
    assert 0.5 <= length * np.ptp(graph.centroids, axis=0).max() < 1.0
    assert 0.5 <= weight * graph.weights.mean() < 1.0
    assert np.frexp([length, weight])[0].tolist() == [0.5, 0.5]  # powers of two
    chosen = sample.astype(bool)
    assert abs(chosen.mean() * SAMPLED - 1.0) < 0.2
    halves = [np.average(graph.centroids[cells], axis=0) for cells in (chosen, ~chosen)]
    np.testing.assert_allclose(halves[0], halves[1], atol=0.05)


def test_cells_of_equal_weight_cannot_stand_for_all() -> None:
    for weights in (np.full(4096, 0.3), np.repeat(np.linspace(1.0, 2.0, 16), 256)):
        points = frozen_float(np.random.default_rng(0).random((4096, 2)))
        assert len(units_of(points, frozen_float(weights))[2]) == 0


def test_heavy_cells_are_in_every_sample() -> None:
    weights = np.random.default_rng(1).uniform(0.9, 1.1, 4096)
    heavy = np.arange(0, 4096, 100)
    weights[heavy] += 5.0
    points = frozen_float(np.random.default_rng(0).random((4096, 2)))
    _, _, sample = units_of(points, frozen_float(weights))
    assert (weights[heavy] > HEAVY * weights.mean()).all()
    assert (sample[heavy] == 2).all()
    assert 0.08 < (sample > 0).mean() < 0.2


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), SEEDS)
def test_a_piece_is_connected_as_networkx_finds(n: int, seed: int) -> None:
    graph, rng = lumpy_graph(n, 2, seed), np.random.default_rng(seed)
    count = int(rng.integers(1, n + 1))
    cells = np.sort(rng.permutation(n)[:count]).astype(np.int32)
    tag = np.ones(n, np.int32)
    tag[cells] = 0
    pieces, queue = Pieces(cells, tag, np.zeros((n, 4), np.int32)), np.empty(count + 1, np.int32)
    found = is_connected(piece_graph(graph), pieces, 0, count, queue, 1)
    assert found == nx.is_connected(nx.from_scipy_sparse_array(graph.to_scipy()).subgraph(cells.tolist()))


def test_pieces_that_cuts_tore_are_mended() -> None:
    """A comb: most cuts go through its teeth."""
    teeth = np.array([(x, y) for x in range(0, 80, 2) for y in range(1, 20)])
    places = np.concatenate((np.stack((np.arange(80), np.zeros(80, int)), axis=1), teeth))
    corners = (places[:, None] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)])).reshape(-1, 2)
    points, loops = np.unique(corners, axis=0, return_inverse=True)
    mesh = Mesh.from_polygons(points.astype(float), loops.reshape(-1, 4))
    hierarchy = grown(mesh, bisector=BISECTIONS, n_parts=50)
    assert hierarchy.parts == [50]
    assert hierarchy.statistics["repairs"] > 20
    assert hierarchy.statistics["bisections"] == 49
    assert_kept(hierarchy)


def test_very_many_cells_are_split_a_share_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = samples.random_triangles(20_000, seed=4)
    at_once = agglo.agglomerate(mesh, bisector=BISECTIONS, n_parts=2500)
    monkeypatch.setattr(piece_growth, "_AT_ONCE", 30_000)
    in_shares = agglo.agglomerate(mesh, bisector=BISECTIONS, n_parts=2500)
    np.testing.assert_array_equal(at_once.levels[0], in_shares.levels[0])
    assert at_once.statistics["bisections"] == in_shares.statistics["bisections"] == 2499


def test_tiny_pieces_of_which_parts_broke_are_split_with_care() -> None:
    mended = 0
    for seed in range(20):
        graph = lumpy_graph(300, 2, seed)
        pieces = frozen_int(graph.components())
        quotas = frozen_int(np.maximum(np.bincount(pieces) // 6, 1))
        growth = KMeans().grow(graph, pieces, [InterfaceRefiner()], ConnectivityFixer())
        labels, depths = growth.split(quotas, np.zeros(len(quotas), np.uint64), lambda *_: None)
        network = nx.from_scipy_sparse_array(graph.to_scipy())
        parts = [np.flatnonzero(labels == p) for p in range(quotas.sum())]
        assert all(nx.is_connected(network.subgraph(cells.tolist())) for cells in parts)
        assert [cells[0] for cells in parts] == sorted(cells[0] for cells in parts)
        assert depths[:, 0].sum() == quotas.sum() - len(quotas)  # what was taken back is not counted
        mended += depths[:, 2].sum()
    assert mended > 0
