"""From labels of cells to aggregates of the parts of each level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Float, Int, OptionError, frozen_float, frozen_int, multigrid

__all__ = ["labels_of_unknowns", "monomials", "nested_aggregates"]


def nested_aggregates(labels: Sequence[Int]) -> list[Int]:
    """Aggregate of each cell, then of each part of a level, from labels ``(n_cells,)``, finest first.

    Raises
    ------
    OptionError
        If the parts of a level are not unions of those of the level before.

    Examples
    --------
    >>> [each.tolist() for each in nested_aggregates([np.arange(6) // 2, np.arange(6) // 4])]
    [[0, 0, 1, 1, 2, 2], [0, 0, 1]]
    """
    found: list[Int] = []
    for level, coarse in enumerate(labels):
        up = multigrid.parents(labels[level - 1], coarse) if level else frozen_int(coarse)
        if up is None:
            raise OptionError(
                f"the agglomerates of level {level} are not unions of those of the level before"
            )
        found.append(up)
    return found


def labels_of_unknowns(unknowns: ArrayLike, cell_of: ArrayLike, labels: ArrayLike, n: int) -> Int:
    """A part for each unknown of a continuous method, from the parts of the cells that share it.

    It is the part most of these cells are in, the lowest of several; parts are numbered anew without gaps, as
    one that is thin may have no unknown of its own.

    Parameters
    ----------
    unknowns, cell_of : (m,) int
        Unknown ``unknowns[i]`` is in cell ``cell_of[i]``: the table of degrees of freedom, flat.
    labels : (n_cells,) int
        Part of each cell.
    n : int
        Number of unknowns. One that is in no cell gets −1.

    Examples
    --------
    Three edges in a row, four vertices; the last two edges are one part:

    >>> labels_of_unknowns([0, 1, 1, 2, 2, 3], [0, 0, 1, 1, 2, 2], [0, 1, 1], 4).tolist()
    [0, 0, 1, 1]
    """
    rows, part = np.asarray(unknowns), np.asarray(labels)[np.asarray(cell_of)]
    pairs, counts = np.unique(np.stack((rows, part), axis=1), axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], -counts, pairs[:, 0]))
    first = order[np.unique(pairs[order, 0], return_index=True)[1]]
    found = np.full(n, -1)
    found[pairs[first, 0]] = np.unique(pairs[first, 1], return_inverse=True)[1]
    return frozen_int(found)


def monomials(points: Float, degree: int) -> Float:
    """Monomials ``(q, k)`` of total degree up to ``degree`` at points ``(q, d)``, 1 first.

    Examples
    --------
    >>> monomials(np.array([[2.0, 3.0]]), 2).tolist()
    [[1.0, 3.0, 9.0, 2.0, 6.0, 4.0]]
    """
    dim = points.shape[1]
    powers = [each for each in np.ndindex(*(degree + 1,) * dim) if sum(each) <= degree]
    return frozen_float(np.stack([np.prod(points ** np.array(each), axis=1) for each in powers], axis=1))
