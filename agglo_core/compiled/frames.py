"""Centred and scaled coordinates of blocks of cells, moments, principal axes, and directions in 2-D."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# Ratio of the smaller to the larger principal moment, above which no axis stands out, and fourth moments
# define the frame. A larger value leaves nearly round blocks with arbitrary axes (benchmarks/quality.py,
# bisector sweep).
_ROUND = 0.8


_CHUNK = 256  # points at a time: their products stay in the first cache


@helper
def largest_block(offsets):
    """Return the number of cells in the largest block."""
    largest = 0
    for b in range(len(offsets) - 1):
        largest = max(largest, offsets[b + 1] - offsets[b])
    return largest


@kernel(reorder_sums=True)
def moment_sums(points, shares, centre, pairs):
    """Return the sums Σ s r_i r_j for P ``pairs (P, 2)`` of axes, and Σ s q r_i r_j ``(d + P, P)``.

    r are the coordinates relative to the ``centre (d,)``, s the ``shares (n,)``, and q the coordinates, then
    the products of pairs.
    """
    (n, d), m = points.shape, len(pairs)
    second, sums = np.zeros(m), np.zeros((d + m, m))
    powers, weighted = np.empty((d + m, _CHUNK)), np.empty(_CHUNK)
    for start in range(0, n, _CHUNK):
        count = min(_CHUNK, n - start)
        # 1. Coordinates and their products.
        for a in range(d):
            for k in range(count):
                powers[a, k] = points[start + k, a] - centre[a]
        for p in range(m):
            i, j = pairs[p, 0], pairs[p, 1]
            for k in range(count):
                powers[d + p, k] = powers[i, k] * powers[j, k]
        # 2. Sums.
        for p in range(m):
            total = 0.0
            for k in range(count):
                weighted[k] = powers[d + p, k] * shares[start + k]
                total += weighted[k]
            second[p] += total
            for q in range(d + m):
                total = 0.0
                for k in range(count):
                    total += powers[q, k] * weighted[k]
                sums[q, p] += total
    return second, sums


@helper(reorder_sums=True)
def planar_frame(n, x, y, shares):
    """Return cosine and sine of the principal axis of centred points, and their moments xx, xy, yy.

    If the ratio of principal moments exceeds 0.8, so that no axis stands out, the axis of least fourth
    moments is used: along the side of a square, which second moments cannot detect.

    Examples
    --------
    >>> from agglo_core.compiled.frames import planar_frame
    >>> x, y = np.array([-2.0, 0.0, 2.0]), np.zeros(3)
    >>> cos, sin, *moments = planar_frame(3, x, y, np.array([0.25, 0.5, 0.25]))
    >>> print(cos, sin, *moments)
    1.0 0.0 2.0 0.0 0.0
    """
    xx, xy, yy, real, imaginary = 0.0, 0.0, 0.0, 0.0, 0.0
    # 1. Second moments, and the fourth moment Σ s (x + iy)⁴: (x + iy)² = p + iq, squared.
    for i in range(n):
        p, q = x[i] * x[i] - y[i] * y[i], 2.0 * x[i] * y[i]
        xx += shares[i] * x[i] * x[i]
        xy += shares[i] * x[i] * y[i]
        yy += shares[i] * y[i] * y[i]
        real += shares[i] * (p * p - q * q)
        imaginary += shares[i] * 2.0 * p * q
    # 2. Principal moments are mean ± radius. The principal axis has half the angle of (xx − yy, 2 xy).
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    # 3. Nearly equal, as for a square: with the argument φ of the fourth moment, the moment along the axis at
    #    angle t is least where cos(4t − φ) = −1.
    if mean - radius > _ROUND * (mean + radius) or mean == 0.0:
        angle = 0.25 * np.arctan2(-imaginary, -real)
    return np.cos(angle), np.sin(angle), xx, xy, yy


@helper(allocates=True)
def half_circle(count):
    """Return the cosines and sines ``(count, 2)`` of evenly spaced angles on the half circle.

    Examples
    --------
    >>> from agglo_core.compiled.frames import half_circle
    >>> half_circle(2).round(9)
    array([[1., 0.],
           [0., 1.]])
    """
    angles = np.arange(count) * (np.pi / count)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


@helper(allocates=True)
def halvings(count, times):
    """Return cosines and sines of 1/2, 1/4, ... of the angle between axes of ``half_circle(count)``.

    Examples
    --------
    >>> from agglo_core.compiled.frames import halvings
    >>> halvings(2, 1).round(3)  # 45°, half of the 90° between two axes
    array([[0.707, 0.707]])
    """
    angles = np.pi / count / 2.0 ** np.arange(1, times + 1)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


@helper
def turned(a, b, p, q):
    """Return the direction (a, b) rotated by the angle with cosine p and sine q.

    Examples
    --------
    >>> from agglo_core.compiled.frames import turned
    >>> turned(3.0, 4.0, 0.0, 1.0)  # by 90°
    (-4.0, 3.0)
    """
    return a * p - b * q, b * p + a * q


# Smallest weight of the inertia relative to the cut, dimensionless: larger favours compact halves, smaller
# favours short cuts (benchmarks/quality.py, bisector sweep).
_COMPACT = 15.0
# Times √n: this weight in blocks of n cells, above 15 from n = 15 on (benchmarks/gnn.py, bisector sweep).
_GROWTH = 4.0


@helper
def compactness(n):
    """Return the weight of inertia relative to the cut in the bisection cost of n cells.

    A longer cut affects two parts, unequal sides affect all parts that result from them. Their weight
    therefore increases with the cell count, but only like √n, so that necks are still found.
    """
    return max(_COMPACT, _GROWTH * np.sqrt(n))


@helper
def centre_block(start, n, centroids, weights, measures, local, shares):
    """Write the centred centroids and normalised weights of a block's cells, and return its scales.

    The scales are 1 / section, inertia, and inertia weight. ``local (3, n)`` and ``shares (n,)`` belong to
    the cells ``start`` to ``start + n − 1``, and the shares add up to 1. The section is a side or face of a
    square or cube with the block's measure.

    Examples
    --------
    >>> from agglo_core.compiled.frames import centre_block
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
    # Positions relative to the first cell, so that means far from the origin lose no digits.
    for k in range(d):
        for i in range(n):
            local[k, i] = centroids[start + i, k] - centroids[start, k]
    for i in range(n if d == 2 else 0):
        local[2, i] = 0.0
    return centre_points(n, d, local, shares, total, measure)


@helper(reorder_sums=True)
def _centre(n, column, shares):
    """Shift the values of a column to weighted mean 0, and return their variance."""
    mean, variance = 0.0, 0.0
    for i in range(n):
        mean += shares[i] * column[i]
    for i in range(n):
        column[i] -= mean
        variance += shares[i] * column[i] ** 2
    return variance


@helper
def centre_points(n, d, local, shares, total, measure):
    """Centre the coordinates ``local (3, n)`` in d dimensions, normalise the weights, and return the scales.

    Returns the scales of ``centre_block``. ``total`` is the sum of weights, ``measure`` the sum of measures.
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
