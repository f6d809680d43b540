"""Tree of the recursive splits, and label numbering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_int


def by_first_cell(labels: ArrayLike) -> Int:
    """Renumber labels to 0..k−1 in the order of the parts' smallest cell indices.

    Examples
    --------
    >>> from agglo_core.hierarchy import by_first_cell
    >>> by_first_cell([2, 2, 0, 1, 0])
    array([0, 0, 1, 2, 1])
    """
    array = frozen_int(labels)
    first = np.full(int(array.max()) + 1, -1, np.int64)
    first[array[::-1]] = np.arange(len(array) - 1, -1, -1)  # the last write is the smallest id
    parts = np.flatnonzero(first >= 0)
    number = np.empty(len(first), np.int64)
    number[parts[np.argsort(first[parts])]] = np.arange(len(parts))
    return frozen_int(number[array])


@dataclass(frozen=True, eq=False)
class Tree:
    """Tree of recursive splits, with the cells sorted so that every node's cells are contiguous.

    Attributes
    ----------
    cells : (n,) int
        Cell ids in tree order.
    parent : (N,) int
        Parent node, −1 for roots; parents come before their children.
    start, stop : (N,) int
        Node i owns ``cells[start[i]:stop[i]]``.
    diameter : (N,) float
        Diameter, exact near a target, elsewhere a number on the same side of every target; NaN if no
        target needs it.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.hierarchy import Tree
    >>> of_node = np.array([-1, 0, 0]), np.array([0, 0, 2]), np.array([3, 2, 3])  # a root and its halves
    >>> tree = Tree(np.array([2, 0, 1]), *of_node, diameter=np.array([3.0, 2.0, 1.0]))
    >>> tree.cut(2.0), tree.labels(tree.cut(2.0))
    (array([1, 2]), array([0, 1, 0]))
    """

    cells: Int
    parent: Int
    start: Int
    stop: Int
    diameter: Float

    def labels(self, nodes: ArrayLike) -> Int:
        """Return the cell labels ``(n,)`` of the partition into disjoint nodes that cover all cells."""
        ordered_nodes = frozen_int(nodes)
        ordered_nodes = ordered_nodes[np.argsort(self.start[ordered_nodes])]
        sizes = self.stop[ordered_nodes] - self.start[ordered_nodes]
        labels = np.empty(len(self.cells), np.int64)
        labels[self.cells] = np.repeat(np.arange(len(ordered_nodes)), sizes)
        return by_first_cell(labels)

    def cut(self, h_star: float) -> Int:
        """Return the first node with ``diameter <= h_star`` on each path from a root, or the leaf."""
        leaf = np.ones(len(self.parent), bool)
        leaf[self.parent[self.parent >= 0]] = False
        meets = leaf | (self.diameter <= h_star)
        above = np.where(self.parent >= 0, meets[self.parent], False)
        return frozen_int(np.flatnonzero(meets & ~above))
