"""Sums of chosen values, in one fixed order of additions.

A share of exactly one half is rounded up or down by the last bit of a sum: whoever needs the same decision
needs the same order. This one, by pairs, is that of ``np.add.reduceat``.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def _by_pairs(values, chosen, start, count):
    """Sum of ``values[chosen[start:start + count]]``: halves of many, eight running sums of up to 128."""
    # 1. Few summands: one after the other.
    if count < 8:
        total = 0.0
        for k in range(start, start + count):
            total += values[chosen[k]]
        return total
    # 2. Up to 128: eight running sums, added by pairs, and the rest one after the other.
    if count <= 128:
        sums, whole = np.zeros(8), count - count % 8
        for k in range(whole):
            sums[k % 8] += values[chosen[start + k]]
        total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
        for k in range(start + whole, start + count):
            total += values[chosen[k]]
        return total
    # 3. More: two halves, the first one a multiple of eight.
    half = count // 2 - count // 2 % 8
    return _by_pairs(values, chosen, start, half) + _by_pairs(values, chosen, start + half, count - half)


@helper
def chosen_sum(values, chosen, start, stop):
    """Sum of ``values[chosen[start:stop]]``, which is not empty."""
    return values[chosen[start]] + _by_pairs(values, chosen, start + 1, stop - start - 1)


@kernel
def slice_sums(values, chosen, offsets):
    """Sums ``(k,)`` of ``values[chosen]`` over slices ``offsets (k + 1,)``, none of them empty."""
    sums = np.empty(len(offsets) - 1)
    for s in range(len(sums)):
        sums[s] = chosen_sum(values, chosen, offsets[s], offsets[s + 1])
    return sums
