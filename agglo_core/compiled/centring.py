"""Blocks about their centres of mass, with what a cut of them is weighed by."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

_COMPACT = 15.0  # least weight of the inertia beside the cut
_GROWTH = 4.0  # times √n: its weight in a block of many cells


@helper
def compactness(n):
    """Weight of the inertia beside the cut of a block of n cells.

    A longer cut harms two parts, unequal sides harm all the parts that they will be split into: the
    more cells, the more that counts, but only like √n, so that necks are still found.
    """
    return max(_COMPACT, _GROWTH * np.sqrt(n))


@helper
def centre_block(start, n, centroids, weights, measures, local, shares):
    """Fill positions about the centre of mass, and shares; return 1 / section, inertia and its weight.

    Examples
    --------
    >>> from agglo_core.authoring import centre_block
    >>> strip, local, shares = agglo.samples.strip(4).graph, np.empty((3, 4)), np.empty(4)
    >>> arrays = strip.centroids, strip.weights, strip.measures
    >>> print(*centre_block(0, 4, *arrays, local, shares))
    2.0 0.078125 15.0
    >>> local[0], shares
    (array([-0.375, -0.125,  0.125,  0.375]), array([0.25, 0.25, 0.25, 0.25]))
    """
    d = centroids.shape[1]
    total, measure = 0.0, 0.0
    for i in range(n):
        shares[i] = weights[start + i]
        total += weights[start + i]
        measure += measures[start + i]
    for k in range(d):
        for i in range(n):
            local[k, i] = centroids[start + i, k] - centroids[start, k]
    for i in range(n if d == 2 else 0):
        local[2, i] = 0.0
    return centre_points(n, d, local, shares, total, measure)


@helper(reorder_sums=True)
def _centre(n, column, shares):
    """Make the mean of a column 0; returns its variance."""
    mean, variance = 0.0, 0.0
    for i in range(n):
        mean += shares[i] * column[i]
    for i in range(n):
        column[i] -= mean
        variance += shares[i] * column[i] ** 2
    return variance


@helper
def centre_points(n, d, local, shares, total, measure):
    """Centre the positions ``local (3, n)``, of d rows, and make shares of the weights; see ``centre_block``.

    ``total`` is the sum of the weights, ``measure`` that of the measures.
    """
    for i in range(n):
        shares[i] = shares[i] / total if total > 0.0 else 1.0 / n
    inertia = 0.0
    for k in range(d):
        inertia += _centre(n, local[k], shares)
    scale = 1.0
    if measure > 0.0:
        scale = 1.0 / np.sqrt(measure) if d == 2 else measure ** (-2.0 / 3.0)
    return scale, max(inertia, 1e-300), compactness(n)
