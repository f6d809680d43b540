"""How wide parts are while cells move: bounds from a few directions, exact where these do not decide."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper

__all__ = ["fits", "reaches", "take_in"]

_LIMITED, _FREE, _FULL = 0, 1, 2


@helper
def _within(i, j, limit, corners):
    """Whether no vertex of cell i is farther than ``limit`` from one of cell j."""
    offsets, vertices, points, _, _ = corners
    for g in range(offsets[i], offsets[i + 1]):
        for h in range(offsets[j], offsets[j + 1]):
            square = 0.0
            for k in range(points.shape[1]):
                square += (points[vertices[g], k] - points[vertices[h], k]) ** 2
            if square > limit * limit:
                return False
    return True


@helper
def _widened(i, p, low, high, corners, keep):
    """The extent of part p with cell i along the direction where it is largest; ``keep``: i joins it."""
    offsets, vertices, points, directions, _ = corners
    widest = 0.0
    for a in range(len(directions)):
        least, most = low[p, a], high[p, a]
        for h in range(offsets[i], offsets[i + 1]):
            place = 0.0
            for k in range(points.shape[1]):
                place += directions[a, k] * points[vertices[h], k]
            least, most = min(least, place), max(most, place)
        widest = max(widest, most - least)
        if keep:
            low[p, a], high[p, a] = least, most
    return widest


@helper(allocates=True)
def reaches(parts, k, limit, corners):
    """What ``fits`` needs to know of ``k`` parts: extents, whether they may grow, and lists of their cells.

    A single cell wider than ``limit`` stays alone; a part of several that is wider may have any cell.
    ``corners`` holds vertices per cell (CSR), points, directions, and the least extent along one of these
    of anything of diameter 1.
    """
    n, ways = len(parts), len(corners[3])
    if limit == np.inf:
        n, k = 0, 0
    low, high = np.full((k, ways), np.inf), np.full((k, ways), -np.inf)
    state, first = np.full(k, _LIMITED), np.full(k, -1)
    after, before = np.full(n, -1), np.full(n, -1)
    lists = (first, after, before)
    widest = np.zeros(k)
    for i in range(n):
        p = parts[i]
        _link(i, p, lists)
        widest[p] = max(widest[p], _widened(i, p, low, high, corners, True))
    for p in range(k):
        i = first[p]
        alone = i >= 0 and after[i] < 0
        if widest[p] > limit:
            state[p] = _FULL if alone else _FREE
        elif alone and widest[p] > limit * corners[4] and not _within(i, i, limit, corners):
            state[p] = _FULL
    return low, high, state, lists


@helper
def _link(i, p, lists):
    """Make cell i the first of part p's list."""
    first, after, before = lists
    after[i], before[i] = first[p], -1
    if first[p] >= 0:
        before[first[p]] = i
    first[p] = i


@helper
def fits(i, p, reach, limit, corners):
    """Whether part p may have cell i: it is at most ``limit`` wide with it, or too wide without."""
    if limit == np.inf:
        return True
    low, high, state, lists = reach
    if state[p] != _LIMITED:
        return state[p] == _FREE
    if _widened(i, p, low, high, corners, False) <= limit * corners[4]:
        return True
    first, after, _ = lists
    j = first[p]
    while j >= 0:
        if not _within(i, j, limit, corners):
            return False
        j = after[j]
    return True


@helper
def take_in(i, home, p, reach, limit, corners):
    """Move cell i from part ``home`` to part p; extents never shrink."""
    if limit == np.inf:
        return
    low, high, _, lists = reach
    first, after, before = lists
    if before[i] >= 0:
        after[before[i]] = after[i]
    else:
        first[home] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]
    _link(i, p, lists)
    _widened(i, p, low, high, corners, True)
