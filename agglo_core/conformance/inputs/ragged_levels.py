"""Levels of many small pieces of real meshes with ragged parts: they show what squares and stripes do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from agglo_core import samples
from agglo_core.arrays import Int, frozen_int
from agglo_core.conformance.inputs.unusual_graphs import fresh
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_PIECE = 30  # cells
_RAGGED = 1.5  # standard deviation of the logarithm of the time in which a cell takes its neighbour
_NOISE = 0.2  # share of the border cells of every other block that take the label of a neighbour


def ragged() -> dict[str, tuple[Graph, Int]]:
    """Levels in the plane and labels of 2 to 5 ragged parts in each block, by the name of the mesh."""
    meshes = {"Voronoi cells": _voronoi, "triangles": _triangles, "hexagons": _hexagons}
    found = {f"a level of pieces of {name}": _afresh(make) for name, make in meshes.items()}
    uneven = {f"{name} with uneven weights and faces": _uneven(*each) for name, each in found.items()}
    return found | uneven


def ragged_in_space() -> tuple[Graph, Int]:
    """The same of tetrahedra."""
    return _afresh(_tetrahedra)


def grown(graph: Graph, seeds: Int, rng: np.random.Generator) -> Int:
    """Which of the nodes ``seeds`` reaches each node first ``(n,)``, at random speeds: ragged, but connected.

    Every block needs a seed.
    """
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    times = rng.lognormal(0.0, _RAGGED, len(rows))
    links = sparse.csr_array((times, graph.indices, graph.indptr), shape=(graph.n, graph.n))
    first: Int = dijkstra(links, indices=seeds, min_only=True, return_predecessors=True)[2]
    return frozen_int(np.searchsorted(seeds, first))


def _uneven(level: Graph, labels: Int) -> tuple[Graph, Int]:
    """The same with weights unlike the measures and faces of any size, so that much hangs on short ones."""
    rng = np.random.default_rng(5)
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    edges = np.minimum(rows, level.indices) * level.n + np.maximum(rows, level.indices)
    edge = np.unique(edges, return_inverse=True)[1]
    interface = 10.0 ** rng.uniform(-1, 1, len(rows))[edge]
    weights = 10.0 ** rng.uniform(-1, 1, level.n)
    return fresh(replace(level, weights=weights, interface=interface)), labels


def _afresh(make: Callable[[], Mesh]) -> tuple[Graph, Int]:
    level, labels = _level_of(make)
    return fresh(level), frozen_int(labels.copy())


@cache
def _level_of(make: Callable[[], Mesh]) -> tuple[Graph, Int]:
    """Pieces of a mesh that have grown at random, and labels that have grown in them, some with noise."""
    rng = np.random.default_rng(11)
    graph: Graph = make().graph
    pieces = np.sort(rng.choice(graph.n, graph.n // _PIECE, replace=False))
    level = graph.split(grown(graph, frozen_int(pieces), rng))[0]
    parts = np.minimum(2 + np.arange(level.n_blocks) % 4, level.sizes)
    order = np.lexsort((rng.random(level.n), level.block_ids))
    place = np.arange(level.n) - level.offsets[level.block_ids]
    seeds = np.sort(order[place < parts[level.block_ids]])
    part = grown(level, frozen_int(seeds), rng)
    first = np.concatenate(([0], np.cumsum(parts)[:-1]))
    labels = part - first[level.block_ids]
    return level, _noisy(level, labels, seeds, rng)


def _noisy(level: Graph, labels: Int, seeds: Int, rng: np.random.Generator) -> Int:
    """Some cells of every other block take the label of a neighbour; ``seeds`` keep theirs."""
    taken = labels.copy()
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    chosen = (rng.random(len(rows)) < _NOISE) & (level.block_ids[rows] % 2 == 1)
    taken[rows[chosen]] = labels[level.indices[chosen]]
    taken[seeds] = labels[seeds]
    return frozen_int(taken)


def _voronoi() -> Mesh:
    return samples.voronoi(2400, 3)


def _triangles() -> Mesh:
    return samples.random_triangles(500, 3)


def _hexagons() -> Mesh:
    return samples.hexagons(30)


def _tetrahedra() -> Mesh:
    return samples.tetrahedra(5)
