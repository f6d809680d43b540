"""Test quickly if the parts of a graph are connected."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Index, Int, Mask, frozen, frozen_index
from agglo_core.threads import over_ranges


def all_connected(indptr: Int, indices: Index) -> bool:
    """Return True if the graph is connected.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph = samples.squares(2).graph
    >>> all_connected(graph.indptr, graph.indices)
    True
    """
    nodes = frozen_index(np.zeros(len(indptr) - 1, np.int32))
    return not broken_parts(indptr, indices, nodes, np.ones(1, bool)).any()


def parts_connected(indptr: Int, indices: Index, labels: Int) -> bool:
    """Return True if every part is connected, for non-negative labels ``(n,)``.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph = samples.squares(2).graph
    >>> parts_connected(graph.indptr, graph.indices, np.array([0, 0, 1, 1]))
    True
    >>> parts_connected(graph.indptr, graph.indices, np.array([0, 1, 1, 0]))
    False
    """
    examined = np.ones(int(labels.max(initial=-1)) + 1, bool)
    return not broken_parts(indptr, indices, labels, examined).any()


def broken_parts(indptr: Int, indices: Index, labels: Int | Index, examined: Mask) -> Mask:
    """Return the mask of disconnected parts, among those in the mask ``examined (k,)``.

    The labels ``(n,)`` are below k.

    Several threads share the pass over all nodes, after which few nodes remain.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph = samples.squares(2).graph
    >>> broken_parts(graph.indptr, graph.indices, np.array([0, 1, 1, 0]), np.array([True, False]))
    array([ True, False])
    """
    from agglo_core.compiled import part_faults

    part_labels = frozen_index(labels)

    # Cells that may begin a separate component, per thread.
    def find_lone_cells(start: int, stop: int) -> Index:
        cells = np.empty(stop - start, np.int32)
        workspace = np.zeros(len(part_labels), np.int32), np.empty(len(part_labels) + 1, np.int32)
        count = part_faults.lone_cells(
            start, stop, indptr, indices, part_labels, len(examined), cells, *workspace
        )
        return cells[:count]

    candidates = over_ranges(find_lone_cells, len(part_labels), shares=1)
    nodes = frozen_index(candidates[0] if len(candidates) == 1 else np.concatenate(candidates))
    broken: Mask = part_faults.broken_parts(nodes, indptr, indices, part_labels, frozen(examined, bool))
    return broken
