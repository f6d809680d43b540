"""Which of many triangles is seen at each pixel."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["nearest_triangles"]

_TOUCH = 1e-9  # of an edge function in pixels²: what lies on an edge belongs to both sides, so none has gaps


@helper
def _edge(ax, ay, bx, by, x, y):
    """Twice the area of the triangle a, b, (x, y), positive if it turns left."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@kernel
def nearest_triangles(corners, width, height):
    """The triangle nearest to the eye at the centre of each pixel; −1 where there is none.

    Parameters
    ----------
    corners : (t, 3, 3) float64
        x and y in pixels (pixel (row, column) has its centre at column + ½, row + ½), and the depth, which
        grows towards the eye. Triangles of no area are not seen; of several as near the first is.
    width, height : int

    Returns
    -------
    seen : (height, width) int64
    depth : (height, width) float64
        −∞ where nothing is seen.
    """
    seen = np.full((height, width), -1, np.int64)
    depth = np.full((height, width), -np.inf)
    for t in range(len(corners)):
        ax, ay, bx, by = corners[t, 0, 0], corners[t, 0, 1], corners[t, 1, 0], corners[t, 1, 1]
        cx, cy = corners[t, 2, 0], corners[t, 2, 1]
        area = _edge(ax, ay, bx, by, cx, cy)
        if area == 0.0:
            continue
        left, right = max(0.0, np.ceil(min(ax, bx, cx) - 0.5)), min(width, np.floor(max(ax, bx, cx) + 0.5))
        top, bottom = max(0.0, np.ceil(min(ay, by, cy) - 0.5)), min(height, np.floor(max(ay, by, cy) + 0.5))
        sign = 1.0 if area > 0.0 else -1.0
        for row in range(int(top), int(bottom)):
            for column in range(int(left), int(right)):
                x, y = column + 0.5, row + 0.5
                a, b = sign * _edge(bx, by, cx, cy, x, y), sign * _edge(cx, cy, ax, ay, x, y)
                c = sign * _edge(ax, ay, bx, by, x, y)
                if a < -_TOUCH or b < -_TOUCH or c < -_TOUCH:
                    continue
                z = (a * corners[t, 0, 2] + b * corners[t, 1, 2] + c * corners[t, 2, 2]) / (sign * area)
                if z > depth[row, column]:
                    seen[row, column], depth[row, column] = t, z
    return seen, depth
