"""Interface refinement by array operations alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core import Graph, OptionError, Target

__all__ = ["Leaves"]

Labels = NDArray[np.int64]


class Leaves:
    """Moves leaves, cells with one neighbour in their part, to the part they share most interface with.

    A leaf can go without disconnecting its part, and of two neighbours only one goes at a time: no part
    is emptied or broken, and what the moves gain adds up.

    Parameters
    ----------
    sweeps : int
        At most so many rounds of moves.
    """

    objective = "interface"

    def __init__(self, sweeps: int = 8) -> None:
        if not isinstance(sweeps, int) or sweeps < 1:
            raise OptionError(f"leaves: sweeps must be a positive integer, given {sweeps!r}")
        self.sweeps = sweeps

    def refine(self, graph: Graph, labels: Labels, seeds: NDArray[np.uint64], target: Target) -> Labels:
        """Labels ``(n,)`` with an interface no longer than before; seeds and target are not used."""
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        refined = np.array(labels)
        for _ in range(self.sweeps):
            cells, parts = _moves(graph, rows, refined)
            if len(cells) == 0:
                break
            refined[cells] = parts
        return refined


def _moves(graph: Graph, rows: Labels, labels: Labels) -> tuple[Labels, Labels]:
    """Leaves that gain by moving, no two of them neighbours, and the part each goes to."""
    n, stride = graph.n, int(labels.max()) + 1
    pairs, place = np.unique(rows * stride + labels[graph.indices], return_inverse=True)
    shared, cell, part = np.bincount(place, graph.interface), pairs // stride, pairs % stride
    inside = part == labels[cell]
    own, best = np.zeros(n), np.zeros(n)
    own[cell[inside]] = shared[inside]
    np.maximum.at(best, cell[~inside], shared[~inside])
    held = np.bincount(rows, labels[rows] == labels[graph.indices], minlength=n)
    gain = np.where(held == 1, best - own, 0.0)
    gain[gain <= 1e-12 * best] = 0.0
    rank = np.empty(n, np.int64)
    rank[np.argsort(gain, kind="stable")] = np.arange(n)
    highest = np.zeros(n, np.int64)
    np.maximum.at(highest, rows, rank[graph.indices])
    moves = (gain > 0) & (rank > highest)
    chosen = moves[cell] & ~inside & (shared == best[cell])
    return cell[chosen], part[chosen]
