"""Order cells along a space-filling curve, so that neighbours in space are close in memory."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int


def curve_order(centroids: Float) -> Int:
    """Return the permutation ``(n,)`` that sorts points ``(n, d)`` along a Morton curve.

    The curve has 2^16 (2-D) or 2^10 (3-D) steps per axis.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import curve_order
    >>> curve_order(np.array([[1.0, 1.0], [0.0, 0.0], [0.1, 0.0]]))
    array([1, 2, 0])
    """
    from agglo_core.compiled.curve_keys import curve_keys

    keys = np.empty(len(centroids), np.uint64)
    curve_keys(frozen_float(centroids), keys)
    keys.sort()  # far faster than argsort; equal keys are in the order of their point numbers
    keys &= np.uint64(0xFFFFFFFF)
    return frozen_int(keys.view(np.int64))
