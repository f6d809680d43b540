"""Sweep rounding: bisect a graph at the best threshold of a node score, such as a network output."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Index, Int, exact_cast, frozen_float, plain_array
from agglo_core.errors import OptionError

if TYPE_CHECKING:
    from agglo_core.graph import Graph


def sweep(level: Graph, scores: ArrayLike) -> Int:
    """Bisect each block at the best threshold of a node score, among 31 per score column.

    Thresholds are equidistant between the extremes of the score, at most two standard deviations from its
    mean. With measure A = A₁ + A₂ of the two sides, cut length, and the share B/T of the inertia between the
    sides (the energy maximised by 2-means), the cost of a threshold is

        cut · √A (1/A₁ + 1/A₂) + max(15, 4 √n) (1 − B/T)

    for a block with n cells (in 3-D ∛A replaces √A, so that the cost has no unit). A longer cut harms two
    parts, unequal sides harm all parts of later splits. One pass over the edges computes all cuts. Neither
    side is ever empty, whatever the scores, even for probabilities on one side of ½.

    Parameters
    ----------
    level : Graph
    scores : (n,) or (n, C) float
        Logits, probabilities or coordinates; each block uses its best column (the first of equal
        columns). Only differences within a block matter.

    Returns
    -------
    (n,) int64
        1 where the score is above the threshold.

    Raises
    ------
    OptionError
        If the scores have another shape, or are not finite.

    Examples
    --------
    >>> from agglo_core import samples
    >>> strip = samples.strip(6).graph
    >>> sweep(strip, strip.centroids[:, 0])
    array([0, 0, 0, 1, 1, 1])
    """
    from agglo_core.compiled.thresholds import sweep_level

    columns = exact_cast(plain_array(scores, "scores", OptionError), np.float64, "scores", OptionError)
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or len(columns) != level.n or columns.shape[1] == 0:
        raise OptionError(
            f"scores must have shape ({level.n},) or ({level.n}, C), one row per node; given "
            f"{np.shape(scores)}"
        )
    if not np.isfinite(columns).all():
        row, column = np.argwhere(~np.isfinite(columns))[0]
        raise OptionError(f"scores must be finite; node {row} has {columns[row, column]}")
    sides: Int = sweep_level(*sweep_arrays(level), frozen_float(columns))
    return sides


def sweep_arrays(level: Graph) -> tuple[Int, Int, Index, Float, Float, Float, Float]:
    """Return the graph arrays for sweeps: blocks, CSR, interfaces, centroids, weights, measures.

    Examples
    --------
    >>> from agglo_core.graph.sweep import sweep_arrays
    >>> [array.shape for array in sweep_arrays(agglo.samples.strip(4).graph)]
    [(2,), (5,), (6,), (6,), (4, 2), (4,), (4,)]
    """
    csr = (level.offsets, level.indptr, level.indices, level.interface)
    return (*csr, level.centroids, level.weights, level.measures)
