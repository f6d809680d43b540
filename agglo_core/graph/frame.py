"""Frame of a point set that moves with it: principal axes, with directions from higher moments."""

from __future__ import annotations

from functools import cache
from itertools import combinations, combinations_with_replacement

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int

_ISOTROPIC = 0.9
"""Ratio of second moments above which fourth moments define the axes in their plane. A convention: principal
axes are ill-defined where second moments are nearly equal, as on a square."""
_ROUNDING = 1e-9  # relative to their scale: smaller third moments are rounding, and vanish by symmetry
_SOMEWHERE = frozen_float([1.0, 0.61, 0.27])
"""Direction of axes without a third moment: between the coordinate axes and diagonals."""
_ROUNDS = 6  # of rotations in the planes of 3-D frames; one suffices for separate planes


def moving_frame(points: Float, weights: Float) -> Float:
    """Return an orthogonal matrix ``(d, d)`` whose rows are axes that move with the points ``(n, d)``.

    The rows are the principal axes, longest first. Axes with nearly equal second moments are rotated in their
    plane to the least fourth moments, so that they follow the sides of a square. An axis points to where the
    third moment is positive. If all these moments are equal by symmetry, the coordinate axes decide.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.graph.frame import moving_frame
    >>> moving_frame(np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 3.0], [0.1, 1.0]]), np.ones(4)).round(2) + 0.0
    array([[-0.01,  1.  ],
           [ 1.  ,  0.01]])
    """
    second, third, fourth = _moments(points, weights)
    d = points.shape[1]
    # 1. Principal axes, longest first.
    values, vectors = np.linalg.eigh(second)
    frame, values = vectors.T[::-1], values[::-1]
    # 2. Axes with nearly equal moments, plane by plane, in rounds because in 3-D the planes share axes.
    planes = [(i, j) for i, j in combinations(range(d), 2) if values[j] >= _ISOTROPIC * values[i] > 0.0]
    for _ in range(_ROUNDS if len(planes) > 1 else len(planes)):
        for i, j in planes:
            frame = _rotate_plane(frame, fourth, i, j)
    # 3. Longest axis first again, and toward the positive third moment.
    lengths = ((frame @ second) * frame).sum(axis=1)
    frame = frame[np.argsort(-lengths, kind="stable")]
    skew = np.array([third @ axis @ axis @ axis for axis in frame])
    symmetric = np.abs(skew) <= _ROUNDING * max(float(values[0]), 0.0) ** 1.5
    direction = np.where(symmetric, frame @ _SOMEWHERE[:d], skew)
    return frozen_float(np.where(direction < 0.0, -1.0, 1.0)[:, None] * frame)


def _moments(points: Float, weights: Float) -> tuple[Float, Float, Float]:
    """Return the second, third and fourth moments about the centre, as tensors, per total weight."""
    from agglo_core.compiled.frames import moment_sums

    n, d = points.shape
    total = weights.sum()
    shares = weights / total if total > 0.0 else np.full(n, 1.0 / max(n, 1))
    centre = shares @ points
    # 1. Sums of w r r, w r r r and w r r r r over the distinct pairs of coordinates.
    pairs, place = _pairs(d)
    second, sums = moment_sums(frozen_float(points), frozen_float(shares), frozen_float(centre), pairs)
    # 2. Full tensors.
    return second[place], sums[:d][:, place], sums[d:][place][:, :, place]


@cache
def _pairs(d: int) -> tuple[Int, Int]:
    """Return the distinct pairs of coordinates ``(P, 2)``, and the place of each pair ``(d, d)``."""
    pairs = frozen_int(list(combinations_with_replacement(range(d), 2)))
    place = np.zeros((d, d), np.int64)
    for p, (i, j) in enumerate(pairs):
        place[i, j] = place[j, i] = p
    return pairs, frozen_int(place)


def _rotate_plane(frame: Float, fourth: Float, i: int, j: int) -> Float:
    """Rotate axes i and j of the frame in their plane to the least fourth moments.

    With complex numbers z = x + iy in the plane, ⟨x⁴ + y⁴⟩ = ¾ ⟨|z|⁴⟩ + ¼ Re ⟨z⁴⟩. A rotation by θ multiplies
    ⟨z⁴⟩ by e^(−4iθ), so the sum is least where ⟨z⁴⟩ becomes real and negative.
    """
    z = frame[i] + 1j * frame[j]
    partial = fourth @ z @ z
    product, scale = z @ partial @ z, z.conj() @ partial @ z.conj()
    if abs(product) <= _ROUNDING * abs(scale):
        return frame
    angle = np.angle(-product) / 4.0
    cos, sin = np.cos(angle), np.sin(angle)
    result = frame.copy()
    result[i], result[j] = cos * frame[i] + sin * frame[j], cos * frame[j] - sin * frame[i]
    return result
