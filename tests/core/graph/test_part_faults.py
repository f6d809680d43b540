"""Parts that are broken or too wide; points renumbered; growth that goes on from other pieces."""

from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import samples
from agglo_core.arrays import frozen_index, frozen_int
from agglo_core.compiled import part_faults
from agglo_core.compiled.graphs import list_blocks, number_as_met
from agglo_core.errors import MeshError
from agglo_core.graph.connection import broken_parts
from agglo_core.refine.compactness.reach import cell_radii

SEEDS = st.integers(0, 2**32 - 1)


def scattered(seed: int, solid: bool = False):
    """A graph, and parts of it of which many are broken."""
    rng = np.random.default_rng(seed)
    graph = (samples.tetrahedra(2) if solid else samples.random_triangles(60, seed=seed % 7)).graph
    return rng, graph, np.unique(rng.integers(0, 1 + graph.n // 3, graph.n), return_inverse=True)[1]


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.integers(1, 3))
def test_broken_parts(seed: int, threads: int) -> None:
    rng, graph, labels = scattered(seed)
    asked = rng.random(labels.max() + 1) < 0.7
    network = nx.from_scipy_sparse_array(graph.to_scipy())
    parts = [network.subgraph(np.flatnonzero(labels == p).tolist()) for p in range(len(asked))]
    expected = [bool(a) and not nx.is_connected(part) for a, part in zip(asked, parts, strict=True)]
    with agglo.using_threads(threads, few=10):
        assert broken_parts(graph.indptr, graph.indices, labels, asked).tolist() == expected


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.booleans(), st.integers(1, 3))
def test_wide_parts(seed: int, solid: bool, threads: int) -> None:
    rng, graph, labels = scattered(seed, solid)
    asked = rng.random(labels.max() + 1) < 0.7
    widths = graph.part_diameters(labels)
    for limit in (0.4, 1.0, widths[0], 2.0):  # one of them is exactly that of a part
        with agglo.using_threads(threads, few=10):
            assert graph.wide_parts(labels, limit).tolist() == (widths > limit).tolist()
            found = graph.wide_parts(labels, limit, asked)
        assert found.tolist() == (asked & (widths > limit)).tolist()


@pytest.mark.parametrize("solid", [False, True])
def test_cell_radii(solid: bool) -> None:
    graph = scattered(3, solid)[1]
    shape = graph.vertex_offsets, graph.vertices, graph.points
    corners = [graph.points[graph.vertices[a:b]] for a, b in pairwise(graph.vertex_offsets)]
    own = zip(corners, graph.centroids, strict=True)
    expected = [np.linalg.norm(points - centre, axis=1).max() for points, centre in own]
    np.testing.assert_allclose(cell_radii(*shape, graph.centroids), expected, rtol=1e-14)


@pytest.mark.parametrize("count", [5, 40, 300])
def test_wide_parts_with_all_vertices_on_a_circle(count: int) -> None:
    angle = 2 * np.pi * np.arange(count) / count
    beside = np.stack((np.arange(count) - 1, np.arange(count) + 1), axis=1) % count
    centroids = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    graph = agglo.Graph.from_arrays(2 * np.arange(count + 1), beside.ravel(), centroids)
    width = graph.part_diameters(np.zeros(count, np.int64))[0]
    for limit, wide in ((width, False), (width * (1 - 1e-15), True), (0.97 * width, True), (2.1, False)):
        assert graph.wide_parts(np.zeros(count, np.int64), limit).tolist() == [wide]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 9), max_size=30), st.lists(st.integers(0, 9), unique=True))
def test_listed_blocks(labels: list[int], chosen: list[int]) -> None:
    cells, offsets = list_blocks(frozen_int(labels), frozen_int(chosen), 10)
    found = [cells[a:b].tolist() for a, b in pairwise(offsets)]
    assert found == [[i for i, label in enumerate(labels) if label == b] for b in chosen]


def test_wide_parts_refuses_labels_out_of_range() -> None:
    graph = samples.squares(2).graph
    with pytest.raises(MeshError, match=r"labels must be \(4,\) integers in 0\.\.1"):
        graph.wide_parts([0, 1, 2, 0], 1.0, np.ones(2, bool))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 9), max_size=30))
def test_numbered_as_met(values: list[int]) -> None:
    renumbered, order = number_as_met(frozen_index(values), 10)
    assert order.tolist() == list(dict.fromkeys(values))
    assert order[renumbered].tolist() == values


def spider(legs: int) -> tuple[np.ndarray, np.ndarray]:
    """CSR of legs of two nodes around a hub: ends come first, the hub last, so that ends are far apart."""
    ends = np.arange(legs)
    rows = np.concatenate((ends, ends + legs, ends + legs, np.full(legs, 2 * legs)))
    columns = np.concatenate((ends + legs, ends, np.full(legs, 2 * legs), ends + legs))
    order = np.lexsort((columns, rows))
    return frozen_int(np.searchsorted(rows[order], np.arange(2 * legs + 2))), frozen_index(columns[order])


@pytest.mark.parametrize("cut", [False, True])
def test_connections_that_are_far_to_seek_are_found_by_flooding(cut: bool) -> None:
    legs = 400
    indptr, indices = spider(legs)
    labels = np.zeros(2 * legs + 1, np.int64)
    if cut:  # the hub and the ends on their own: as many components as there are legs
        labels[2 * legs] = 1
    asked = np.ones(labels.max() + 1, bool)
    assert broken_parts(indptr, indices, labels, asked).tolist() == ([True, False] if cut else [False])
    assert not broken_parts(indptr, indices, labels, ~asked).any()


def test_connections_around_a_hub_cost_no_more_than_a_few_passes() -> None:
    """The searches end once they have read as many edges as there are."""
    legs = 50
    indptr, indices = spider(legs)
    marks, queue = np.zeros(2 * legs + 1, np.int32), np.empty(2 * legs + 2, np.int32)
    left, searches = len(indices), 0
    while left >= 0:
        met, left = part_faults._meets_earlier(
            1 + searches, indptr, indices, np.zeros(2 * legs + 1, np.int64), marks, queue, left
        )
        searches += 1
    assert searches <= 4
    assert not met
