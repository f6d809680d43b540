"""Find the face that is seen at each pixel, by a depth buffer."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _crossings(corners, low, high, y, found):
    """Write, in order, where the row at y enters and leaves a loop, and return how many places there are.

    The loop has the corners ``low:high``. An edge belongs to the row if just one of its ends lies at y or
    above. It is followed from its upper end on, whichever face it is looked at for, so that neighbours agree
    to the last bit and no pixel falls between them.
    """
    count = 0
    for k in range(low, high):
        after = k + 1 if k + 1 < high else low
        if (corners[k, 1] <= y) == (corners[after, 1] <= y):
            continue
        # The crossing, and its place among those found (sorted by insertion: there are few).
        one, other = (k, after) if corners[k, 1] < corners[after, 1] else (after, k)
        share = (y - corners[one, 1]) / (corners[other, 1] - corners[one, 1])
        x, place = corners[one, 0] + share * (corners[other, 0] - corners[one, 0]), count
        while place > 0 and found[place - 1] > x:
            found[place] = found[place - 1]
            place -= 1
        found[place] = x
        count += 1
    return count


@kernel
def nearest_faces(corners, offsets, faces, planes, width, height):
    """Face nearest to the eye at the centre of each pixel, or −1 where there is none.

    Parameters
    ----------
    corners : (c, 3) float64
        x and y in pixels (the pixel of a row and a column has its centre at column + ½, row + ½), and the
        depth, which grows towards the eye. Those of face f are ``corners[offsets[f]:offsets[f + 1]]``.
    offsets : (f + 1,) int64
    faces : (m,) int64
        Faces that are looked at, convex or not; of several as near the first is seen.
    planes : (f, 3) float64
        A face has the depth ``planes[f] @ (1, x, y)``, within that of its corners.
    width, height : int

    Returns
    -------
    seen : (height, width) int64
    depth : (height, width) float64
        −∞ where nothing is seen.
    """
    seen = np.full((height, width), -1, np.int64)
    depth = np.full((height, width), -np.inf)
    found = np.empty(max(1, np.diff(offsets).max()))
    for face in faces:
        # 1. Rows of pixels with their centres between the lowest and the highest corner.
        low, high = offsets[face], offsets[face + 1]
        own, plane = corners[low:high], planes[face]
        near, far = own[:, 2].max(), own[:, 2].min()
        top, bottom = np.ceil(own[:, 1].min() - 0.5), np.ceil(own[:, 1].max() - 0.5)
        for row in range(max(0, int(top)), min(height, int(bottom))):
            # 2. Pixels with their centres inside the face, by the even-odd rule: between every second
            #    crossing and the next. An interval of ends is half-open, so that faces side by side share no
            #    pixel.
            count = _crossings(corners, low, high, row + 0.5, found)
            for k in range(0, count - 1, 2):
                left, right = int(np.ceil(found[k] - 0.5)), int(np.ceil(found[k + 1] - 0.5))
                for column in range(max(0, left), min(width, right)):
                    # 3. The depth of the plane there, kept within that of the corners. Of several faces as
                    #    near the first stays.
                    z = plane[0] + plane[1] * (column + 0.5) + plane[2] * (row + 0.5)
                    z = min(max(z, far), near)
                    if z > depth[row, column]:
                        seen[row, column], depth[row, column] = face, z
    return seen, depth
