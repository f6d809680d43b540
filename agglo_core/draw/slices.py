"""Functions on tetrahedra, on planes across them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.problems.discretisation import Samples

_TRIANGLE = ((0, 1), (0, 2), (0, 3))
_QUADRILATERAL = (((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2)))
"""Edges that the plane cuts, of a tetrahedron whose corners are in order of their height over it."""


class Slice(NamedTuple):
    """A function on triangles of a plane, each with corners of its own."""

    points: Float  # (3 t, 2)
    triangles: Int  # (t, 3)
    values: Float  # (3 t,)


def middle_slice(samples: Samples, axis: int) -> Slice:
    """The function where the plane across ``axis`` through the middle of its domain cuts its tetrahedra.

    Parameters
    ----------
    samples : Samples
        In 3-D.
    axis : int
        0, 1 or 2; the two others are the coordinates of the slice, in their order.
    """
    along = samples.points[:, axis]
    height = along - (along.min() + along.max()) / 2
    lower = (height < 0.0)[samples.simplices].sum(axis=1)
    cut = (lower > 0) & (lower < 4)
    corners, lower = samples.simplices[cut], lower[cut]
    corners = np.take_along_axis(corners, np.argsort(height[corners], axis=1, kind="stable"), axis=1)
    edges = [corners[lower == 1][:, _TRIANGLE], corners[lower == 3][:, ::-1][:, _TRIANGLE]]
    edges += [corners[lower == 2][:, half] for half in _QUADRILATERAL]
    one, other = np.concatenate(edges).reshape(-1, 2).T
    share = height[one] / (height[one] - height[other])
    points = samples.points[one] + share[:, None] * (samples.points[other] - samples.points[one])
    values = samples.values[one] + share * (samples.values[other] - samples.values[one])
    return Slice(np.delete(points, axis, axis=1), np.arange(len(values)).reshape(-1, 3), values)
