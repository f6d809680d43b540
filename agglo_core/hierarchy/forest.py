"""Trees of the parts on nested levels, whose cuts are coarse meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from agglo_core.arrays import FieldState, Float, Int, frozen_float, frozen_int, label_order
from agglo_core.errors import OptionError
from agglo_core.hierarchy.tree import by_first_cell
from agglo_core.mesh.checks import name_cells


@dataclass(frozen=True, eq=False)
class Forest(FieldState):
    """Trees of a nested hierarchy: the nodes are the parts of all levels, and the cells.

    Equal parts of several levels are one node.

    Attributes
    ----------
    cells : (n,) int
        Cell ids in tree order, so that every node is a slice.
    start, stop : (N,) int
        Node i owns ``cells[start[i]:stop[i]]``.
    parent : (N,) int
        Parent node, −1 for roots; parents come before their children.
    first_child, n_children : (N,) int
        The children of node i are numbered ``first_child[i]``, …; single cells have none.
    finest, coarsest : (N,) int
        Finest and coarsest level with this part; −1 stands for the cells.
    rounds : (r,) int
        First node per coarsest level, from above; the roots are the first round.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> forest = agglo.agglomerate(agglo.samples.squares(4), n_parts=(4, 2)).forest
    >>> forest.n_children[:2], len(forest.parent)  # 2 + 4 parts and 16 cells
    (array([2, 2]), 22)
    """

    cells: Int
    start: Int
    stop: Int
    parent: Int
    first_child: Int
    n_children: Int
    finest: Int
    coarsest: Int
    rounds: Int

    @classmethod
    def of(cls, levels: Sequence[Int], n: int) -> Forest:
        """Build the trees from nested levels ``(n,)``, finest first.

        Raises
        ------
        OptionError
            If the levels are not nested.
        """
        check_nested(levels)
        order = np.arange(n)
        for labels in levels:
            order = order[label_order(labels[order])]
        start, stop, parent, finest, coarsest, rounds = _nodes(levels, order)
        children = np.flatnonzero(parent >= 0)
        count = np.bincount(parent[children], minlength=len(parent))
        first = np.zeros(len(parent), np.int64)
        first[parent[children[::-1]]] = children[::-1]
        arrays = order, start, stop, parent, first, count, finest, coarsest, rounds
        return cls(*map(frozen_int, arrays))

    def matches(self, other: Forest) -> bool:
        """Return True if both forests have equal nodes and cells, as after unpickling."""
        if self is other:
            return True
        names = [field.name for field in fields(self)]
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    @property
    def n_roots(self) -> int:
        """Number of roots, the parts on the coarsest level."""
        return int(self.rounds[1]) if len(self.rounds) > 1 else len(self.parent)

    def sums(self, values: Float) -> Float:
        """Sum cell values ``(n,)`` over the cells of each node.

        For non-negative values, rounding never makes a node smaller than one of its children.
        """
        total = np.zeros(len(self.parent))
        single = np.flatnonzero(self.n_children == 0)
        total[single] = values[self.cells[self.start[single]]]
        stops = [*self.rounds[1:].tolist(), len(self.parent)]
        for begin, stop in reversed(list(zip(self.rounds.tolist(), stops, strict=True))[1:]):
            total += np.bincount(self.parent[begin:stop], total[begin:stop], len(total))
        return frozen_float(total)

    def level(self, level: int) -> Int:
        """Return the nodes that form a level, where −1 stands for the cells."""
        return frozen_int(np.flatnonzero((self.finest <= level) & (level <= self.coarsest)))

    def labelled(self, nodes: Int) -> tuple[Int, Int]:
        """Label the cells ``(n,)`` by disjoint nodes that cover them, and return the nodes in label order."""
        nodes = nodes[np.argsort(self.start[nodes])]
        at = np.empty(len(self.cells), np.int64)
        at[self.cells] = np.repeat(np.arange(len(nodes)), self.stop[nodes] - self.start[nodes])
        labels = by_first_cell(at)
        ordered = np.empty(len(nodes), np.int64)
        ordered[labels] = nodes[at]
        return labels, frozen_int(ordered)


def _nodes(levels: Sequence[Int], order: Int) -> tuple[Int, ...]:
    """Return cell range, parent, finest and coarsest level per node, and the first node per level."""
    nodes = np.empty((5, 0), np.int64)
    rounds: list[int] = []
    holder = np.full(len(order), -1)  # node of the level above at each position
    # From the coarsest level to the cells: a part equal to its parent extends it, other parts are new nodes.
    for level in range(len(levels) - 1, -2, -1):
        ordered = levels[level][order] if level >= 0 else order
        first = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1]))
        sizes = np.diff(np.append(first, len(order)))
        above, number = holder[first], nodes.shape[1]
        new = (above < 0) | (sizes != np.append(nodes[1] - nodes[0], 0)[above])
        nodes[3, above[~new]] = level
        rounds += [number] if new.any() else []
        rows = np.stack((first, first + sizes, above, np.full(len(first), level), np.full(len(first), level)))
        nodes = np.concatenate((nodes, rows[:, new]), axis=1)
        holder = np.repeat(np.where(new, number + np.cumsum(new) - 1, above), sizes)
    return *nodes, np.array(rounds)


def check_nested(levels: Sequence[Int]) -> None:
    """Raise OptionError unless each level ``(n,)`` is a coarsening of the previous one, finest first."""
    for level, (fine, coarse) in enumerate(pairwise(levels)):
        holder = np.empty(int(fine.max(initial=-1)) + 1, np.int64)
        holder[fine] = coarse
        split_cells = np.flatnonzero(holder[fine] != coarse)
        if len(split_cells):
            raise OptionError(
                f"the hierarchy is not nested: part {fine[split_cells[0]]} of level {level} lies in several "
                f"parts of level {level + 1} ({name_cells(split_cells)}); "
                "agglomerate(nested=True) makes nested levels"
            )
