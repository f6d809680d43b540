"""Merging against its rounds written out in numpy: every part proposes, mutual proposals merge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist

import agglo_core as agglo
from agglo_core import Graph, Mesh, samples
from agglo_core.agglomeration.levels.polishing import merge_parts


def _silent(done: float, text: str) -> None:
    pass


def slow_merge(graph: Graph, blocks: np.ndarray, labels: np.ndarray, limit: float) -> list[set[int]]:
    """The parts as sets of cells."""
    parts = [set(np.flatnonzero(labels == p).tolist()) for p in range(labels.max() + 1)]
    dense = graph.to_scipy().toarray()
    corners = np.split(graph.vertices, graph.vertex_offsets[1:-1])
    outlines = graph.boundary + dense.sum(axis=1)

    def score(p: set[int], q: set[int]) -> float:
        one, two = sorted(p), sorted(q)
        shared = dense[np.ix_(one, two)].sum()
        used = np.unique(np.concatenate([corners[c] for c in one + two]))
        if shared == 0 or blocks[one[0]] != blocks[two[0]] or pdist(graph.points[used]).max() > limit:
            return 0.0
        inner = dense[np.ix_(one, one)].sum() + dense[np.ix_(two, two)].sum()
        return float(shared / (outlines[one + two].sum() - inner))

    while True:
        best = [max((score(p, q), j) for j, q in enumerate(parts) if q is not p) for p in parts]
        pairs = [(i, j) for i, (value, j) in enumerate(best) if value > 0 and best[j][1] == i and i < j]
        if not pairs:
            return parts
        gone = {j for _, j in pairs}
        for i, j in pairs:
            parts[i] = parts[i] | parts[j]
        parts = [p for i, p in enumerate(parts) if i not in gone]


@pytest.mark.parametrize("seed", range(3))
def test_parts_merge_as_in_rounds(seed: int) -> None:
    mesh = samples.voronoi(60, seed=seed)
    graph = mesh.graph
    rng = np.random.default_rng(seed)
    blocks = graph.components((graph.centroids[:, 0] > 0.1 * rng.random()).astype(int))
    labels, limit = np.arange(graph.n), (1.6 + rng.random()) * mesh.h
    found = merge_parts(graph, blocks, labels, limit, _silent)
    sets = {frozenset(np.flatnonzero(found == part).tolist()) for part in range(found.max() + 1)}
    assert sets == set(map(frozenset, slow_merge(graph, blocks, labels, limit)))


def test_nothing_is_left_to_merge_in_space() -> None:
    mesh = samples.tetrahedra(3)
    graph, limit = mesh.graph, 1.5 * mesh.h
    blocks = np.zeros(graph.n, int)
    found = merge_parts(graph, blocks, np.arange(graph.n), limit, _silent)
    assert graph.part_diameters(found).max() <= limit
    assert graph.components(found).max() == found.max()
    np.testing.assert_array_equal(merge_parts(graph, blocks, found, limit, _silent), found)


def test_a_chain_merges_in_pairs() -> None:
    n = 3001  # every part prefers the narrower neighbour: rounds merge one pair each, at the narrow end
    x = np.concatenate(([0.0], np.cumsum(np.linspace(1.1, 1.0, n))))
    points = np.concatenate((np.stack((x, 0 * x), axis=1), np.stack((x, 0 * x + 1), axis=1)))
    i = np.arange(n)
    graph = Mesh.from_polygons(points, np.stack((i, i + 1, n + 2 + i, n + 1 + i), axis=1)).graph
    found = merge_parts(graph, np.zeros(n, int), i, 2.5, _silent)
    np.testing.assert_array_equal(found, (i + 1) // 2)


def test_a_cell_of_many_neighbours_takes_them_all() -> None:
    n = 300
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    ring = np.stack((i, n + i, n + j, j), axis=1)
    mesh = Mesh.from_polygons(np.concatenate((circle, 1.1 * circle)), [i, *ring])
    blocks = np.zeros(mesh.n_cells, int)
    assert merge_parts(mesh.graph, blocks, np.arange(mesh.n_cells), 2.3, _silent).max() == 0
    some = merge_parts(mesh.graph, blocks, np.arange(mesh.n_cells), 2.05, _silent)
    assert mesh.coarsen(some).h <= 2.05
    assert agglo.quality(mesh, some, metrics=("components",))["components"].max() == 1
