"""Split point sets by 2-means: Lloyd's iteration, started from several axes."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper
from agglo_kmeans.points import axes_to_try, bin_points, moments, round_to_lanes

_TIE = 1e-7  # relative to the size: points this close to the separator are on side 0, beyond rounding
_EQUAL = 1e-9  # relative: inertias that differ by less are equal, and the first axis decides
_ITERATIONS = np.int64(100)  # maximum number of Lloyd steps: they end when nothing changes
# Lloyd steps from each axis before the best continues: more choose the axis better, and each reads all points
# (benchmarks/partition.py).
_TRIED = np.int64(2)
# Number of points above which they are binned: a step then takes constant time, for a separator that may be
# off by a fraction of a bin (benchmarks/partition.py --meshes tetrahedra, with 100,000 cells).
_MANY = 16_384


@helper(reorder_sums=True)
def _side_sums(x, y, z, w, n, planar, nx, ny, nz, t):
    """Return total weight and first moments of the points with normal · point > t."""
    # Points on the other side are added with weight 0: without branches the loops vectorise.
    a, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    if planar:
        for i in range(n):
            m = w[i] if nx * x[i] + ny * y[i] > t else 0.0
            a += m
            sx += m * x[i]
            sy += m * y[i]
    else:
        for i in range(n):
            m = w[i] if nx * x[i] + ny * y[i] + nz * z[i] > t else 0.0
            a += m
            sx += m * x[i]
            sy += m * y[i]
            sz += m * z[i]
    return a, sx, sy, sz


@helper
def _lloyd(x, y, z, w, n, planar, total, tie, plane, steps):
    """Take at most ``steps`` Lloyd steps for two means of centred points, from a separating plane.

    For centred points both means lie on one line through the centre, so the separator follows from the sums
    on one side. Returns the between-cluster inertia (−1 if a side is empty) and the separator, its normal
    with any length.
    """
    inertia, nx, ny, nz, t = plane
    before_a, before_square = -1.0, -1.0
    for _ in range(steps):
        # 1. Weight a and first moment s of one side; the other side has total − a and −s. Without weight on
        # both sides, or with coinciding means, there is no split.
        a, sx, sy, sz = _side_sums(x, y, z, w, n, planar, nx, ny, nz, t)
        b, square = total - a, sx * sx + sy * sy + sz * sz
        if not (a > 0.0 and b > 1e-12 * total and square > 0.0):
            return -1.0, nx, ny, nz, t
        # 2. The means are s / a and −s / b: inertia a |s/a|² + b |s/b|² = |s|² (a + b) / (a b).
        share = square / (a * b)  # s² / (a b): divisions and roots cost more than all else
        inertia = share * total
        # Equal sums in successive steps: the sides have not changed.
        if a == before_a and square == before_square:
            break
        before_a, before_square = a, square
        # 3. The plane halfway between the means, with normal s: t = s · (s/a − s/b) / 2. The tie is a
        # length, so it is multiplied by |s|.
        nx, ny, nz = sx, sy, sz
        t = 0.5 * share * (b - a) + tie * np.sqrt(square)
    return inertia, nx, ny, nz, t


@helper
def separator(work, planar):
    """Return the plane normal · point = t that separates the two clusters of the best 2-means split.

    Returns its inertia, not positive without a split, the normal (3 numbers) and t.
    """
    points, sums, means, axes, frame, matrix, _, placing, _ = work
    x, y, z, w = points[0], points[1], points[2], points[3]
    n = round_to_lanes(np.int64(placing[4]))
    # 1. Starting planes: normal to the principal axis, or to several axes if none stands out.
    second = moments(x, y, z, w, n)
    total, xx, yy, zz = second[0], second[1], second[4], second[6]
    tie = _TIE * np.sqrt((xx + yy + zz) / total)
    count = axes_to_try(x, y, w, n, second, planar, matrix, frame, axes)
    # 2. Replace very many points by their means in each grid cell.
    if n > _MANY:
        n = bin_points(x, y, z, w, n, frame, planar, sums, means)
        x, y, z, w = means[0], means[1], means[2], means[3]
    # 3. A few Lloyd steps from each plane; the plane with the largest inertia between the sides continues.
    best = (-1.0, 1.0, 0.0, 0.0, tie)
    for c in range(count):
        start = (0.0, axes[c, 0], axes[c, 1], axes[c, 2], tie)
        trial = _lloyd(x, y, z, w, n, planar, total, tie, start, _TRIED if count > 1 else _ITERATIONS)
        # Better by more than rounding: among equally good axes the first wins.
        if trial[0] > best[0] * (1.0 + _EQUAL):
            best = trial
    if count > 1 and best[0] > 0.0:
        best = _lloyd(x, y, z, w, n, planar, total, tie, best, _ITERATIONS)
    inertia, nx, ny, nz, t = best
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return inertia, nx * scale, ny * scale, nz * scale, t * scale
