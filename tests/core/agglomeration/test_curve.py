"""Runs of the curve against a slow twin, what levels from them promise, and when bisections replace them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, OptionError, samples
from agglo_core.agglomeration.levels.curve import connected_runs
from agglo_core.agglomeration.levels.curve_kernels import stretched_cells
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.compiled.graphs import list_blocks
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.graph.ordering import curve_order
from agglo_core.threads import using_threads

SEEDS = st.integers(0, 10**6)


def along_curve(graph: Graph) -> Graph:
    return graph.subgraph(curve_order(graph.centroids), [0, graph.n])


@cache
def graphs() -> list[Graph]:
    return [along_curve(samples.voronoi(80, seed=3).graph), along_curve(samples.tetrahedra(2).graph)]


def slow_runs(
    graph: Graph, mass: np.ndarray, cells: list[int], k: int, first: int, labels: np.ndarray
) -> None:
    """Label the cells of one block: runs, largest components, and strays one after the other."""
    network = nx.Graph()
    network.add_nodes_from(range(graph.n))
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    for i, j, length in zip(rows.tolist(), graph.indices.tolist(), graph.interface.tolist(), strict=True):
        network.add_edge(i, j, length=length)
    # 1. Runs of equal mass, each with a cell.
    total, below, part, strays = sum(mass[cells]), 0.0, 0, []
    runs: list[list[int]] = [[]]
    for place, i in enumerate(cells):
        middle = (below + mass[i] / 2) / total if total else (place + 0.5) / len(cells)
        below += mass[i]
        if max(int(middle * k), k - (len(cells) - place)) > part and runs[-1]:
            part += 1
            runs.append([])
        runs[-1].append(i)
    # 2. The largest component of each, the first of equal ones.
    for p, run in enumerate(runs):
        components = sorted(nx.connected_components(network.subgraph(run)), key=lambda c: (-len(c), min(c)))
        labels[list(components[0])] = first + p
        strays += [i for i in run if i not in components[0]]
    # 3. Strays join the part with most interface per cell.
    while strays:
        left = []
        for i in strays:
            beside = [j for j in network[i] if first <= labels[j] < first + k]
            if not beside:
                left.append(i)
                continue
            sizes = np.bincount(labels[labels >= 0])
            best = max(beside, key=lambda j: (network[i][j]["length"] / sizes[labels[j]], -labels[j]))
            labels[i] = labels[best]
        strays = left


@settings(max_examples=40, deadline=None)
@given(
    st.deferred(lambda: st.sampled_from(graphs())),
    SEEDS,
    st.integers(1, 20),
    st.sampled_from(["cells", "masses", "none"]),
    st.sampled_from([1, 2]),
)
def test_runs_are_those_of_the_twin(graph: Graph, seed: int, k: int, masses: str, threads: int) -> None:
    rng = np.random.default_rng(seed)
    mass = {"cells": np.ones(graph.n), "masses": rng.random(graph.n) ** 6, "none": np.zeros(graph.n)}[masses]
    blocks = graph.components(graph.centroids[:, 0] > 0.5)
    count = int(blocks.max()) + 1
    quotas = frozen_int(np.minimum(rng.integers(1, k + 1, count), np.bincount(blocks)))
    cells, offsets = list_blocks(blocks, frozen_int(np.arange(count)), count)
    with using_threads(threads, few=1):
        found = connected_runs(graph, frozen_float(mass), cells, offsets, quotas)
    wanted, first = np.full(graph.n, -1), 0
    for b in range(count):
        slow_runs(graph, mass, cells[offsets[b] : offsets[b + 1]].tolist(), int(quotas[b]), first, wanted)
        first += int(quotas[b])
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(np.unique(found), np.arange(first))
    assert graph.components(frozen_int(found)).max() + 1 == first


def test_stretched_cells_are_counted() -> None:
    graph = samples.squares(6).graph
    assert stretched_cells(graph.indptr, graph.indices, graph.centroids, graph.measures, 1) == 0
    long = frozen_float(graph.centroids * [11.0, 1.0 / 11.0])  # distances of 11 cell widths
    assert stretched_cells(graph.indptr, graph.indices, long, graph.measures, 1) == 36
    assert stretched_cells(graph.indptr, graph.indices, long, graph.measures, 5) == 8  # cells 0, 5, … 35


FAMILIES = {
    "triangles": lambda seed: samples.random_triangles(700, seed=seed),
    "voronoi": lambda seed: samples.voronoi(1300, seed=seed),
    "tetrahedra": lambda seed: samples.random_tetrahedra(1200, seed=seed),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_levels_from_the_curve_keep_all_promises(family: str) -> None:
    mesh = FAMILIES[family](104)
    graph = mesh.graph
    counts = (mesh.n_cells // 9, 6**mesh.dim)
    hierarchy = agglo.agglomerate(mesh, n_parts=counts)
    assert hierarchy.statistics["curve_levels"] == 1
    assert hierarchy.parts == list(counts)
    for labels in hierarchy.levels:
        assert graph.components(labels).max() + 1 == labels.max() + 1
    fine, coarse = hierarchy.levels
    assert len(np.unique(np.stack((fine, coarse)), axis=1).T) == counts[0]
    # The same parts in two threads, for cells numbered otherwise, and for a moved mesh.
    with agglo.using_threads(2, few=1):
        np.testing.assert_array_equal(agglo.agglomerate(mesh, n_parts=counts).levels, hierarchy.levels)
    rng = np.random.default_rng(1)
    order = rng.permutation(graph.n)
    scattered = agglo.agglomerate(graph.subgraph(order, [0, graph.n]), n_parts=counts).levels
    for labels, other in zip(hierarchy.levels, scattered, strict=True):
        assert same_parts(labels[order], other)
    turn = np.linalg.qr(rng.normal(size=(mesh.dim, mesh.dim)))[0]
    turn[0] *= np.linalg.det(turn)
    moved = agglo.agglomerate(replace(mesh, points=mesh.points @ turn.T + 4.0), n_parts=counts).levels
    for labels, other in zip(hierarchy.levels, moved, strict=True):
        assert same_parts(labels, other)


def same_parts(one: np.ndarray, other: np.ndarray) -> bool:
    return len(np.unique(np.stack((one, other)), axis=1).T) == one.max() + 1 == other.max() + 1


def test_counts_follow_weights_and_stay_even_for_any_count() -> None:
    mesh = samples.voronoi(1600, seed=5)
    for k in (97, 100, 128, 150):
        sizes = np.bincount(agglo.agglomerate(mesh, n_parts=k).levels[0])
        assert sizes.max() <= 2.2 * sizes.mean()
        assert sizes.std() <= 0.3 * sizes.mean()
    weights = 1.0 + 4.0 * (mesh.graph.centroids[:, 0] > 0.5)
    hierarchy = agglo.agglomerate(mesh, n_parts=80, weights=weights)
    assert hierarchy.statistics["curve_levels"] == 1
    loads = np.bincount(hierarchy.levels[0], weights)
    assert loads.std() <= 0.35 * loads.mean()


def test_rules_hold_for_levels_from_the_curve() -> None:
    mesh = samples.voronoi(1600, seed=6)
    regions = (mesh.graph.centroids[:, 1] > 0.4).astype(int)
    hierarchy = agglo.agglomerate(mesh, n_parts=100, regions=regions, max_cells=24)
    assert hierarchy.statistics["curve_levels"] == 1
    labels = hierarchy.levels[0]
    assert all(len(np.unique(regions[labels == p])) == 1 for p in range(labels.max() + 1))
    assert np.bincount(labels).max() <= 24


def test_polished_runs_are_about_as_good_as_polished_bisections() -> None:
    """Mean over six meshes: objective at most 4 % larger, mean circle ratio at most 3 % smaller."""
    ratios = []
    for make in (FAMILIES["triangles"], FAMILIES["voronoi"]):
        for s in range(3):
            mesh = make(s)
            values = []
            for curve in (True, False):
                labels = agglo.agglomerate(
                    mesh, cells_per_part=16, bisector=("kmeans", {"curve": curve})
                ).levels[0]
                ratio = agglo.quality(mesh, labels, metrics=("CR",))["CR"].mean()
                values.append((OBJECTIVES["shape"].value(mesh.graph, labels), ratio))
            ratios.append(np.divide(*values))
    objective, circle_ratio = np.mean(ratios, axis=0)
    assert objective < 1.04
    assert circle_ratio > 0.97


@pytest.mark.parametrize(
    ("width", "how"),
    [
        (1.0, {"h_factor": 4.0}),
        (1.0, {"n_parts": 20}),  # too few
        (1.0, {"n_parts": 400}),  # too small
        (20.0, {"n_parts": 100}),
        (1.0, {"n_parts": 100, "polish": False}),
        (1.0, {"n_parts": 100, "refiners": ()}),
        (1.0, {"n_parts": 100, "post_refiners": ("balance",)}),
        (1.0, {"n_parts": 100, "bisector": "inertial"}),
        (1.0, {"n_parts": 100, "bisector": ("kmeans", {"curve": False})}),
    ],
)
def test_bisections_where_the_curve_is_worse_or_not_wanted(width: float, how: dict[str, object]) -> None:
    mesh = samples.voronoi(1600, seed=2)
    mesh = replace(mesh, points=mesh.points * [width, 1.0])
    assert agglo.agglomerate(mesh, **how).statistics["curve_levels"] == 0


def test_the_choice_of_the_curve_is_true_or_false() -> None:
    with pytest.raises(OptionError, match=r"curve of bisector .* must be true or false, given 1"):
        agglo.agglomerate(samples.squares(4), n_parts=4, bisector=("kmeans", {"curve": 1}))
