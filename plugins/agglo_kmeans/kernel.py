"""The kernel of batched 2-means: every block of a graph, several starting axes each."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel

__all__ = ["two_means"]

_TIE = 1e-8  # of the block's size: a cell this close to the separator is on side 0
_ROUND = 0.8  # ratio of principal moments above which no axis stands out
_ITERATIONS = 100


@helper(reorder_sums=True)
def _side_sums(x, y, z, w, n, planar, nx, ny, nz, t):
    """Weight and first moments of the points with normal · point > t."""
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
def _lloyd(x, y, z, w, n, planar, total, tie, nx, ny, nz):
    """Lloyd's iteration from the plane through the centre; the points are centred.

    Then both means lie on one line through the centre, so the separator follows from the sums of one
    side. Returns the between-cluster inertia (−1 if a side is empty) and the separator.
    """
    t, inertia = tie, -1.0
    before_a, before_s = -1.0, -1.0
    for _ in range(_ITERATIONS):
        a, sx, sy, sz = _side_sums(x, y, z, w, n, planar, nx, ny, nz, t)
        b = total - a
        s = np.sqrt(sx * sx + sy * sy + sz * sz)
        if not (a > 0.0 and b > 1e-14 * total and s > 0.0):
            return -1.0, nx, ny, nz, t
        inertia = s * s * (1.0 / a + 1.0 / b)
        if a == before_a and s == before_s and nx * sx + ny * sy + nz * sz >= s * (1.0 - 1e-15):
            break
        before_a, before_s = a, s
        nx, ny, nz = sx / s, sy / s, sz / s
        t = 0.5 * s * (1.0 / a - 1.0 / b) + tie
    return inertia, nx, ny, nz, t


@helper
def _planar_axes(x, y, w, n, axes):
    """Fill ``axes`` with the directions to try in 2-D; return how many."""
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(n):
        xx += w[i] * x[i] * x[i]
        xy += w[i] * x[i] * y[i]
        yy += w[i] * y[i] * y[i]
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    count, angle = 1, 0.5 * np.arctan2(2.0 * xy, xx - yy)
    if mean - radius > _ROUND * (mean + radius):
        # no axis stands out: eight, from the orientation of the fourth moment, which a square has
        re, im = 0.0, 0.0
        for i in range(n):
            u, v = x[i] * x[i] - y[i] * y[i], 2.0 * x[i] * y[i]
            re += w[i] * (u * u - v * v)
            im += w[i] * 2.0 * u * v
        count, angle = 8, 0.25 * np.arctan2(im, re)
    for c in range(count):
        axes[c, 0], axes[c, 1], axes[c, 2] = np.cos(angle + c * np.pi / 8), np.sin(angle + c * np.pi / 8), 0.0
    return count


@kernel
def two_means(offsets, centroids, weights, given_axes):
    """Side of each node: the 2-means split of its block of least energy over the starting axes.

    ``given_axes (B, C, 3)`` are the axes to try; with C = 0 (2-D) they are found here.
    """
    n_blocks, d = len(offsets) - 1, centroids.shape[1]
    planar = d == 2
    largest = 0
    for b in range(n_blocks):
        largest = max(largest, offsets[b + 1] - offsets[b])
    x, y, z, w = np.empty(largest), np.empty(largest), np.zeros(largest), np.empty(largest)
    axes = np.empty((max(8, given_axes.shape[1]), 3))
    sides = np.zeros(len(weights), np.int64)
    for b in range(n_blocks):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        total, cx, cy, cz = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            w[i] = weights[start + i]
            total += w[i]
        if not total > 0.0:
            total = float(n)
            for i in range(n):
                w[i] = 1.0
        for i in range(n):
            cx += w[i] * (centroids[start + i, 0] - centroids[start, 0])
            cy += w[i] * (centroids[start + i, 1] - centroids[start, 1])
            if not planar:
                cz += w[i] * (centroids[start + i, 2] - centroids[start, 2])
        cx, cy, cz = cx / total, cy / total, cz / total
        size = 0.0
        for i in range(n):
            x[i] = centroids[start + i, 0] - centroids[start, 0] - cx
            y[i] = centroids[start + i, 1] - centroids[start, 1] - cy
            if not planar:
                z[i] = centroids[start + i, 2] - centroids[start, 2] - cz
            size += w[i] * (x[i] * x[i] + y[i] * y[i] + z[i] * z[i])
        tie = _TIE * np.sqrt(size / total)
        if planar:
            count = _planar_axes(x, y, w, n, axes)
        else:
            count = given_axes.shape[1]
            for c in range(count):
                for k in range(3):
                    axes[c, k] = given_axes[b, c, k]
        best, nx, ny, nz, t = -1.0, 1.0, 0.0, 0.0, 0.0
        for c in range(count):
            trial = _lloyd(x, y, z, w, n, planar, total, tie, axes[c, 0], axes[c, 1], axes[c, 2])
            if trial[0] > best + 1e-9 * abs(best):
                best, nx, ny, nz, t = trial
        ones = 0
        for i in range(n):
            if best > 0.0 and nx * x[i] + ny * y[i] + nz * z[i] > t:
                sides[start + i] = 1
                ones += 1
        if n > 1 and (ones == 0 or ones == n):  # coincident centroids: any halving will do
            for i in range(n):
                sides[start + i] = 1 if 2 * i >= n else 0
    return sides
