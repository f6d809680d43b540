"""Sums of selected values with a fixed order of additions, hence reproducible rounding.

A share of exactly one half is rounded up or down by the last bit of a sum. Callers that need consistent
decisions therefore need a common order. This order, pairwise, is the order of ``np.add.reduceat``.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def _by_pairs(values, indices, start, count):
    """Return the pairwise sum of ``values[indices[start:start + count]]``.

    Many summands are halved recursively, up to 128 use eight running sums.
    """
    # 1. Few summands: sequential sum.
    if count < 8:
        total = 0.0
        for k in range(start, start + count):
            total += values[indices[k]]
        return total
    # 2. Up to 128: eight running sums, added by pairs, then the rest sequentially.
    if count <= 128:
        sums, whole = np.zeros(8), count - count % 8
        for k in range(whole):
            sums[k % 8] += values[indices[start + k]]
        total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
        for k in range(start + whole, start + count):
            total += values[indices[k]]
        return total
    # 3. More: two halves, the first a multiple of eight.
    half = count // 2 - count // 2 % 8
    return _by_pairs(values, indices, start, half) + _by_pairs(values, indices, start + half, count - half)


@helper
def chosen_sum(values, indices, start, stop):
    """Return the sum of ``values[indices[start:stop]]``, a non-empty selection."""
    return values[indices[start]] + _by_pairs(values, indices, start + 1, stop - start - 1)


@kernel
def slice_sums(values, indices, offsets):
    """Return the sum of ``values[indices]`` over each non-empty slice from ``offsets (k + 1,)``."""
    sums = np.empty(len(offsets) - 1)
    for s in range(len(sums)):
        sums[s] = chosen_sum(values, indices, offsets[s], offsets[s + 1])
    return sums
