"""Cut a space-filling curve through a mesh into connected runs of equal mass."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.graphs import flood

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
def _keep_largest(indptr, indices, run, parts, open_parts, nodes, strays, n_strays):
    """Keep the largest component of the cells in a ``run``, and list the other cells as strays.

    Strays have part −1. Returns the new number of strays. ``open_parts (n,)`` are the parts of cells without
    component, −1 for other cells, and ``nodes (n + 1,)`` is workspace.
    """
    # 1. Components, in the order of their first cells.
    filled, first, size = np.int64(0), np.int64(0), np.int64(0)
    for i in run:
        if open_parts[i] >= 0:
            start = filled
            filled = flood(np.int64(i), indptr, indices, open_parts, nodes, start)
            if filled - start > size:
                first, size = start, filled - start
            if filled == len(run):
                break
    if size == len(run):
        return n_strays
    # 2. Cells outside the largest component.
    part = parts[run[0]]
    for i in run:
        parts[i] = -1
    for c in range(first, first + size):
        parts[np.uint32(nodes[c])] = part
    for i in run:
        strays[n_strays] = i
        n_strays += parts[i] < 0
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
    parts, open_parts, nodes = np.full(n, -1, np.int32), np.full(n, -1, np.int32), np.empty(n + 1, np.int32)
    strays, size, starts = (
        np.empty(n + 1, np.int32),
        np.zeros(quotas.sum()),
        np.empty(quotas.max() + 1, np.int64),
    )
    for b in range(len(quotas)):
        lo, hi, k, n_strays = offsets[b], offsets[b + 1], quotas[b], np.int64(0)
        total, below, part = 0.0, 0.0, np.int64(0)
        for c in range(lo, hi):
            total += mass[cells[c]]
        # 1. The run of a cell follows from the mass before its middle, or its place without mass. The next
        #    run begins at most once per cell, and early enough that every run has a cell.
        starts[0], starts[k] = lo, hi
        for c in range(lo, hi):
            i = np.int64(cells[c])
            middle = (below + 0.5 * mass[i]) / total if total > 0.0 else (c - lo + 0.5) / (hi - lo)
            below += mass[i]
            if max(np.int64(middle * k), k - (hi - c)) > part and c > starts[part]:
                part += 1
                starts[part] = c
            parts[i] = open_parts[i] = first + part
        # 2. Each run keeps its largest component, and the other cells become strays.
        for p in range(k):
            run = cells[starts[p] : starts[p + 1]]
            n_strays = _keep_largest(indptr, indices, run, parts, open_parts, nodes, strays, n_strays)
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
