"""Test 2-D cells for self-intersection and inversion, given by segments with the cell on their left."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# segments per cell below which all pairs are compared; from there on, pairs in a common row
# (benchmarks/simplified.py)
_FEW = 64
_FLAT = 1e-12  # relative to the product of two lengths: tolerance for zero area


@helper
def _side(points, a, b, c):
    """Return the side of line ab on which c lies: 1 left, −1 right, 0 on the line up to rounding."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    area = ux * vy - uy * vx
    if abs(area) <= _FLAT * np.sqrt((ux * ux + uy * uy) * (vx * vx + vy * vy)):
        return 0
    return 1 if area > 0.0 else -1


@helper
def _same_way(points, a, b, c):
    """Return True if b and c lie in the same direction from a."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    return _side(points, a, b, c) == 0 and ux * vx + uy * vy > 0.0


@helper
def _is_between(points, a, b, c):
    """Return True if c, a point on the line ab, lies between a and b."""
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    along = ux * (points[c, 0] - points[a, 0]) + uy * (points[c, 1] - points[a, 1])
    return 0.0 <= along <= ux * ux + uy * uy


@helper
def _meet(points, a, b, c, d):
    """Return True if the segments ab and cd have more in common than one end point."""
    # 1. Two common ends: the same segment. One common end: check if the other ends lie in the same direction.
    if (a == c and b == d) or (a == d and b == c):
        return True
    if a == c:
        return _same_way(points, a, b, d)
    if a == d:
        return _same_way(points, a, b, c)
    if b == c:
        return _same_way(points, b, a, d)
    if b == d:
        return _same_way(points, b, a, c)
    # 2. No common end: each segment separates the ends of the other, or an end lies on the other segment.
    sides = _side(points, a, b, c), _side(points, a, b, d), _side(points, c, d, a), _side(points, c, d, b)
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True
    return (
        (sides[0] == 0 and _is_between(points, a, b, c))
        or (sides[1] == 0 and _is_between(points, a, b, d))
        or (sides[2] == 0 and _is_between(points, c, d, a))
        or (sides[3] == 0 and _is_between(points, c, d, b))
    )


@helper
def _row(y, low, height, n_rows):
    """Return the index of the horizontal strip at height y, of ``n_rows`` strips from ``low`` up."""
    return min(max(np.int64((y - low) / height * n_rows), 0), n_rows - 1) if height > 0.0 else 0


@helper(allocates=True)
def _sort_into_rows(points, tails, heads, begin, end):
    """Sort a cell's segments into horizontal strips (CSR), and return its lowest y and its height.

    n segments use √n rows (one row for few segments), so that rows of short segments have about √n entries.
    """
    n = end - begin
    n_rows = 1 if n < _FEW else np.int64(np.sqrt(n))
    low, high = np.inf, -np.inf
    for k in range(begin, end):
        low, high = min(low, points[tails[k], 1]), max(high, points[tails[k], 1])
    starts = np.zeros(n_rows + 1, np.int64)
    members = np.empty(0, np.int64)
    # Count the segments of each row, then fill the rows from their ends backwards: ``starts[row]`` is first
    # the end, finally the start of the row.
    for filling in range(2):
        for k in range(begin, end):
            a, b = points[tails[k], 1], points[heads[k], 1]
            first, last = _row(min(a, b), low, high - low, n_rows), _row(max(a, b), low, high - low, n_rows)
            for row in range(first, last + 1):
                if filling:
                    starts[row] -= 1
                    members[starts[row]] = k
                else:
                    starts[row] += 1
        if not filling:
            for row in range(n_rows):
                starts[row + 1] += starts[row]
            members = np.empty(starts[n_rows], np.int64)
    return starts, members, low, high - low


@helper
def _winding_number(points, tails, heads, members, begin, end, segment):
    """Return the boundary's winding number around points just left of the midpoint of ``segment``.

    It counts crossings of a ray to the right, +1 upwards and −1 downwards, among the segments
    ``members[begin:end]``.
    """
    a, b = tails[segment], heads[segment]
    x, y = 0.5 * (points[a, 0] + points[b, 0]), 0.5 * (points[a, 1] + points[b, 1])
    rise, below = points[b, 1] - points[a, 1], points[b, 0] < points[a, 0]
    total = 1 if rise > 0.0 else 0  # the ray to the right crosses the segment itself
    for m in range(begin, end):
        k = members[m]
        if k == segment:
            continue
        px, py = points[tails[k], 0], points[tails[k], 1]
        qx, qy = points[heads[k], 0], points[heads[k], 1]
        # The ray runs just above the middle, so ends at its height count as below. For a segment that runs to
        # the left, its left side is below, and the ray runs just below the middle.
        if rise == 0.0 and below:
            low, high = py < y, qy < y
        else:
            low, high = py <= y, qy <= y
        # A crossing: the middle lies left of an upward segment, or right of a downward segment.
        if low != high:
            area = (qx - px) * (y - py) - (qy - py) * (x - px)
            if low and area > 0.0:
                total += 1
            elif high and area < 0.0:
                total -= 1
    return total


@helper(allocates=True)
def _is_inverted(points, tails, heads, begin, end):
    """Return True unless the boundary winds exactly once around the points on its left."""
    starts, members, low, height = _sort_into_rows(points, tails, heads, begin, end)
    for k in range(begin, end):
        row = _row(0.5 * (points[tails[k], 1] + points[heads[k], 1]), low, height, len(starts) - 1)
        if _winding_number(points, tails, heads, members, starts[row], starts[row + 1], k) != 1:
            return True
    return False


@kernel
def mark_crossings(points, offsets, tails, heads, chains, cells, bad):
    """Mark edge chains that cross another chain of their cell, and all chains of inverted cells.

    Cell c has the segments ``offsets[c]`` to ``offsets[c + 1]``, sorted by their smallest x, each from a
    point in ``tails`` to a point in ``heads`` with the cell on its left. Each segment belongs to one of the
    ``chains``. Only ``cells`` are examined; ``bad`` is the mask of chains.
    """
    for c in cells:
        begin, end = offsets[c], offsets[c + 1]
        # 1. Pairs of segments with overlapping boxes: the sweep along x ends at the right end of segment i.
        crossed = False
        for i in range(begin, end):
            a, b = tails[i], heads[i]
            right = max(points[a, 0], points[b, 0])
            low, high = min(points[a, 1], points[b, 1]), max(points[a, 1], points[b, 1])
            for j in range(i + 1, end):
                p, q = tails[j], heads[j]
                if min(points[p, 0], points[q, 0]) > right:
                    break
                if min(points[p, 1], points[q, 1]) > high or max(points[p, 1], points[q, 1]) < low:
                    continue
                if _meet(points, a, b, p, q):
                    bad[chains[i]] = True
                    bad[chains[j]] = True
                    crossed = True
        # 2. Loops without crossings may still have a wrong orientation or a wrong nesting.
        if not crossed and _is_inverted(points, tails, heads, begin, end):
            for k in range(begin, end):
                bad[chains[k]] = True
