"""Cut a space-filling curve through a mesh into connected runs of equal mass."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.graphs import find_root

_TIE = 1e-9  # relative: shares that differ by less are equal, and the lower part number decides
_WIDTHS = 3.0
"""A cell is stretched if the centroid of a neighbour is farther than this many cell widths
(benchmarks/curve.py)."""


@kernel
def stretched_cells(indptr, indices, centroids, measures, step):
    """Return the number of cells whose centroid is far from that of a neighbour, beside the cell width.

    Only every ``step``-th cell is examined. The width is the side of a square or cube with the mean measure
    of the cell and its neighbours.
    """
    count, d = np.int64(0), centroids.shape[1]
    for c in range(0, len(measures), step):
        i = np.uint64(c)
        begin, end = np.uint64(indptr[i]), np.uint64(indptr[i + ONE])
        farthest, total = 0.0, measures[i]
        for h in range(begin, end):
            j, square = np.uint32(indices[h]), 0.0
            for a in range(d):
                square += (centroids[i, a] - centroids[j, a]) ** 2
            farthest, total = max(farthest, square), total + measures[j]
        width = (total / (np.float64(end - begin) + 1.0)) ** (1.0 / d)
        count += farthest > (_WIDTHS * width) ** 2
    return count


@helper
def _join_earlier(indptr, indices, parts, root, count, i):
    """Join cell i with its neighbours that precede it in the same run, and return the number of joins.

    The root of a component is its first cell, with its cell ``count``.
    """
    home, mine, joins = parts[i], i, np.int64(0)
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
        j = np.int64(np.uint32(indices[h]))
        if j < i and parts[j] == home:
            other = find_root(root, j)
            if other != mine:
                first, second = min(mine, other), max(mine, other)
                root[second], mine = first, first
                count[first] += count[second]
                joins += 1
    return joins


@helper
def _keep_largest(cells, start, stop, parts, root, count, strays, n_strays):
    """Keep the largest component of the run ``cells[start:stop]``, and list the other cells as strays.

    Strays have part −1. Returns the new number of strays.
    """
    largest = np.int64(cells[start])
    for c in range(start, stop):
        i = np.int64(cells[c])
        if root[i] == i and count[i] > count[largest]:
            largest = i
    for c in range(start, stop):
        i = np.int64(cells[c])
        if find_root(root, i) != largest:
            parts[i] = -1
            strays[n_strays] = i
            n_strays += 1
    return n_strays


@helper
def _best_part(indptr, indices, interface, parts, size, i, first, last):
    """Return the part of ``first`` to ``last − 1`` with most interface per cell to cell i, or −1 without one.

    The division by the number of cells evens the sizes.
    """
    best, most = np.int64(-1), 0.0
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
        p = np.int64(parts[np.uint32(indices[h])])
        if first <= p < last:
            share = interface[h] / size[p]
            if best < 0 or share > most * (1.0 + _TIE) or (share >= most * (1.0 - _TIE) and p < best):
                best, most = p, share
    return best


@kernel
def connected_runs(indptr, indices, interface, mass, cells, offsets, quotas):
    """Divide each connected block into connected parts along the curve, and return the labels ``(n,)``.

    Block b consists of ``cells[offsets[b]:offsets[b + 1]]``, in the order of the curve and of increasing
    numbers. Its ``quotas[b]`` parts start as runs of about equal mass. Each keeps its largest component, and
    the other cells join an adjacent part.
    """
    n, first = len(cells), np.int64(0)
    parts, root = np.full(n, -1, np.int32), np.empty(n, np.int32)
    count, strays, size = np.empty(n, np.int32), np.empty(n, np.int32), np.zeros(quotas.sum())
    for b in range(len(quotas)):
        lo, hi, k, n_strays = offsets[b], offsets[b + 1], quotas[b], np.int64(0)
        total, below, part, start, components = 0.0, 0.0, np.int64(0), lo, np.int64(0)
        for c in range(lo, hi):
            total += mass[cells[c]]
        for c in range(lo, hi):
            # 1. The run of a cell follows from the mass before its middle, or its place without mass. The
            #    next run begins at most once per cell, and early enough that every run has a cell.
            i = np.int64(cells[c])
            middle = (below + 0.5 * mass[i]) / total if total > 0.0 else (c - lo + 0.5) / (hi - lo)
            below += mass[i]
            wanted = max(np.int64(middle * k), k - (hi - c))
            if wanted > part and c > start:
                if components > 1:
                    n_strays = _keep_largest(cells, start, c, parts, root, count, strays, n_strays)
                part, start, components = part + 1, c, np.int64(0)
            # 2. Components of the run, by union-find.
            parts[i], root[i], count[i] = first + part, i, 1
            components += 1 - _join_earlier(indptr, indices, parts, root, count, i)
        if components > 1:
            n_strays = _keep_largest(cells, start, hi, parts, root, count, strays, n_strays)
        # 3. Strays join an adjacent part, in rounds from the parts outward.
        for c in range(lo, hi if n_strays > 0 else lo):
            if parts[cells[c]] >= 0:
                size[parts[cells[c]]] += 1.0
        while n_strays > 0:
            left = np.int64(0)
            for c in range(n_strays):
                i = np.int64(strays[c])
                p = _best_part(indptr, indices, interface, parts, size, i, first, first + k)
                if p >= 0:
                    size[p] += 1.0
                parts[i], strays[left] = p, i
                left += p < 0
            if left == n_strays:
                break  # the block is disconnected: the caller raises an error
            n_strays = left
        first += k
    return parts
