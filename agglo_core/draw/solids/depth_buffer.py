"""Depth buffer: for each pixel the visible face and its depth."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.frames import largest_block


@helper
def _crossings(corners, low, high, y, crossings):
    """Intersect a polygon with the line at height y: sort the crossings, and return their number.

    The loop has the corners ``low:high``. An edge crosses the row if exactly one end lies at y or above. The
    crossing is computed from the upper end in every face, so that neighbours agree to the last bit and no
    pixel falls in between.
    """
    count = 0
    for k in range(low, high):
        after = k + 1 if k + 1 < high else low
        if (corners[k, 1] <= y) == (corners[after, 1] <= y):
            continue
        # Insert the crossing into the sorted list (insertion sort, as there are few).
        upper, lower = (k, after) if corners[k, 1] < corners[after, 1] else (after, k)
        share = (y - corners[upper, 1]) / (corners[lower, 1] - corners[upper, 1])
        x, place = corners[upper, 0] + share * (corners[lower, 0] - corners[upper, 0]), count
        while place > 0 and crossings[place - 1] > x:
            crossings[place] = crossings[place - 1]
            place -= 1
        crossings[place] = x
        count += 1
    return count


@kernel
def nearest_faces(corners, offsets, faces, planes, width, height):
    """Return the face nearest to the eye at each pixel centre, or −1 if there is none.

    Parameters
    ----------
        x and y in pixels (the pixel in a given row and column has its centre at column + ½, row + ½), and the
        depth, increasing towards the eye. Face f has the corners ``corners[offsets[f]:offsets[f + 1]]``.
    offsets : (f + 1,) int64
    faces : (m,) int64
        Faces to draw, convex or not. Among equally near faces, the first is seen.
    planes : (f, 3) float64
        Face f has the depth ``planes[f] @ (1, x, y)``, clipped to its corner depths.
    width, height : int

    Returns
    -------
    nearest : (height, width) int64
    depth : (height, width) float64
        −∞ where no face is seen.
    """
    nearest = np.full((height, width), -1, np.int64)
    depth = np.full((height, width), -np.inf)
    crossings = np.empty(max(1, largest_block(offsets)))
    for face in faces:
        # 1. Rows with pixel centres between the lowest and the highest corner.
        low, high = offsets[face], offsets[face + 1]
        plane, y_min, y_max, z_min, z_max = planes[face], np.inf, -np.inf, np.inf, -np.inf
        for k in range(low, high):
            y_min, y_max = min(y_min, corners[k, 1]), max(y_max, corners[k, 1])
            z_min, z_max = min(z_min, corners[k, 2]), max(z_max, corners[k, 2])
        top, bottom = np.ceil(y_min - 0.5), np.ceil(y_max - 0.5)
        for row in range(max(0, int(top)), min(height, int(bottom))):
            # 2. Pixels with centres inside the face, by the even-odd rule: from every second crossing to
            #    the next. Intervals are half-open, so that adjacent faces share no pixel.
            count = _crossings(corners, low, high, row + 0.5, crossings)
            for k in range(0, count - 1, 2):
                left, right = int(np.ceil(crossings[k] - 0.5)), int(np.ceil(crossings[k + 1] - 0.5))
                for column in range(max(0, left), min(width, right)):
                    # 3. Depth of the plane at the pixel, clipped to the corners. The first of equally near
                    #    faces stays.
                    z = plane[0] + plane[1] * (column + 0.5) + plane[2] * (row + 0.5)
                    z = min(max(z, z_min), z_max)
                    if z > depth[row, column]:
                        nearest[row, column], depth[row, column] = face, z
    return nearest, depth
