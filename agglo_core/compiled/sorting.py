"""Sorting within kernels."""

from __future__ import annotations

from agglo_core.compiled.compiling import helper


@helper
def sort_by_keys(items, keys, m):
    """Shell sort of ``items[:m]`` by ascending ``keys[:m]``, which are sorted along."""
    gap = 1
    while gap < m // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for k in range(gap, m):
            item, key, place = items[k], keys[k], k
            while place >= gap and keys[place - gap] > key:
                items[place], keys[place] = items[place - gap], keys[place - gap]
                place -= gap
            items[place], keys[place] = item, key
        gap //= 3


@helper
def stable_sort(order, values, spare):
    """Sort ``order (m,)`` by ``values``, equal ones as they stand, by merging longer and longer runs."""
    m, width = len(order), 1
    while width < m:
        for start in range(0, m, 2 * width):
            middle, stop = min(start + width, m), min(start + 2 * width, m)
            i, j = start, middle
            for k in range(start, stop):
                if j == stop or (i < middle and values[order[i]] <= values[order[j]]):
                    spare[k] = order[i]
                    i += 1
                else:
                    spare[k] = order[j]
                    j += 1
        for k in range(m):
            order[k] = spare[k]
        width *= 2
