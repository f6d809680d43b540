"""Compute the changes of objectives for many alternative moves of single cells to other parts.

Each function takes a graph, labels ``(n,)`` that number the parts of all blocks consecutively, and moves:
cell ``cells[i]`` alone goes to part ``parts[i]``. It returns the change of the sum over all parts, ``(q,)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Float, Int, Mask
from agglo_core.graph.dual import Graph
from agglo_core.graph.functionals import ratio

SHORTNESS = 0.3
"""Exponent of L, the interface length, in the objective ``shape``, J · L^0.3.

The polish (the refiner ``compactness``) lowers the objective with this exponent; docs/reference/shapes.md
compares other values, measured by tests/benchmarks/polish.py.
"""


@dataclass(frozen=True)
class Links:
    """Edge weights of each moved cell ``(q,)``: to all cells, to its old part, to its new part."""

    total: Float
    own: Float
    there: Float


def part_sums(labels: Int, values: Float | Int | Mask, k: int = 0) -> Float:
    """Sum ``values (n,)`` over the nodes of each part, for labels 0..k−1 or more."""
    return np.bincount(labels, values, k).astype(np.float64)


def mass_centres(graph: Graph, labels: Int, k: int = 0) -> tuple[Float, Float]:
    """Return the total weight ``(k,)`` and the centre of mass ``(k, d)`` of each part."""
    mass = part_sums(labels, graph.weights, k)
    moments = [part_sums(labels, graph.weights * x, k) for x in graph.centroids.T]
    return mass, np.stack([ratio(moment, mass) for moment in moments], axis=1)


def links(graph: Graph, labels: Int, cells: Int, parts: Int, edge_weights: Float | None = None) -> Links:
    """Return the edge weights that connect each moved cell with its old part and its new part.

    ``edge_weights`` is ``(m,)``, one per CSR entry, 1 by default.
    """
    move, entry = _entries(graph, cells)
    weights = np.ones(len(entry)) if edge_weights is None else edge_weights[entry]
    neighbour_parts = labels[graph.indices[entry]]
    q = len(cells)
    return Links(
        part_sums(move, weights, q),
        part_sums(move, weights * (neighbour_parts == labels[cells][move]), q),
        part_sums(move, weights * (neighbour_parts == parts[move]), q),
    )


def boundary_moves(graph: Graph, labels: Int) -> tuple[Int, Int]:
    """List all moves of a cell to an adjacent part, each once, as cells and parts ``(q,)``."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    neighbour_parts = labels[graph.indices]
    crossing = np.flatnonzero(labels[rows] != neighbour_parts)
    stride = int(labels.max(initial=0)) + 1
    cells, parts = np.divmod(np.unique(rows[crossing] * stride + neighbour_parts[crossing]), stride)
    return cells, parts


def interface_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the total interface between parts for each move ``(q,)``."""
    shared = links(graph, labels, cells, parts, graph.interface)
    return shared.own - shared.there


def cut_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the edge count between parts for each move ``(q,)``."""
    shared = links(graph, labels, cells, parts)
    return shared.own - shared.there


def normalised_cut_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the normalised cut, Σ cut / volume over all parts, for each move ``(q,)``."""
    shared = links(graph, labels, cells, parts)
    rows = np.repeat(labels, np.diff(graph.indptr))
    k = int(labels.max(initial=0)) + 1
    cuts = part_sums(rows, rows != labels[graph.indices], k)
    volumes = part_sums(labels, np.diff(graph.indptr), k)
    sources = labels[cells]
    source_ratio = ratio(cuts[sources] - shared.total + 2.0 * shared.own, volumes[sources] - shared.total)
    target_ratio = ratio(cuts[parts] + shared.total - 2.0 * shared.there, volumes[parts] + shared.total)
    changes: Float = source_ratio - ratio(cuts, volumes)[sources] + target_ratio - ratio(cuts, volumes)[parts]
    return np.where(sources == parts, 0.0, changes)


def inertia_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the parts' inertia about their centroids for each move ``(q,)``."""
    k = int(labels.max(initial=0)) + 1
    mass, means = mass_centres(graph, labels, k)
    own, weight, place = labels[cells], graph.weights[cells], graph.centroids[cells]
    lost = ratio(weight * mass[own], mass[own] - weight) * ((place - means[own]) ** 2).sum(axis=1)
    won = ratio(weight * mass[parts], mass[parts] + weight) * ((place - means[parts]) ** 2).sum(axis=1)
    changes: Float = won - lost
    return changes


def shapes(graph: Graph, labels: Int) -> Float:
    """Return inertia times L^``SHORTNESS`` per part ``(k,)``, with the interface L of its block.

    The minimiser does not depend on the unit of length.
    """
    inertia, interface, block = _inertia_and_interface(graph, labels)
    values: Float = inertia * (interface**SHORTNESS)[block]
    return values


def shape_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the sum of :func:`shapes` for each move ``(q,)``."""
    inertia, interface, block = _inertia_and_interface(graph, labels)
    total, b = part_sums(block, inertia, graph.n_blocks), graph.block_ids[cells]
    moved = total[b] + inertia_changes(graph, labels, cells, parts)
    left = np.maximum(interface[b] + interface_changes(graph, labels, cells, parts), 0.0)  # 0 up to rounding
    changes: Float = moved * left**SHORTNESS - total[b] * interface[b] ** SHORTNESS
    return np.where(labels[cells] == parts, 0.0, changes)


def _inertia_and_interface(graph: Graph, labels: Int) -> tuple[Float, Float, Int]:
    """Return the inertia per part ``(k,)``, interface per block ``(B,)``, and each part's block ``(k,)``."""
    _, means = mass_centres(graph, labels)
    inertia = part_sums(labels, graph.weights * ((graph.centroids - means[labels]) ** 2).sum(axis=1))
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    cut = np.where(labels[rows] != labels[graph.indices], graph.interface, 0.0)
    block = np.zeros(len(inertia), np.int64)
    block[labels] = graph.block_ids
    return inertia, 0.5 * part_sums(graph.block_ids[rows], cut, graph.n_blocks), block


def squared_weight_changes(graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
    """Return the change of the sum of squared part weights for each move ``(q,)``."""
    weights = graph.node_sizes("weights")
    sums, weight = part_sums(labels, weights), weights[cells]
    changes: Float = 2.0 * weight * (sums[parts] - sums[labels[cells]] + weight)
    return changes


def edge_difference(
    graph: Graph, before: Int, after: Int, edge_weights: Float | None = None
) -> tuple[float, float]:
    """Return the increase of the weighted cut between two labellings, and the edge weight of moved cells.

    Labels ``(n,)`` may number the parts of each block from 0.
    """
    cells = np.flatnonzero(before != after)
    move, entry = _entries(graph, cells)
    nodes, neighbours = cells[move], graph.indices[entry]
    weights = np.ones(len(entry)) if edge_weights is None else edge_weights[entry]
    counted_twice = before[neighbours] != after[neighbours]  # from both ends
    shares = np.where(counted_twice, 0.5, 1.0) * weights
    joined = (before[nodes] == before[neighbours]).astype(float) - (after[nodes] == after[neighbours])
    return float(shares @ joined), float(shares.sum())


def _entries(graph: Graph, cells: Int) -> tuple[Int, Int]:
    """Return the indices of all edges of some cells, and the index into ``cells`` for each edge."""
    counts = np.diff(graph.indptr)[cells]
    move = np.repeat(np.arange(len(cells)), counts)
    first = np.cumsum(counts) - counts
    return move, np.arange(len(move)) - first[move] + graph.indptr[cells][move]
