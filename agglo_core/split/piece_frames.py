"""Centred cell centroids of a mesh piece, and its principal axes."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper
from agglo_core.compiled.frames import centre_points, planar_frame

# Ratio of second moments above which principal axes are ill-defined, and fourth moments define them. A larger
# value leaves nearly round pieces with arbitrary axes (benchmarks/solid_parts.py).
_ISOTROPIC = 0.9
_TURNS = 6  # maximum number of rounds over the three planes (benchmarks/solid_parts.py)
_TIE = 1e-9  # smallest rotation angle in radians, and relative tolerance between second moments


class Points(NamedTuple):
    """Centroids ``(3, m)`` of a piece relative to its centre of mass, weight shares ``(m,)``, and scales.

    The scales ``(3,)`` are the results of ``centre_points`` (``compiled/frames.py``): one over the measure of
    a typical section, the inertia, and its weight relative to the cut.
    """

    local: Any
    shares: Any
    scales: Any


@helper(allocates=True)
def new_points(m):
    """Allocate ``Points`` for pieces with at most m cells."""
    return Points(np.zeros((3, m)), np.empty(m), np.empty(3))


@helper
def load_piece(graph, pieces, lo, hi, work):
    """Copy a piece's centred centroids to ``work.points``, and return their largest extent along an axis.

    The piece is ``cells[lo:hi]``. This is the ``load`` of ``piece_driver.split_pieces_by``. The extent refers
    to the centroids.
    """
    cells, centroids, weights = pieces.cells, graph.centroids, graph.weights
    local, shares, scales = work.points
    # 1. Weights, and centroids relative to the first centroid, which preserves the digits of small pieces far
    #    from the origin.
    n, first, start, total = hi - lo, cells[lo], np.uint64(lo), 0.0
    x, y, z, last = centroids[first, 0], centroids[first, 1], 0.0, centroids.shape[1] - 1
    x0, x1, y0, y1, z0, z1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(np.uint64(n)):
        i = np.uint32(cells[start + k])
        a, b, w = centroids[i, 0] - x, centroids[i, 1] - y, weights[i]
        local[0, k], local[1, k], shares[k] = a, b, w
        total += w
        x0, x1, y0, y1 = min(x0, a), max(x1, a), min(y0, b), max(y1, b)
    if last > 1:
        z = centroids[first, last]
        for k in range(np.uint64(n)):
            c = centroids[np.uint32(cells[start + k]), last] - z
            local[2, k] = c
            z0, z1 = min(z0, c), max(z1, c)
    # 2. Centre the points and normalise the weights. In 2-D the third row is always 0.
    extent = max(max(x1 - x0, y1 - y0), z1 - z0)
    scales[0], scales[1], scales[2] = centre_points(n, centroids.shape[1], local, shares, total, total)
    return extent


@helper(reorder_sums=True)
def _second_moments(n, x, y, z, shares):
    """Return the second moments xx, xy, xz, yy, yz, zz of centred points."""
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        xx += shares[i] * x[i] * x[i]
        xy += shares[i] * x[i] * y[i]
        xz += shares[i] * x[i] * z[i]
        yy += shares[i] * y[i] * y[i]
        yz += shares[i] * y[i] * z[i]
        zz += shares[i] * z[i] * z[i]
    return xx, xy, xz, yy, yz, zz


@helper(reorder_sums=True)
def _fourth_moment(n, x, y, z, shares, frame, i, j):
    """Return the real and imaginary part of ⟨(p + iq)⁴⟩, with coordinates p and q along two axes."""
    a, b, c, d, e, f = frame[i, 0], frame[i, 1], frame[i, 2], frame[j, 0], frame[j, 1], frame[j, 2]
    real, imaginary = 0.0, 0.0
    for k in range(n):
        p, q = a * x[k] + b * y[k] + c * z[k], d * x[k] + e * y[k] + f * z[k]
        u, v = p * p - q * q, 2.0 * p * q
        real += shares[k] * (u * u - v * v)
        imaginary += shares[k] * 2.0 * u * v
    return real, imaginary


@helper(reorder_sums=True)
def _moments_along(n, x, y, z, shares, a, b, c):
    """Return the second and third moment along the direction (a, b, c)."""
    second, third = 0.0, 0.0
    for k in range(n):
        p = a * x[k] + b * y[k] + c * z[k]
        second += shares[k] * p * p
        third += shares[k] * p * p * p
    return second, third


@helper
def _turn(rows, i, j, angle):
    """Rotate two rows of a matrix by an angle within their plane."""
    c, s = np.cos(angle), np.sin(angle)
    for k in range(3):
        p, q = rows[i, k], rows[j, k]
        rows[i, k], rows[j, k] = c * p + s * q, c * q - s * p


@helper
def diagonalise(a, frame):
    """Write eigenvectors of the symmetric matrix ``a (3, 3)`` to the rows of ``frame`` (Jacobi's method).

    ``a`` is overwritten: its diagonal contains the eigenvalues, unsorted.
    """
    for i in range(3):
        for j in range(3):
            frame[i, j] = 1.0 if i == j else 0.0
    # Sweeps over the off-diagonal entries converge quadratically: eight suffice. Entries at rounding level
    # are skipped.
    for _ in range(8):
        for p in range(2):
            for q in range(p + 1, 3):
                if abs(a[p, q]) <= 1e-15 * (abs(a[p, p]) + abs(a[q, q])):
                    continue
                # Rotate in the plane of axes p and q from both sides, so that a[p, q] becomes 0, and rotate
                # the frame.
                angle = 0.5 * np.arctan2(2.0 * a[p, q], a[p, p] - a[q, q])
                _turn(a, p, q, angle)
                _turn(a.T, p, q, angle)
                _turn(frame, p, q, angle)


@helper
def _turn_to_least_fourth(n, local, shares, values, frame):
    """Rotate axes with nearly equal second moments so that their fourth moments are least.

    The axes of a cube become parallel to its sides.
    """
    for _ in range(_TURNS):
        largest = 0.0
        for i in range(2):
            for j in range(i + 1, 3):
                if min(values[i, i], values[j, j]) < _ISOTROPIC * max(values[i, i], values[j, j]):
                    continue
                # With p and q along the axes, ⟨p⁴ + q⁴⟩ is ¾ ⟨r⁴⟩ + ¼ Re ⟨(p + iq)⁴⟩. A rotation by θ
                # multiplies the latter by e^(−4iθ), and its real part is least where it is negative and real.
                real, imaginary = _fourth_moment(n, local[0], local[1], local[2], shares, frame, i, j)
                angle = 0.25 * np.arctan2(-imaginary, -real)
                _turn(frame, i, j, angle)
                largest = max(largest, abs(angle))
        if largest < _TIE:
            break


@helper(allocates=True)
def principal_frame(n, planar, local, shares, frame):
    """Write the principal axes to ``frame (3, 3)``, longest first, each with a non-negative third moment.

    Axes with nearly equal second moments are rotated to the least fourth moments.
    """
    # 1. Principal axes. In 2-D planar_frame also treats squares.
    x, y, z = local[0], local[1], local[2]
    if planar:
        cos, sin, _, _, _ = planar_frame(n, x, y, shares)
        frame[0, 0], frame[0, 1], frame[0, 2] = cos, sin, 0.0
        frame[1, 0], frame[1, 1], frame[1, 2] = -sin, cos, 0.0
        frame[2, 0], frame[2, 1], frame[2, 2] = 0.0, 0.0, 1.0
    else:
        xx, xy, xz, yy, yz, zz = _second_moments(n, x, y, z, shares)
        values = np.empty((3, 3))
        values[0, 0], values[0, 1], values[0, 2] = xx, xy, xz
        values[1, 0], values[1, 1], values[1, 2] = xy, yy, yz
        values[2, 0], values[2, 1], values[2, 2] = xz, yz, zz
        diagonalise(values, frame)
        _turn_to_least_fourth(n, local, shares, values, frame)
    # 2. Point each axis to its heavier tail, where the third moment is positive.
    seconds = np.empty(3)
    for i in range(3):
        seconds[i], third = _moments_along(n, x, y, z, shares, frame[i, 0], frame[i, 1], frame[i, 2])
        if third < 0.0:
            for k in range(3):
                frame[i, k] = -frame[i, k]
    # 3. Sort the axes, longest first, by a stable bubble sort.
    for i in range(2):
        for j in range(2 - i):
            if seconds[j + 1] > seconds[j] * (1.0 + _TIE):
                seconds[j], seconds[j + 1] = seconds[j + 1], seconds[j]
                for k in range(3):
                    frame[j, k], frame[j + 1, k] = frame[j + 1, k], frame[j, k]
