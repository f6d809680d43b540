"""Point sets for 2-means: copying to a workspace, trial axes, and binning on a grid."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.authoring import helper
from agglo_core.split import piece_frames, piece_splits

# Ratio of principal moments above which no axis stands out, and several are tried. A larger value is faster,
# and cuts nearly square pieces less well (benchmarks/partition.py).
_ROUND = 0.8
# Bins along each axis; even, so that the middle is a border. More bins mean more points in every Lloyd
# step, fewer move the separator (benchmarks/partition.py, 2-D from 1,000,000 cells, 3-D from 100,000).
_BINS_2D, _BINS_3D = 32, 12
_BIN_TIE = 1e-4  # bin widths: points this close to a border lie below it
# Number of axes over the half circle, if no axis stands out in 2-D: more find better cuts, and each costs
# Lloyd steps (benchmarks/partition.py).
_AXES = 8
_COS, _SIN = np.cos(np.pi / _AXES), np.sin(np.pi / _AXES)
# Number of cells above which a sample suffices. Samples of smaller pieces made less round parts, and saved
# less than a hundredth of the time (benchmarks/partition.py).
_MANY = 4096
LANES = 16
"""Number of points per loop round: points with weight 0 fill the last round, for full vector speed.

Fewer leave vector registers unused, more add weightless points to small pieces (benchmarks/partition.py).
"""
_FLAT = 1e-6
"""Fraction of (Σ m r²)^1.5 / (Σ m)^0.5 below which a third moment counts as 0, by symmetry. It is larger than
rounding, also far from the origin."""


class Means(NamedTuple):
    """Workspace of a 2-means split: weighted points, means on a grid, and trial directions.

    ``points (4, m)`` are coordinates and weights, ``means (4, bins)`` the grid means, with their ``sums``;
    ``axes (8, 3)`` are trial directions, ``frame`` and ``matrix (3, 3)`` workspace for them; ``chosen`` are
    the sampled cells, ``placing (5,)`` the origin, unit and number of points, and ``heights (m,)`` the
    heights of the cells above the separator.
    """

    points: Any
    sums: Any
    means: Any
    axes: Any
    frame: Any
    matrix: Any
    chosen: Any
    placing: Any
    heights: Any


@helper(allocates=True)
def new_means(m):
    """Allocate the workspace for sets with up to m points."""
    bins = max(_BINS_2D**2, _BINS_3D**3)
    return Means(
        np.zeros((4, m + LANES)),
        np.empty((bins, 4)),
        np.zeros((4, bins)),
        np.empty((_AXES, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty(m + 1, np.int32),
        np.empty(5),
        np.empty(m),
    )


@helper
def _select_sample(cells, lo, hi, sample, sampled_cells):
    """Write the sampled cells in a large piece to ``sampled_cells``, and return their number."""
    m = np.uint64(0)
    for k in range(np.uint64(lo), np.uint64(hi)):
        i = np.uint32(cells[k])
        sampled_cells[m] = i  # no branch: it would be mispredicted
        m += np.uint64(sample[i] > 0)
    return np.int64(m)


@helper
def _gather(cells, lo, n, centroids, weights, units, points):
    """Write centroids relative to the first, and weights, to ``points``, and return their extent."""
    x, y, z, w = points[0], points[1], points[2], points[3]
    solid, first, start = centroids.shape[1] > 2, cells[lo], np.uint64(lo)
    length, weight = units.length, units.weight
    x0, y0, z0 = centroids[first, 0], centroids[first, 1], centroids[first, centroids.shape[1] - 1]
    x1, y1, z1, x2, y2, z2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        i = np.uint32(cells[start + np.uint64(k)])
        a, b = (centroids[i, 0] - x0) * length, (centroids[i, 1] - y0) * length
        x[k], y[k], w[k] = a, b, weights[i] * weight
        x1, x2, y1, y2 = min(x1, a), max(x2, a), min(y1, b), max(y2, b)
        if solid:
            c = (centroids[i, 2] - z0) * length
            z[k], z1, z2 = c, min(z1, c), max(z2, c)
    return max(max(x2 - x1, y2 - y1), z2 - z1)


@helper(reorder_sums=True)
def _first_moments(x, y, z, w, n):
    """Return total weight and first moments of the points."""
    total, cx, cy, cz = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        total += w[i]
        cx += w[i] * x[i]
        cy += w[i] * y[i]
        cz += w[i] * z[i]
    return total, cx, cy, cz


@helper
def round_to_lanes(n):
    """Round a point count up to a multiple of the vector length ``LANES``."""
    return (n + LANES - 1) // LANES * LANES


@helper
def load_points(cells, lo, hi, centroids, weights, units, work):
    """Write the centroids of ``cells[lo:hi]`` to ``work``, centred and scaled to extent 1, with weights.

    ``units``: see ``piece_splits.units_of``. A large piece is replaced by a sample, if representative.
    Returns the largest centroid extent along an axis, in the original unit.
    """
    points, sampled_cells, placing, boost = work.points, work.chosen, work.placing, 1.0
    # 1. Sample a large piece, weighted to represent all cells, unless the sample has too few cells.
    if hi - lo > _MANY and len(units.sample) > 0:
        m = _select_sample(cells, lo, hi, units.sample, sampled_cells)
        if 4 * piece_splits.SAMPLED * m > hi - lo:
            cells, lo, hi, boost = sampled_cells, 0, m, float(piece_splits.SAMPLED)
    n, d, first = hi - lo, centroids.shape[1], cells[lo]
    x, y, z, w = points[0], points[1], points[2], points[3]
    # 2. Points relative to the first cell; heavy sample cells represent only themselves.
    extent = _gather(cells, lo, n, centroids, weights, units, points)
    if boost > 1.0:
        for k in range(n):
            w[k] *= boost if units.sample[np.uint32(cells[k])] < 2 else 1.0
    # 3. Move the centre of mass to the origin, and scale to extent 1.
    total, cx, cy, cz = _first_moments(x, y, z, w, n)
    if not total > 0.0:  # no weight: equal weights
        for k in range(n):
            w[k] = 1.0
        total, cx, cy, cz = _first_moments(x, y, z, w, n)
    cx, cy, cz = cx / total, cy / total, cz / total
    scale = 1.0 / extent if extent > 0.0 else 1.0
    for k in range(n):
        x[k] = (x[k] - cx) * scale
        y[k] = (y[k] - cy) * scale
    if d == 3:
        for k in range(n):
            z[k] = (z[k] - cz) * scale
    # 4. Pad with weightless points to a full round of vector registers, and store the origin.
    for k in range(n, round_to_lanes(n)):
        x[k], y[k], z[k], w[k] = 0.0, 0.0, 0.0, 0.0
    length = units.length
    placing[0], placing[1] = centroids[first, 0] + cx / length, centroids[first, 1] + cy / length
    placing[2] = centroids[first, d - 1] + cz / length
    placing[3], placing[4] = scale * length, n
    return extent / length


@helper(reorder_sums=True)
def moments(x, y, z, w, n):
    """Return total weight, second moments, and third moment Σ m |r|² r of the points."""
    a, xx, xy, xz, yy, yz, zz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        u, v, t, m = x[i], y[i], z[i], w[i]
        mu, mv, mt = m * u, m * v, m * t
        square = u * u + v * v + t * t
        a += m
        xx += mu * u
        xy += mu * v
        xz += mu * t
        yy += mv * v
        yz += mv * t
        zz += mt * t
        tx += mu * square
        ty += mv * square
        tz += mt * square
    return a, xx, xy, xz, yy, yz, zz, tx, ty, tz


@helper(reorder_sums=True)
def _fourth(x, y, w, n):
    """Return real and imaginary part of the fourth moment ⟨(x + iy)⁴⟩ in 2-D."""
    re, im = 0.0, 0.0
    for i in range(n):
        p, q = x[i] * x[i] - y[i] * y[i], 2.0 * x[i] * y[i]
        re += w[i] * (p * p - q * q)
        im += w[i] * 2.0 * p * q
    return re, im


@helper
def _half_angle(x, y):
    """Return cosine and sine of half the angle of (x, y), without trigonometric functions.

    The half angle is in −π/2..π/2.
    """
    length = np.sqrt(x * x + y * y)
    if not length > 0.0:
        return 1.0, 0.0
    # cos²(φ/2) = (1 + cos φ)/2, and sin φ = 2 sin(φ/2) cos(φ/2): this avoids roots of small differences.
    larger = np.sqrt(0.5 * (1.0 + abs(x) / length))
    smaller = 0.5 * abs(y) / (length * larger)
    cos, sin = (larger, smaller) if x >= 0.0 else (smaller, larger)
    return cos, sin if y >= 0.0 else -sin


@helper
def _planar_axes(x, y, w, n, second, frame, axes):
    """Write one or eight trial directions in 2-D to ``axes``, and return their number.

    ``frame`` receives the first direction and its normal. ``second`` are the results of :func:`moments`.
    """
    xx, xy, yy = second[1], second[2], second[4]
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    count = 1
    if mean - radius > _ROUND * (mean + radius):
        # No axis stands out: try eight, aligned with the fourth moment, which distinguishes even the axes
        # of a square. Its direction is a quarter of the angle of (re, im).
        re, im = _fourth(x, y, w, n)
        count = _AXES
        cos, sin = _half_angle(re, im)
    else:
        # Principal axis: half the angle of ((xx − yy)/2, xy).
        cos, sin = 0.5 * (xx - yy), xy
    cos, sin = _half_angle(cos, sin)
    axes[0, 0], axes[0, 1], axes[0, 2] = cos, sin, 0.0
    for c in range(1, count):
        p, q = axes[c - 1, 0], axes[c - 1, 1]
        axes[c, 0], axes[c, 1], axes[c, 2] = _COS * p - _SIN * q, _SIN * p + _COS * q, 0.0
    # Frame of the grid: the first axis, and its normal.
    for k in range(3):
        frame[0, k] = axes[0, k]
        frame[1, k], frame[2, k] = 0.0, 0.0
    frame[1, 0], frame[1, 1] = -axes[0, 1], axes[0, 0]
    return count


@helper
def _spatial_axes(second, a, frame, axes):
    """Write three principal and four diagonal directions to ``axes``, and return their number.

    ``second`` are the results of :func:`moments`, ``a (3, 3)`` is workspace.
    """
    # 1. Eigenvectors of the second moments; the eigenvalues remain on the diagonal.
    a[0, 0], a[0, 1], a[0, 2] = second[1], second[2], second[3]
    a[1, 0], a[1, 1], a[1, 2] = second[2], second[4], second[5]
    a[2, 0], a[2, 1], a[2, 2] = second[3], second[5], second[6]
    piece_frames.diagonalise(a, frame)
    # 2. The longest axis first, then the others in cyclic order.
    most = 0
    for p in range(3):
        most = p if a[p, p] > a[most, most] else most
    for p in range(3):
        for k in range(3):
            axes[p, k] = frame[(most + p) % 3, k]
    # 3. Diagonals of the cube spanned by the axes, one for each pair of opposite corners.
    for c in range(4):
        one, other = 1.0 - 2.0 * (c >> 1), 1.0 - 2.0 * (c & 1)
        for k in range(3):
            axes[3 + c, k] = (axes[0, k] + one * axes[1, k] + other * axes[2, k]) / np.sqrt(3.0)
    return 7


@helper
def _orient(row, third, bound):
    """Reverse a direction, unless the third moment along it is positive or vanishes."""
    if row[0] * third[0] + row[1] * third[1] + row[2] * third[2] < -bound:
        for k in range(3):
            row[k] = -row[k]


@helper(reorder_sums=True)
def _reach(x, y, z, n, axis):
    """Return the largest distance of the points from the centre, along an axis."""
    a, b, c = axis[0], axis[1], axis[2]
    low, high = 0.0, 0.0
    for i in range(n):
        along = a * x[i] + b * y[i] + c * z[i]
        low = along if along < low else low
        high = along if along > high else high
    return max(high, -low)


@helper
def bin_points(x, y, z, w, n, frame, planar, sums, means):
    """Replace points by their means in grid cells along ``frame``, and return the number of means.

    ``means (4, bins)`` are coordinates and weights, ``sums (bins, 4)`` is workspace. The unit rows of
    ``frame`` are multiplied by bins per length.
    """
    steps, layers = (_BINS_2D, 1) if planar else (_BINS_3D, _BINS_3D)
    count = steps * steps * layers
    # 1. A square or cube about the centre that contains all points, with equally many bins each way.
    reach = 1e-30
    for k in range(2 if planar else 3):
        reach = max(reach, _reach(x, y, z, n, frame[k]))
    for b in range(count):
        for k in range(4):
            sums[b, k] = 0.0
    middle = 0.5 * steps - _BIN_TIE
    for k in range(3):
        for j in range(3):
            frame[k, j] *= 0.5 * steps / reach  # from now on in bins
    # 2. Weight and first moments of each bin.
    for i in range(n):
        bin_index = 0
        for k in range(2 if planar else 3):
            position = frame[k, 0] * x[i] + frame[k, 1] * y[i] + frame[k, 2] * z[i] + middle
            bin_index = bin_index * steps + min(max(np.int64(position), 0), steps - 1)  # type: ignore[operator]
        sums[bin_index, 0] += w[i] * x[i]
        sums[bin_index, 1] += w[i] * y[i]
        sums[bin_index, 2] += w[i] * z[i]
        sums[bin_index, 3] += w[i]
    # 3. Means of all bins with positive weight.
    m = 0
    for b in range(count):
        if sums[b, 3] > 0.0:
            for k in range(3):
                means[k, m] = sums[b, k] / sums[b, 3]
            means[3, m] = sums[b, 3]
            m += 1
    return m


@helper
def axes_to_try(x, y, w, n, second, planar, a, frame, axes):
    """Write trial directions to ``axes``, and return their number.

    ``frame`` receives an orthogonal frame. All directions point to where the third moment is positive, so
    that they move with the points.
    """
    count = _planar_axes(x, y, w, n, second, frame, axes) if planar else _spatial_axes(second, a, frame, axes)
    inertia, third = second[1] + second[4] + second[6], second[7:]
    bound = _FLAT * inertia * np.sqrt(inertia / second[0])
    for c in range(count):
        _orient(axes[c], third, bound)
    for c in range(3):
        _orient(frame[c], third, bound)
    return count
