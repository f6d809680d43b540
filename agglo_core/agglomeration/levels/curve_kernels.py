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


@kernel
def cut_runs(mass, cells, offsets, quotas):
    """Divide each block into runs of about equal mass, and return the labels ``(n,)`` and run starts.

    Block b consists of ``cells[offsets[b]:offsets[b + 1]]``, in the order of the curve and of increasing
    numbers, and has ``quotas[b]`` runs. The starts ``(k + 1,)`` are places in this list.
    """
    parts, starts, first = np.empty(len(cells), np.int32), np.empty(quotas.sum() + 1, np.int64), np.int64(0)
    starts[-1] = len(cells)
    for b in range(len(quotas)):
        lo, hi, k, total, below, part = offsets[b], offsets[b + 1], quotas[b], 0.0, 0.0, first
        for c in range(lo, hi):
            total += mass[cells[c]]
        # The run of a cell follows from the mass before its middle, or its place without mass. The next run
        # begins at most once per cell, and early enough that every run has a cell.
        starts[first] = lo
        for c in range(lo, hi):
            i = np.uint32(cells[c])
            middle = (below + 0.5 * mass[i]) / total if total > 0.0 else (c - lo + 0.5) / (hi - lo)
            below += mass[i]
            if max(np.int64(middle * k), k - (hi - c)) > part - first and c > starts[part]:
                part += 1
                starts[part] = c
            parts[i] = part
        first += k
    return parts, starts


@kernel
def list_strays(indptr, indices, cells, starts, parts, open_parts):
    """Keep the largest component of each run, and return the other cells.

    Run r consists of ``cells[starts[r]:starts[r + 1]]``. The other cells receive the label −1 − part in
    ``parts (n,)``. ``open_parts``, equal to ``parts`` at entry, is workspace.
    """
    n_strays, last = np.uint64(0), len(starts) - 1
    strays = np.empty(starts[last] - starts[0] + 1, np.int32)
    nodes = np.empty(len(strays), np.int32)
    for r in range(last):
        # 1. Components, in the order of their first cells.
        start, stop = np.uint64(starts[r]), np.uint64(starts[r + 1])
        filled, first, size, count = np.int64(0), np.int64(0), np.int64(0), np.int64(stop - start)
        for c in range(start, stop):
            i = np.uint32(cells[c])
            if open_parts[i] >= 0:
                before = filled
                filled = flood(np.int64(i), indptr, indices, open_parts, nodes, before)
                if filled - before > size:
                    first, size = before, filled - before
                if filled == count:
                    break
        if size == count:
            continue
        # 2. Cells outside the largest component.
        part = parts[np.uint32(cells[start])]
        for c in range(start, stop):
            parts[np.uint32(cells[c])] = -1 - part
        for c in range(first, first + size):
            parts[np.uint32(nodes[c])] = part
        for c in range(start, stop):
            strays[n_strays] = cells[c]
            n_strays += np.uint64(parts[np.uint32(cells[c])] < 0)
    return strays[:n_strays]


@helper
def _best_part(indptr, indices, interface, parts, size, i, owner):
    """Return the part in the block of cell i with most interface per cell to it, or −1 without one.

    The division by the number of cells evens the sizes.
    """
    best, most, home = np.int64(-1), 0.0, owner[-1 - parts[i]]
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
        p = np.int64(parts[np.uint32(indices[h])])
        if p >= 0 and owner[p] == home:
            share = interface[h] / size[p]
            if best < 0 or share > most * (1.0 + _TIE) or (share >= most * (1.0 - _TIE) and p < best):
                best, most = p, share
    return best


@kernel
def join_strays(indptr, indices, interface, parts, strays, owner):
    """Add each stray to an adjacent part of its block, in rounds from the parts outward.

    ``owner (k,)`` is the block of each part. Strays are left if a block is disconnected.
    """
    size, count = np.zeros(len(owner)), np.int64(len(strays))
    for part in parts:
        size[max(part, 0)] += np.float64(part >= 0)
    while count > 0:
        left = np.int64(0)
        for c in range(count):
            i = np.int64(strays[c])
            p = _best_part(indptr, indices, interface, parts, size, i, owner)
            if p >= 0:
                size[p] += 1.0
                parts[i] = p
            strays[left] = i
            left += p < 0
        if left == count:
            break
        count = left
