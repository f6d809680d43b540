"""Interface refinement with array operations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core import Graph, OptionError, Target

__all__ = ["Leaves"]

Labels = NDArray[np.int64]


class Leaves:
    """Refiner that moves leaves, cells with a single neighbour in their part, to an adjacent part.

    The new part has the longest interface with the leaf. A leaf can move without disconnecting its part, and
    of two neighbours only one moves at a time. Hence no part is emptied or broken, and the gains of all moves
    add up.

    Parameters
    ----------
    sweeps : int
        Maximum number of rounds.
    """

    objective = "interface"

    def __init__(self, sweeps: int = 8) -> None:
        if not isinstance(sweeps, int) or sweeps < 1:
            raise OptionError(f"leaves: sweeps must be a positive integer, given {sweeps!r}")
        self.sweeps = sweeps

    def refine(self, graph: Graph, labels: Labels, seeds: NDArray[np.uint64], target: Target) -> Labels:
        """Return labels ``(n,)`` with an interface no longer than before.

        Seeds and target are not used.
        """
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        refined = np.array(labels)
        for _ in range(self.sweeps):
            cells, parts = _moves(graph, rows, refined)
            if len(cells) == 0:
                break
            refined[cells] = parts
        return refined


def _moves(graph: Graph, rows: Labels, labels: Labels) -> tuple[Labels, Labels]:
    """Return leaves with a gain, no two of them adjacent, and the new part of each."""
    n, stride = graph.n, int(labels.max()) + 1
    # Interface of each cell with each adjacent part.
    pairs, place = np.unique(rows * stride + labels[graph.indices], return_inverse=True)
    shared, cell, part = np.bincount(place, graph.interface), pairs // stride, pairs % stride
    # Interface with the own part, and the largest interface with another part.
    inside = part == labels[cell]
    own, best = np.zeros(n), np.zeros(n)
    own[cell[inside]] = shared[inside]
    np.maximum.at(best, cell[~inside], shared[~inside])
    # Gain of leaves, up to rounding.
    held = np.bincount(rows, labels[rows] == labels[graph.indices], minlength=n)
    gain = np.where(held == 1, best - own, 0.0)
    gain[gain <= 1e-12 * best] = 0.0
    # Keep cells with a larger gain than all their neighbours.
    rank = np.empty(n, np.int64)
    rank[np.argsort(gain, kind="stable")] = np.arange(n)
    highest = np.zeros(n, np.int64)
    np.maximum.at(highest, rows, rank[graph.indices])
    moves = (gain > 0) & (rank > highest)
    chosen = moves[cell] & ~inside & (shared == best[cell])
    return cell[chosen], part[chosen]
