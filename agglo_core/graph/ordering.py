"""Order cells along a space-filling curve, so that neighbours in space are close in memory."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen, frozen_float, frozen_int
from agglo_core.threads import over_ranges

_BITS = {2: 18, 3: 14}
"""Largest number of bits per axis, a multiple of 6 / d. More bits take more time, and only separate points
closer than 2^−18 (2-D) or 2^−14 (3-D) of the extent."""


def curve_order(points: Float, axes: Float | None = None) -> Int:
    """Return the permutation ``(n,)`` that sorts points ``(n, d)`` along a Hilbert curve.

    The curve has 2^18 (2-D) or 2^14 (3-D) steps along each axis, fewer for very many points. Points in the
    same step are sorted along the first axis. The orthogonal ``axes (d, d)`` are by default the coordinate
    axes.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.graph.ordering import curve_order
    >>> curve_order(np.array([[1.0, 1.0], [0.0, 0.0], [0.1, 0.0]]))
    array([1, 2, 0])
    """
    from agglo_core.compiled.curve_keys import bounding_cube, curve_keys, sort_keys, sort_ties

    n, d = points.shape
    number_bits = max(1, (n - 1).bit_length())
    bits = min(_BITS[d], (64 - number_bits) // 6 * 6 // d)
    spare, keys, order = np.uint64(64 - d * bits), np.empty(n, np.uint64), np.empty(n, np.uint64)
    points, frame = frozen_float(points), frozen_float(np.eye(d)) if axes is None else axes
    curve = frame, *bounding_cube(points, frame), bits, hilbert_table(d)
    over_ranges(lambda start, stop: curve_keys(points, start, *curve, keys[start:stop]), n)
    if not sort_keys(keys, np.empty(1 << min(number_bits, d * bits), np.int32), order):
        order = np.sort(keys)
    sort_ties(order, spare, points, frame[:1])
    order &= (np.uint64(1) << spare) - np.uint64(1)
    return frozen_int(order.view(np.int64))


@cache
def hilbert_table(d: int) -> NDArray[np.uint16]:
    """Return the table ``(S, 64)`` that converts steps along the axes to Hilbert indices by six bits.

    A row is a state: the orientation of the curve in a cube. A column contains the next 6 / d bits along each
    axis. The entry is the next six bits of the Hilbert index, plus 64 times the next state. The first state
    is 0. Source: Skilling, "Programming the Hilbert curve" (AIP Conf. Proc. 707, 2004).
    """
    first: _State = (tuple(range(d)), (0,) * d, 0)
    states, todo, rows = {first: 0}, [first], []
    for state in todo:
        row = []
        for digits in product(product((0, 1), repeat=6 // d), repeat=d):
            index, current = 0, state
            for digit in zip(*digits, strict=True):
                bits, current = _step(current, digit)
                for bit in bits:
                    index = 2 * index + bit
            if current not in states:
                states[current] = len(states)
                todo.append(current)
            row.append(index + 64 * states[current])
        rows.append(row)
    return frozen(rows, np.uint16)


_State = tuple[tuple[int, ...], tuple[int, ...], int]
"""Orientation of a cube: the axes in the order of the curve, which of these are reversed, and 1 if the curve
runs backwards."""


def _step(state: _State, digit: tuple[int, ...]) -> tuple[list[int], _State]:
    """Return the index bits of one of the 2^d smaller cubes, and the orientation in it."""
    axes, reversed_axes, backwards = list(state[0]), list(state[1]), state[2]
    turned = [digit[axis] ^ flip for axis, flip in zip(axes, reversed_axes, strict=True)]
    # 1. The curve visits the smaller cubes in the order of the Gray code.
    gray = [sum(turned[: a + 1]) % 2 for a in range(len(turned))]
    bits = [bit ^ backwards for bit in gray]
    # 2. Turn the curve in the smaller cube: reverse the first axis, or exchange it, once for each axis.
    for a, upper in enumerate(turned):
        if upper:
            reversed_axes[0] ^= 1
        else:
            axes[0], axes[a] = axes[a], axes[0]
            reversed_axes[0], reversed_axes[a] = reversed_axes[a], reversed_axes[0]
    return bits, (tuple(axes), tuple(reversed_axes), backwards ^ gray[-1])
