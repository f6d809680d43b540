"""Valid but unusual graphs, and graphs of many small blocks with ragged parts, for testing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from agglo_core import samples
from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.inputs import small_meshes
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_SMALL = (1, 2, 3, 4, 5, 7, 8, 9, 16, 60)
"""Block sizes of a crowd, in cyclic order."""
_LARGE = 2000
"""Size of the large block in the middle of a crowd."""


def fresh(graph: Graph) -> Graph:
    """Return a copy of a graph, so that a component cannot corrupt the cached original."""
    values = {f.name: getattr(graph, f.name) for f in fields(graph)}
    arrays = {name: value.copy() for name, value in values.items() if isinstance(value, np.ndarray)}
    return replace(graph, **arrays, data={name: value.copy() for name, value in graph.data.items()})


@cache
def crowd(blocks: int, smallest: int) -> Graph:
    """Return a graph of many small blocks and a block of 2,000 cells, with shuffled cells in each block."""
    sizes = np.resize([size for size in _SMALL if size >= smallest], blocks)
    sizes[blocks // 2] = _LARGE
    rows = -(-int(sizes.sum()) // 48) // 2 * 2 + 1  # odd, so that each strip ends where the next begins
    # Number the cells along a path of strips, alternately down and up, so that consecutive cells are
    # adjacent.
    mesh = small_meshes.grid(48, rows, jitter=0.2)
    row, column = np.divmod(np.arange(mesh.n_cells), 48)
    strip, across = np.divmod(column, 3)
    level_row = np.where(strip % 2, rows - 1 - row, row)  # boustrophedon
    way = np.lexsort((np.where(level_row % 2, -across, across), level_row, strip))[: sizes.sum()]
    # Cut the path into blocks, and shuffle the cells of each block.
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    shuffled = np.lexsort((np.random.default_rng(4).random(len(way)), np.repeat(np.arange(blocks), sizes)))
    graph: Graph = mesh.graph.subgraph(way[shuffled], offsets)
    return graph


@cache
def small_blocks() -> Graph:
    """Return a graph of 5,000 blocks: a chain of 60 cells, and chains of 2 or 3 cells."""
    sizes = np.where(np.arange(5000) % 2, 2, 3)
    sizes[0] = 60
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    graph: Graph = small_meshes.line(int(offsets[-1])).subgraph(np.arange(offsets[-1]), offsets)
    return graph


@cache
def large() -> Graph:
    """Return a graph of 2,000 cells in one block."""
    graph: Graph = small_meshes.grid(50, 40, jitter=0.2).graph
    return graph


@cache
def tower() -> Graph:
    """Return the graph of a column of eight boxes, whose centroids differ only in the third coordinate."""
    graph: Graph = small_meshes.boxes(1, 1, 8).graph
    return graph


@cache
def level_in_space() -> Graph:
    """Return a graph of boxes in three blocks, which are separated along the first axis."""
    graph: Graph = small_meshes.boxes(6, 4, 3).graph
    rank = np.argsort(np.argsort(graph.centroids[:, 0], kind="stable"))
    return graph.split(rank // 24)[0]


def clumps(graph: Graph, parts: int, strays: float = 0.0) -> Int:
    """Label each cell by the nearest of ``parts`` random cells, but a fraction ``strays`` at random.

    Every label occurs.
    """
    rng = np.random.default_rng(graph.n + parts)
    seeds = rng.choice(graph.n, parts, replace=False)
    centroids = graph.centroids / np.ptp(graph.centroids, axis=0).max()
    squares = ((centroids[:, None] - centroids[seeds][None]) ** 2).sum(axis=2)
    labels = squares.argmin(axis=1)
    labels = np.where(rng.random(graph.n) < strays, rng.integers(parts, size=graph.n), labels)
    labels[seeds] = np.arange(parts)
    return frozen_int(labels)


def map_points(mesh: Mesh, move: Callable[[Float], Float]) -> Mesh:
    """Return a mesh with its points ``(p, 2)`` transformed by a function."""
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    return Mesh.from_polygons(move(mesh.points), cells, name=mesh.name)


_PIECE = 30  # cells per piece
_RAGGED = 1.5  # standard deviation of the log travel time between adjacent cells
_NOISE = 0.2  # fraction of border cells in every other block that get a neighbour's label


def ragged_level_in_space() -> tuple[Graph, Int]:
    """Return a graph of many blocks of tetrahedra, with labels of 2 to 5 ragged parts in each block."""
    return _fresh_level(_tetrahedra)


def grow_regions(graph: Graph, seeds: Int, rng: np.random.Generator) -> Int:
    """Grow a region from each seed at random speeds, and return the region index of each node ``(n,)``.

    Each node belongs to the seed that reaches it first (first-passage growth). The regions are ragged but
    connected. Every block needs a seed.
    """
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    times = rng.lognormal(0.0, _RAGGED, len(rows))
    links = sparse.csr_array((times, graph.indices, graph.indptr), shape=(graph.n, graph.n))
    first: Int = dijkstra(links, indices=seeds, min_only=True, return_predecessors=True)[2]
    return frozen_int(np.searchsorted(seeds, first))


def _fresh_level(make: Callable[[], Mesh]) -> tuple[Graph, Int]:
    level, labels = _level_of(make)
    return fresh(level), frozen_int(labels.copy())


@cache
def _level_of(make: Callable[[], Mesh]) -> tuple[Graph, Int]:
    """Split a mesh into randomly grown blocks, and each block into parts, some with noise."""
    rng = np.random.default_rng(11)
    graph: Graph = make().graph
    # Grow pieces from random cells of the mesh, which become the blocks.
    pieces = np.sort(rng.choice(graph.n, graph.n // _PIECE, replace=False))
    level = graph.split(grow_regions(graph, frozen_int(pieces), rng))[0]
    # Draw 2 to 5 seed cells in each block and grow parts from them.
    parts = np.minimum(2 + np.arange(level.n_blocks) % 4, level.sizes)
    order = np.lexsort((rng.random(level.n), level.block_ids))
    place = np.arange(level.n) - level.offsets[level.block_ids]
    seeds = np.sort(order[place < parts[level.block_ids]])
    part = grow_regions(level, frozen_int(seeds), rng)
    # Number the parts of each block from 0, then add noise.
    first = np.concatenate(([0], np.cumsum(parts)[:-1]))
    labels = part - first[level.block_ids]
    return level, _noisy(level, labels, seeds, rng)


def _noisy(level: Graph, labels: Int, seeds: Int, rng: np.random.Generator) -> Int:
    """Give some cells of every other block the label of a neighbour.

    ``seeds`` keep theirs.
    """
    new_labels = labels.copy()
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    noise = (rng.random(len(rows)) < _NOISE) & (level.block_ids[rows] % 2 == 1)
    new_labels[rows[noise]] = labels[level.indices[noise]]
    new_labels[seeds] = labels[seeds]
    return frozen_int(new_labels)


def _tetrahedra() -> Mesh:
    return samples.tetrahedra(5)
