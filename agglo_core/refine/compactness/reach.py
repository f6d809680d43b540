"""Test part widths during moves, by cell distances or by bounds from a few directions."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel

_ABOVE = 1.0 + 1e-12  # relative to the width limit: a rounded extent beyond this multiple is beyond the limit
_BELOW = 1.0 - 1e-9  # relative to the width limit: rounded distances below this multiple are below the limit
# Full walks over a part's cells before its extents are computed, because they only pay after many tests
# (benchmarks/partition.py, row h* 2, 4, 8).
_WALKS = 16


class Corners(NamedTuple):
    """Vertices of the cells, and the directions along which extents are measured.

    ``offsets (n + 1,)`` and ``vertices`` are a CSR over the cells, and ``points (V, d)`` the vertices.
    ``radii (n,)`` are the largest vertex distances from the ``centroids (n, d)``. ``directions (D, d)`` are
    unit vectors. ``cosine`` belongs to the largest angle between any direction and the nearest unit vector.
    """

    offsets: Any
    vertices: Any
    points: Any
    centroids: Any
    radii: Any
    directions: Any
    cosine: Any


class Reach(NamedTuple):
    """Linked cell lists of the parts, and the extents of the parts along several directions.

    The cells in a part form a linked list: ``first (k,)``, then ``after`` and ``before``, ``(n,)`` each.
    ``far (k,)`` is the last cell found too far away. ``looks (k,)`` counts visited cells, and is negative
    when the extents are available: ``extents (k, D, 2)`` are the smallest and largest coordinates along each
    direction, and ``ends (k, D, 2)`` the cells there.
    """

    first: Any
    after: Any
    before: Any
    far: Any
    looks: Any
    extents: Any
    ends: Any


@kernel
def part_lists(parts, k):
    """Build linked lists of each part's cells: first ``(k,)``, next and previous ``(n,)``."""
    n = len(parts)
    first, after, before = np.full(k, -1, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(n - 1, -1, -1):
        p = parts[i]
        after[i], before[i] = first[p], -1
        if first[p] >= 0:
            before[first[p]] = i
        first[p] = i
    return first, after, before


@kernel
def cell_radii(offsets, vertices, points, centroids):
    """Return the largest distance ``(n,)`` from each cell's centroid to its vertices."""
    radii, last = np.empty(len(centroids)), points.shape[1] - 1
    third = last - 1.0  # 0 in 2-D; a loop over the dimensions takes twice the time
    for i in range(np.uint64(len(radii))):
        x, y, z, most = centroids[i, 0], centroids[i, 1], centroids[i, last], 0.0
        for h in range(np.uint64(offsets[i]), np.uint64(offsets[i + ONE])):
            v = np.uint32(vertices[h])
            a, b, c = points[v, 0] - x, points[v, 1] - y, third * (points[v, last] - z)
            most = max(most, a * a + b * b + c * c)
        radii[i] = np.sqrt(most)
    return radii


@helper
def _within(i, j, limit, corners):
    """Return True if no vertex of cell i is farther than ``limit`` from a vertex of cell j."""
    solid, most = corners.points.shape[1] > 2, 0.0
    # 1. Bound: vertex distances do not exceed the centroid distance plus both radii. This usually decides.
    slack = limit * _BELOW - corners.radii[i] - corners.radii[j]
    x = corners.centroids[i, 0] - corners.centroids[j, 0]
    y = corners.centroids[i, 1] - corners.centroids[j, 1]
    z = corners.centroids[i, 2] - corners.centroids[j, 2] if solid else 0.0
    if slack >= 0.0 and x * x + y * y + z * z <= slack * slack:
        return True
    # 2. Otherwise compare all vertex pairs.
    for g in range(np.uint64(corners.offsets[i]), np.uint64(corners.offsets[i + ONE])):
        for h in range(np.uint64(corners.offsets[j]), np.uint64(corners.offsets[j + ONE])):
            u, v = np.uint32(corners.vertices[g]), np.uint32(corners.vertices[h])
            x = corners.points[u, 0] - corners.points[v, 0]
            y = corners.points[u, 1] - corners.points[v, 1]
            z = corners.points[u, 2] - corners.points[v, 2] if solid else 0.0
            square = x * x + y * y + z * z  # a loop over the dimensions takes twice the time
            most = max(most, square)
    return most <= limit * limit


@helper
def _extent(i, a, corners):
    """Return the smallest and largest coordinate of cell i along direction a."""
    least, most = np.inf, -np.inf
    for h in range(np.uint64(corners.offsets[i]), np.uint64(corners.offsets[i + ONE])):
        place, v = 0.0, np.uint32(corners.vertices[h])
        for k in range(corners.points.shape[1]):
            place += corners.directions[a, k] * corners.points[v, k]
        least, most = min(least, place), max(most, place)
    return least, most


@helper
def _include(i, p, reach, corners):
    """Enlarge the stored extents of part p to include cell i."""
    for a in range(len(corners.directions)):
        least, most = _extent(i, a, corners)
        if least < reach.extents[p, a, 0]:
            reach.extents[p, a, 0], reach.ends[p, a, 0] = least, i
        if most > reach.extents[p, a, 1]:
            reach.extents[p, a, 1], reach.ends[p, a, 1] = most, i


@helper
def _find_extents(p, reach, corners):
    """Compute the extents of part p once its cells were visited several times.

    ``looks`` is negative afterwards.
    """
    if reach.looks[p] < 0:
        return
    # 1. Compare the number of visited cells, ``looks``, with the part's cell count.
    i, cells = reach.first[p], 0
    while i >= 0:
        cells += 1
        i = reach.after[i]
    if reach.looks[p] < _WALKS * cells:
        return
    # 2. Compute the extents over all cells.
    reach.looks[p] = -1
    for a in range(len(corners.directions)):
        reach.extents[p, a, 0], reach.extents[p, a, 1] = np.inf, -np.inf
    i = reach.first[p]
    while i >= 0:
        _include(np.uint64(i), p, reach, corners)
        i = reach.after[i]


@helper
def _by_extents(i, p, parts, reach, limit, corners):
    """Return 1 if cell i fits into part p by the extents, 0 if it does not, −1 if they do not decide.

    Extents do not shrink when cells leave. They prove that a part is too wide only if the cell at their end
    still belongs to the part. They always bound the width from above.
    """
    widest = 0.0
    for a in range(len(corners.directions)):
        least, most = _extent(i, a, corners)
        low, high = reach.extents[p, a, 0], reach.extents[p, a, 1]
        if most - low > limit * _ABOVE and parts[reach.ends[p, a, 0]] == p:
            return 0
        if high - least > limit * _ABOVE and parts[reach.ends[p, a, 1]] == p:
            return 0
        widest = max(widest, max(high, most) - min(low, least))
    # Some direction is so close to the diameter's that its extent is at least diameter times cosine.
    return 1 if widest <= limit * corners.cosine else -1


@helper
def fits(i, p, parts, reach, limit, corners):
    """Return True if part p may receive cell i: no two vertices are farther apart than ``limit``."""
    if limit == np.inf:
        return True
    # 1. The last cell found too far away is often too far again.
    far = reach.far[p]
    if far >= 0 and parts[far] == p and not _within(i, np.uint64(far), limit, corners):
        return False
    # 2. Extents, if available, may decide.
    if reach.looks[p] < 0:
        found = _by_extents(i, p, parts, reach, limit, corners)
        if found >= 0:
            return found == 1
    # 3. Compare with every cell in the part. Cells wider than the limit stay alone, so the cell, and the only
    #    cell in a part, are also compared with themselves.
    j = reach.first[p]
    one = np.uint64(j)
    whole = _within(i, i, limit, corners) and (reach.after[j] >= 0 or _within(one, one, limit, corners))
    looks = 0
    while whole and j >= 0:
        looks += 1
        if not _within(i, np.uint64(j), limit, corners):
            reach.far[p], whole = j, False
        j = reach.after[j]
    # 4. Count the visited cells, until the extents pay off.
    if reach.looks[p] >= 0:
        reach.looks[p] += looks
        _find_extents(p, reach, corners)
    return whole


@helper
def take_in(i, home, p, reach, limit, corners):
    """Move cell i from part ``home`` to part p in the cell lists."""
    if limit == np.inf:
        return
    # Unlink the cell from its old list and insert it at the front of the new list. The old part's extents
    # remain valid bounds.
    if reach.before[i] >= 0:
        reach.after[reach.before[i]] = reach.after[i]
    else:
        reach.first[home] = reach.after[i]
    if reach.after[i] >= 0:
        reach.before[reach.after[i]] = reach.before[i]
    reach.after[i], reach.before[i] = reach.first[p], -1
    if reach.first[p] >= 0:
        reach.before[reach.first[p]] = i
    reach.first[p] = i
    if reach.looks[p] < 0:
        _include(i, p, reach, corners)
