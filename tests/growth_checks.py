"""Checks for parts grown by a bisector, and graphs for these checks."""

from __future__ import annotations

from typing import Any

import networkx as nx
import numpy as np

import agglo_core as agglo
from agglo_core import Graph, Mesh
from agglo_core.arrays import frozen_int
from agglo_core.graph import functionals

__all__ = ["assert_kept", "grown", "length", "lumpy_graph"]


def grown(given: Mesh | Graph, **options: Any) -> agglo.Hierarchy:
    hierarchy = agglo.agglomerate(given, **options)
    assert "grow" in hierarchy.statistics["seconds"]
    return hierarchy


def length(graph: Graph, labels) -> float:
    """Return the total interface measure between parts."""
    return functionals.cut(graph, frozen_int(labels), edge_weights=graph.interface)


def assert_kept(hierarchy: agglo.Hierarchy) -> None:
    """Require that every part is connected and that levels are nested."""
    network = nx.from_scipy_sparse_array(hierarchy.graph.to_scipy())
    for labels, count in zip(hierarchy.levels, hierarchy.parts, strict=True):
        assert np.array_equal(np.unique(labels), np.arange(count))
        for part in range(count):
            assert nx.is_connected(network.subgraph(np.flatnonzero(labels == part).tolist()))
    for level in range(len(hierarchy.levels) - 1):
        assert np.array_equal(hierarchy.parents(level)[hierarchy.levels[level]], hierarchy.levels[level + 1])


def lumpy_graph(n: int, dim: int, seed: int) -> Graph:
    """Return a graph with a few connected pieces, many equal coordinates, and some zero weights."""
    rng = np.random.default_rng(seed)
    network = nx.Graph()
    network.add_nodes_from(range(n))
    for nodes in np.array_split(rng.permutation(n), rng.integers(1, 4)):
        for place in range(1, len(nodes)):
            for other in nodes[rng.integers(max(0, place - 6), place, 2)]:
                network.add_edge(int(nodes[place]), int(other), weight=float(rng.random()))
    matrix = nx.to_scipy_sparse_array(network, nodelist=range(n), format="csr")
    return Graph.from_arrays(
        matrix.indptr,
        matrix.indices,
        rng.integers(0, rng.integers(1, 9), (n, dim)) + 1e-9 * rng.random((n, dim)),
        interface=matrix.data,
        measures=rng.integers(0, rng.integers(1, 4), n),
        weights=rng.integers(0, rng.integers(1, 4), n),
    )
