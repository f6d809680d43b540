"""Sums of chosen values, in one fixed order of additions.

A share of exactly one half is rounded up or down by the last bit of a sum: whoever needs the same decision
needs the same order. This one, by pairs, is that of ``np.add.reduceat``.
"""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import kernel

__all__ = ["chosen_sum", "slice_sums"]


@kernel
def _by_pairs(values, chosen, start, count):
    """Sum of ``values[chosen[start:start + count]]``: halves of many, eight running sums of up to 128."""
    if count < 8:
        total = 0.0
        for k in range(start, start + count):
            total += values[chosen[k]]
        return total
    if count <= 128:
        a, b, c, d, e, f, g, h = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        whole = start + count - count % 8
        for k in range(start, whole, 8):
            a += values[chosen[k]]
            b += values[chosen[k + 1]]
            c += values[chosen[k + 2]]
            d += values[chosen[k + 3]]
            e += values[chosen[k + 4]]
            f += values[chosen[k + 5]]
            g += values[chosen[k + 6]]
            h += values[chosen[k + 7]]
        total = ((a + b) + (c + d)) + ((e + f) + (g + h))
        for k in range(whole, start + count):
            total += values[chosen[k]]
        return total
    half = count // 2 - count // 2 % 8
    return _by_pairs(values, chosen, start, half) + _by_pairs(values, chosen, start + half, count - half)


@kernel
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
