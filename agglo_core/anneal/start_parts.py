"""Initial partitions for a search, and changes to whole parts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.anneal.annealed_parts import ROUNDING
from agglo_core.arrays import Int, Mask, frozen_int, label_order
from agglo_core.graph import Graph
from agglo_core.progress import ignore_progress
from agglo_core.protocols import Target
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.split.geometric import InertialBisection


def cut_in_two(graph: Graph, labels: Int, chosen: Mask) -> Int:
    """Cut each of the ``chosen (k,)`` parts across its principal axis, and return labels ``(n,)``.

    Disconnected halves become several parts. The numbers have no gaps.
    """
    result, order = labels.copy(), label_order(labels)
    stops = np.cumsum(np.bincount(labels))
    k = len(stops)
    for p in np.flatnonzero(chosen):
        part_cells = order[(stops[p - 1] if p else 0) : stops[p]]
        if len(part_cells) > 1:
            result[part_cells[_far_side(graph, part_cells)]] = k
            k += 1
    return frozen_int(graph.components(np.unique(result, return_inverse=True)[1]))


def _far_side(graph: Graph, cells: Int) -> Mask:
    """Return a mask of the cells beyond the centre along the principal axis, some cells but not all."""
    # 1. Principal axis of the centroids.
    weights = graph.measures[cells]
    weights = weights if weights.sum() > 0.0 else np.ones(len(cells))
    places = graph.centroids[cells] - np.average(graph.centroids[cells], axis=0, weights=weights)
    axis = np.linalg.eigh((weights[:, None] * places).T @ places)[1][:, -1]
    heights = places @ axis
    # 2. Cells beyond the centre, or the upper half by order.
    side: Mask = heights > 0.0
    if side.all() or not side.any():
        side = np.arange(len(cells)) >= len(cells) // 2
        side = side[np.argsort(np.argsort(heights, kind="stable"), kind="stable")]
    return side


def dissolve_part(graph: Graph, labels: Int, part: int) -> Int:
    """Dissolve a part: its cells join the parts with the longest common interface.

    Returns the labels ``(n,)`` without gaps. Cells join from the outside in. A part without neighbours stays.
    """
    result = labels.copy()
    open_cells = np.flatnonzero(labels == part)
    result[open_cells] = -1
    while len(open_cells):
        targets = [_most_shared(graph, result, int(i)) for i in open_cells]
        has_target = np.array([p >= 0 for p in targets])
        if not has_target.any():
            return labels
        result[open_cells[has_target]] = np.array(targets)[has_target]
        open_cells = open_cells[~has_target]
    return frozen_int(np.unique(result, return_inverse=True)[1])


def _most_shared(graph: Graph, labels: Int, cell: int) -> int:
    """Return the part that has the longest interface with a cell, or −1 if no neighbour has a part."""
    row = slice(int(graph.indptr[cell]), int(graph.indptr[cell + 1]))
    neighbour_parts = labels[graph.indices[row]]
    has_part = neighbour_parts >= 0
    if not has_part.any():
        return -1
    parts, place = np.unique(neighbour_parts[has_part], return_inverse=True)
    return int(parts[np.argmax(np.bincount(place, graph.interface[row][has_part]))])


def dissolve_parts(graph: Graph, labels: Int, chosen: Mask, of_part: Int) -> Int:
    """Dissolve the ``chosen (k,)`` parts: their cells join other parts in the same group (share).

    Returns the labels ``(n,)``. Each cell joins the part with the longest common interface, from the outside
    in. A part that cannot be dissolved stays.
    """
    result, open_cells = labels.copy(), np.flatnonzero(chosen[labels])
    result[open_cells] = -1
    while len(open_cells):
        targets = _most_shared_each(graph, result, open_cells, of_part[labels[open_cells]], of_part)
        has_target = targets >= 0
        if not has_target.any():
            stuck = np.isin(labels, labels[open_cells])
            result[stuck] = labels[stuck]
            break
        result[open_cells[has_target]] = targets[has_target]
        open_cells = open_cells[~has_target]
    return frozen_int(result)


def _most_shared_each(graph: Graph, labels: Int, cells: Int, share: Int, of_part: Int) -> Int:
    """Return, for each cell ``(q,)``, the part in its group with the longest interface, or −1 if none."""
    # 1. Graph entries from the cells to parts in their share.
    counts = np.diff(graph.indptr)[cells].astype(np.int64)
    move = np.repeat(np.arange(len(cells)), counts)
    entry = np.arange(len(move)) + np.repeat(graph.indptr[cells] - np.cumsum(counts) + counts, counts)
    neighbour_parts = labels[graph.indices[entry]]
    fits = (neighbour_parts >= 0) & (of_part[neighbour_parts] == share[move])
    # 2. Sum the interface by cell and part.
    keys, place = np.unique(move[fits] * len(of_part) + neighbour_parts[fits], return_inverse=True)
    length = np.bincount(place, graph.interface[entry[fits]], len(keys))
    # 3. Longest interface of each cell.
    order = np.lexsort((-length, keys // len(of_part)))
    cell, first = np.unique((keys // len(of_part))[order], return_index=True)
    targets = np.full(len(cells), -1, np.int64)
    targets[cell] = (keys % len(of_part))[order][first]
    return targets


Start = Callable[[Graph, int], Int]
"""Returns labels of a connected graph with about the given number of parts."""

Rival = Callable[[Graph, Target], Int]
"""Returns labels of a connected graph that meet a target."""


def connect_parts(graph: Graph, labels: Int) -> Int:
    """Make every part connected, and return labels without gaps."""
    return ConnectivityFixer().fix(graph, frozen_int(np.unique(labels, return_inverse=True)[1]))


def partition_by_bisection(graph: Graph, target: Target) -> Int:
    """Partition a connected graph by refined inertial bisections."""
    given, seeds = ([InterfaceRefiner()], ConnectivityFixer()), np.zeros(1, np.uint64)
    growth: Any = InertialBisection().grow(graph, frozen_int(np.zeros(graph.n)), *given)
    if target.h_star is None:
        return frozen_int(growth.split(frozen_int([target.parts or 1]), seeds, ignore_progress)[0])
    return frozen_int(growth.split_to_size(target.h_star * (1 + ROUNDING), seeds, ignore_progress)[0])


def parts_within(graph: Graph, labels: Int, size: float) -> Int:
    """Bisect parts recursively until only single cells are wider than ``size``."""
    while True:
        wide = (graph.part_diameters(labels) > size * (1 + ROUNDING)) & (np.bincount(labels) > 1)
        if not wide.any():
            return labels
        labels = cut_in_two(graph, labels, wide)
