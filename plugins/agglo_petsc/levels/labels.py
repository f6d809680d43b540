"""Conversion of cell labels to aggregates of the parts on each level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Int, OptionError, frozen_int, multigrid


def nested_aggregates(labels: Sequence[Int]) -> list[Int]:
    """Convert nested labels ``(n_cells,)`` to the aggregate of each cell, then of each part per level.

    Labels are ordered finest first.

    Raises
    ------
    OptionError
        If parts are not unions of finer parts.

    Examples
    --------
    >>> [each.tolist() for each in nested_aggregates([np.arange(6) // 2, np.arange(6) // 4])]
    [[0, 0, 1, 1, 2, 2], [0, 0, 1]]
    """
    aggregates: list[Int] = []
    for level, coarse in enumerate(labels):
        parent_of = multigrid.parents(labels[level - 1], coarse) if level else frozen_int(coarse)
        if parent_of is None:
            raise OptionError(f"the agglomerates of level {level} are not unions of those of the finer level")
        aggregates.append(parent_of)
    return aggregates


def labels_of_unknowns(
    unknowns: ArrayLike, cell_of: ArrayLike, levels: Sequence[ArrayLike], n: int
) -> list[Int]:
    """Assign the unknowns of a continuous finite element method to parts, on each level.

    On the finest level an unknown belongs to the part with most of its cells, the lowest of several; on
    coarser levels to the parent of that part. Parts are renumbered without gaps: a thin part may have no
    unknown.

    Parameters
    ----------
    unknowns, cell_of : (m,) int
        Unknown ``unknowns[i]`` is in cell ``cell_of[i]``: the flat degree-of-freedom table.
    levels : sequence of (n_cells,) int
        Part of each cell, finest first, each level nested in the next.
    n : int
        Number of unknowns.

    Returns
    -------
    list of (n,) int

    Raises
    ------
    OptionError
        If an unknown is in no cell, or levels are not nested.

    Examples
    --------
    Three edges in a row, four vertices; the last two edges are one part:

    >>> labels_of_unknowns([0, 1, 1, 2, 2, 3], [0, 0, 1, 1, 2, 2], [[0, 1, 1]], 4)[0].tolist()
    [0, 0, 1, 1]
    """
    rows, cells = np.asarray(unknowns), np.asarray(cell_of)
    missing = np.flatnonzero(np.bincount(rows, minlength=n)[:n] == 0)
    if len(missing) or rows.max(initial=-1) >= n:
        raise OptionError(
            f"{n} unknowns: {len(missing)} are in no cell, and the largest index in a cell is {rows.max()}"
        )
    part_labels: list[Int] = []
    for level, parent_of in enumerate(nested_aggregates([np.asarray(values) for values in levels])):
        part = parent_of[part_labels[-1]] if level else _of_most(rows, parent_of[cells])
        part_labels.append(frozen_int(part))
    return [frozen_int(np.unique(values, return_inverse=True)[1]) for values in part_labels]


def _of_most(rows: Int, parts: Int) -> Int:
    """Return for each unknown 0..n−1 the part with most of its cells."""
    pairs, counts = np.unique(np.stack((rows, parts), axis=1), axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], -counts, pairs[:, 0]))
    return frozen_int(pairs[order[np.unique(pairs[order, 0], return_index=True)[1]], 1])
