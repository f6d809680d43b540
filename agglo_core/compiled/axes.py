"""Directions in the plane: the frame of a block, and angles to turn it by."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper

_ROUND = 0.8  # ratio of principal moments above which no axis stands out


@helper(reorder_sums=True)
def planar_frame(n, x, y, shares):
    """Cosine and sine of the principal axis of the centred points, and their second moments xx, xy, yy.

    If no axis stands out, the ratio of principal moments exceeding 0.8, of the axis of least fourth
    moments: along the side of a square, to which second moments are blind.

    Examples
    --------
    >>> from agglo_core.authoring import planar_frame
    >>> x, y = np.array([-2.0, 0.0, 2.0]), np.zeros(3)
    >>> cos, sin, *moments = planar_frame(3, x, y, np.array([0.25, 0.5, 0.25]))
    >>> print(cos, sin, *moments)
    1.0 0.0 2.0 0.0 0.0
    """
    xx, xy, yy, real, imaginary = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        p, q = x[i] * x[i] - y[i] * y[i], 2.0 * x[i] * y[i]
        xx += shares[i] * x[i] * x[i]
        xy += shares[i] * x[i] * y[i]
        yy += shares[i] * y[i] * y[i]
        real += shares[i] * (p * p - q * q)
        imaginary += shares[i] * 2.0 * p * q
    mean, radius = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    if mean - radius > _ROUND * (mean + radius) or mean == 0.0:
        angle = 0.25 * np.arctan2(-imaginary, -real)
    return np.cos(angle), np.sin(angle), xx, xy, yy


@helper(allocates=True)
def half_circle(count):
    """Cosines and sines of ``count`` angles evenly over the half circle, from 0 on ``(count, 2)``.

    Examples
    --------
    >>> from agglo_core.authoring import half_circle
    >>> half_circle(2).round(9)
    array([[1., 0.],
           [0., 1.]])
    """
    angles = np.arange(count) * (np.pi / count)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


@helper(allocates=True)
def halvings(count, times):
    """Cosines and sines of the angles that halve those of ``half_circle(count)``, again and again.

    Examples
    --------
    >>> from agglo_core.authoring import halvings
    >>> halvings(2, 1).round(3)  # 45°, half of the 90° between two axes
    array([[0.707, 0.707]])
    """
    angles = np.pi / count / 2.0 ** np.arange(1, times + 1)
    return np.stack((np.cos(angles), np.sin(angles)), axis=1)


@helper
def turned(a, b, p, q):
    """The direction (a, b) turned by the angle whose cosine and sine are p and q.

    Examples
    --------
    >>> from agglo_core.authoring import turned
    >>> turned(3.0, 4.0, 0.0, 1.0)  # by 90°
    (-4.0, 3.0)
    """
    return a * p - b * q, b * p + a * q
