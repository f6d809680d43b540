"""Whether the parts of a graph are connected: asked often, and the answer is nearly always yes."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Index, Int, Mask, frozen_index, frozen_int
from agglo_core.threads import over_ranges, ranges

__all__ = ["broken_parts", "parts_connected"]


def parts_connected(indptr: Int, indices: Index, labels: Int) -> bool:
    """Whether the nodes of each label ``(n,)``, none negative, are connected among themselves.

    Several threads join the nodes of ranges; the edges between ranges, few where neighbours are near in
    memory, come last.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph = samples.squares(2).graph
    >>> parts_connected(graph.indptr, graph.indices, np.array([0, 0, 1, 1]))
    True
    >>> parts_connected(graph.indptr, graph.indices, np.array([0, 1, 1, 0]))
    False
    """
    from agglo_core.kernels.graphs import broken_blocks, join_range, join_ranges

    n, given = len(labels), frozen_int(labels)
    if len(ranges(n, shares=1)) == 1:
        return not broken_blocks(frozen_int([0, n]), indptr, indices, given).any()
    parent = np.empty(n, np.int32)

    def join(start: int, stop: int) -> Index:
        later = np.empty(stop - start, np.int32)
        return later[: join_range(start, stop, indptr, indices, given, parent, later)]

    later = frozen_index(np.concatenate(over_ranges(join, n, shares=1)))
    return bool(join_ranges(later, indptr, indices, given, parent))


def broken_parts(indptr: Int, indices: Index, labels: Int, asked: Mask) -> Mask:
    """Which of the parts ``asked (k,)`` are not connected; the labels ``(n,)`` are below k.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph = samples.squares(2).graph
    >>> broken_parts(graph.indptr, graph.indices, np.array([0, 1, 1, 0]), np.array([True, False]))
    array([ True, False])
    """
    from agglo_core.kernels import part_faults

    n, given = len(labels), frozen_int(labels)
    if len(ranges(n, shares=1)) > 1 and parts_connected(indptr, indices, given):
        return np.zeros(len(asked), bool)
    broken: Mask = part_faults.broken_parts(indptr, indices, given, asked)
    return broken
