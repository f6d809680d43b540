"""Principal axes of point sets, bitwise equal for graph blocks and for pieces in a cell list.

Sums are taken in a fixed order. For a symmetric cloud, rounding decides the order and direction of equal
axes. Callers that need equal parts from a graph block and from a list slice must therefore call these
functions.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.split.piece_frames import diagonalise

# Ratio of second moments above which principal axes are ill-defined, and fourth moments define them. A larger
# value leaves nearly round blocks with arbitrary axes (benchmarks/roads.py, bisector inertial).
_ISOTROPIC = 0.9
_TURNS = 6  # maximum number of rounds over the three planes, in 3-D (benchmarks/solid_parts.py)
_TURNED = 1e-9  # rotation angle in radians below which further rotations are rounding
_EPS = 2.0**-53  # unit roundoff, as in LAPACK


class FramedPoints(NamedTuple):
    """Points ``(3, m)``, weight shares ``(m,)``, and coordinates ``(3, m)`` in the ``frame (3, 3)``.

    The ``moments (3, 3)`` are workspace, ``values (3,)`` the second moments along the axes.
    """

    local: Any
    shares: Any
    along: Any
    frame: Any
    moments: Any
    values: Any


@helper(allocates=True)
def new_framed_points(m):
    """Allocate ``FramedPoints`` for up to m points."""
    return FramedPoints(
        np.zeros((3, m)), np.empty(m), np.zeros((3, m)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    )


@helper
def centre_in_order(n, d, local, shares):
    """Normalise the weights in ``shares``, and centre the points ``local`` at their centre of mass.

    Without weight all points count equally.
    """
    total, whole, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        total += shares[i]
    for i in range(n):
        share = shares[i] / total if total > 0.0 else 1.0 / n
        shares[i] = share
        whole += share
        x += share * local[0, i]
        y += share * local[1, i]
        z += share * local[2, i]
    # The shares add up to 1 except for rounding, which is divided out.
    x, y, z = x / whole, y / whole, z / whole
    for i in range(n):
        local[0, i] -= x
        local[1, i] -= y
    for i in range(n if d == 3 else 0):
        local[2, i] -= z


@helper
def _planar_axes(a, b, c, frame):
    """Write the axes of a symmetric 2×2 matrix to ``frame``, longer axis first.

    The matrix is (a, b; b, c). Returns the moments along the axes. The steps follow LAPACK's dsteqr and
    dlaev2. For equal moments this keeps LAPACK's choice, which blocks get from ``numpy.linalg.eigh``.
    """
    # 1. dsteqr: an off-diagonal entry at rounding level counts as 0, and the axes are the coordinate axes.
    cos, sin, first, second = 1.0, 0.0, a, c
    if abs(b) > np.sqrt(abs(a)) * np.sqrt(abs(c)) * _EPS:
        # 2. dlaev2: eigenvalues. As a + c > 0, the first is the larger one. root is √((a − c)² + 4 b²)
        #    without overflow. The second follows from the determinant, without cancellation.
        difference, double_b = a - c, b + b
        abs_difference, abs_double_b = abs(difference), abs(double_b)
        root = abs_double_b * np.sqrt(2.0)
        if abs_difference > abs_double_b:
            root = abs_difference * np.sqrt(1.0 + (abs_double_b / abs_difference) ** 2)
        elif abs_difference < abs_double_b:
            root = abs_double_b * np.sqrt(1.0 + (abs_difference / abs_double_b) ** 2)
        first = 0.5 * (a + c + root)
        second = (max(a, c) / first) * min(a, c) - (b / first) * b
        # 3. Its unit eigenvector (cos, sin), from the component ratio that is at most 1.
        slope = difference + root if difference >= 0.0 else difference - root
        if abs(slope) > abs_double_b:
            ratio = -double_b / slope
            sin = 1.0 / np.sqrt(1.0 + ratio * ratio)
            cos = ratio * sin
        else:
            ratio = -slope / double_b
            cos = 1.0 / np.sqrt(1.0 + ratio * ratio)
            sin = ratio * cos
        if difference >= 0.0:
            cos, sin = -sin, cos
    # 4. The larger moment first. For equal moments the second, because eigh sorts in ascending order and is
    #    read backwards.
    if second < first:
        frame[0, 0], frame[0, 1], frame[1, 0], frame[1, 1] = cos, sin, -sin, cos
        return first, second
    frame[0, 0], frame[0, 1], frame[1, 0], frame[1, 1] = -sin, cos, cos, sin
    return second, first


@helper
def _planar_moments(n, x, y, shares):
    """Return the second moments xx, yx, yy of centred points, summed in order."""
    xx, yx, yy = 0.0, 0.0, 0.0
    for k in range(n):
        xx += shares[k] * x[k] * x[k]
        yx += shares[k] * y[k] * x[k]
        yy += shares[k] * y[k] * y[k]
    return xx, yx, yy


@helper
def _spatial_moments(n, local, shares, moments):
    """Write the second moments of centred points, summed in order, to ``moments (3, 3)``."""
    for j in range(3):
        for i in range(j + 1):
            total = 0.0
            for k in range(n):
                total += shares[k] * local[j, k] * local[i, k]
            moments[i, j] = moments[j, i] = total


@helper
def _axes(n, d, local, shares, moments, frame, values):
    """Write the principal axes, longest first, to ``frame``, and their moments to ``values``."""
    if d == 2:
        xx, yx, yy = _planar_moments(n, local[0], local[1], shares)
        values[0], values[1] = _planar_axes(xx, yx, yy, frame)
        return
    _spatial_moments(n, local, shares, moments)
    diagonalise(moments, frame)
    for k in range(3):
        values[k] = moments[k, k]
    # Longest first, by a stable bubble sort.
    for i in range(2):
        for j in range(2 - i):
            if values[j + 1] > values[j]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    frame[j, k], frame[j + 1, k] = frame[j + 1, k], frame[j, k]


@helper
def _turn_plane(n, d, shares, frame, i, j, local):
    """Rotate axes i and j in their plane to the least fourth moments, and return the angle."""
    # ⟨(x + iy)⁴⟩ = real_mean + i imaginary_mean. A rotation by θ multiplies it by e^(−4iθ), and
    # ⟨x⁴ + y⁴⟩ = ¾ ⟨r⁴⟩ + ¼ Re of it is least where it is negative and real.
    real_mean, imaginary_mean = 0.0, 0.0
    for k in range(n):
        x = frame[i, 0] * local[0, k] + frame[i, 1] * local[1, k] + frame[i, 2] * local[2, k]
        y = frame[j, 0] * local[0, k] + frame[j, 1] * local[1, k] + frame[j, 2] * local[2, k]
        real, imaginary = x * x - y * y, 2.0 * (x * y)
        real_mean += shares[k] * (real * real - imaginary * imaginary)
        imaginary_mean += shares[k] * (2.0 * (real * imaginary))
    angle = np.arctan2(-imaginary_mean, -real_mean) / 4
    cos, sin = np.cos(angle), np.sin(angle)
    for c in range(d):
        p, q = frame[i, c], frame[j, c]
        frame[i, c], frame[j, c] = cos * p + sin * q, cos * q - sin * p
    return abs(angle)


@helper
def _moments_along(n, local, shares, a, b, c, coords):
    """Write coordinates along the direction (a, b, c), and return their second and third moment."""
    second, third = 0.0, 0.0
    for k in range(n):
        x = a * local[0, k] + b * local[1, k] + c * local[2, k]
        coords[k] = x
        second += shares[k] * (x * x)
        third += shares[k] * (x * x * x)
    return second, third


@helper
def _order_axes(n, d, local, shares, frame, coords, values):
    """Sort the axes by second moment, largest first, and orient each so that its third moment is positive."""
    # 1. Coordinates and second moments along each axis. The axis points to where the third moment is
    #    positive.
    for axis in range(d):
        a, b, c = frame[axis, 0], frame[axis, 1], frame[axis, 2]
        values[axis], third = _moments_along(n, local, shares, a, b, c, coords[axis])
        if third < 0.0:
            for k in range(d):
                frame[axis, k] = -frame[axis, k]
            for k in range(n):
                coords[axis, k] = -coords[axis, k]
    # 2. Longest first, including coordinates, by a stable bubble sort.
    for i in range(d - 1):
        for j in range(d - 1 - i):
            if values[j + 1] > values[j]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(d):
                    frame[j, k], frame[j + 1, k] = frame[j + 1, k], frame[j, k]
                for k in range(n):
                    coords[j, k], coords[j + 1, k] = coords[j + 1, k], coords[j, k]


@helper
def frame_in_order(n, d, points):
    """Find the principal axes of n centred points, longest first, and the coordinates along them.

    Axes with nearly equal second moments are rotated within their plane to the least fourth moments.
    """
    local, shares, coords, frame, moments, values = points
    # 1. Eigenvectors of the second moments.
    _axes(n, d, local, shares, moments, frame, values)
    # 2. Planes with nearly equal second moments: a bit for each of (0, 1), (0, 2), (1, 2). They are rotated
    #    in rounds, because in 3-D each rotation changes the other planes.
    loose = 0
    for i in range(d - 1):
        for j in range(i + 1, d):
            loose |= (values[j] >= _ISOTROPIC * values[i]) << (i + j - 1)
    for _ in range(1 if d == 2 else _TURNS):
        largest = 0.0
        for i in range(d - 1):
            for j in range(i + 1, d):
                if loose >> (i + j - 1) & 1:
                    largest = max(largest, _turn_plane(n, d, shares, frame, i, j, local))
        if largest < _TURNED:
            break
    # 3. Longest axis first, each toward its heavier tail.
    _order_axes(n, d, local, shares, frame, coords, values)


@kernel
def frames_of_blocks(offsets, centroids, weights):
    """Return each block's principal axes ``(B, d, d)``, and its points' coordinates ``(n, d)`` along them."""
    n_blocks, d, largest = len(offsets) - 1, centroids.shape[1], np.int64(0)
    for b in range(n_blocks):
        largest = max(largest, offsets[b + 1] - offsets[b])
    # 1. Workspace for the largest block.
    points = new_framed_points(largest)
    local, shares, coords, frame, _, _ = points
    frames, coordinates = np.empty((n_blocks, d, d)), np.empty((len(weights), d))
    for b in range(n_blocks):
        start, n = offsets[b], offsets[b + 1] - offsets[b]
        for k in range(n):
            shares[k] = weights[start + k]
            for c in range(d):
                local[c, k] = centroids[start + k, c]
        # 2. Apply the functions used for pieces to a copy of the block.
        centre_in_order(n, d, local, shares)
        frame_in_order(n, d, points)
        for c in range(d):
            for e in range(d):
                frames[b, c, e] = frame[c, e]
            for k in range(n):
                coordinates[start + k, c] = coords[c, k]
    return frames, coordinates
