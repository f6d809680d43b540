"""Norms of residuals and errors relative to those of right-hand sides and solutions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agglo_core.arrays import Float

Measure = Callable[[Float], float]
"""Maps a vector ``(n,)`` to its size."""

_SMALL = 1e-140
"""Norms below this limit, or above its inverse, come from scaled entries, because squares lose digits."""


def two_norm(r: Float) -> float:
    """Return ‖r‖ without overflow or underflow.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems.residuals.sizes import two_norm
    >>> f"{two_norm(np.array([3e200, 4e200])):.3g}"
    '5e+200'
    """
    with np.errstate(over="ignore"):
        plain = float(np.linalg.norm(r))
    if _SMALL < plain < 1.0 / _SMALL or not r.any():
        return plain
    largest = float(np.abs(r).max())
    return largest * float(np.linalg.norm(r / largest))


def relative_size(r: Float, size: float) -> float:
    """Return ‖r‖ / size, or 0 if both are 0.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems.residuals.sizes import relative_size
    >>> relative_size(np.array([3.0, 4.0]), 10.0)
    0.5
    """
    return size_ratio(two_norm(r), size)


def size_ratio(length: float, size: float) -> float:
    """Return length / size, or 0 if both are 0.

    The result is ∞ if only ``size`` is 0, or either is infinite.

    Examples
    --------
    >>> from agglo_core.problems.residuals.sizes import size_ratio
    >>> size_ratio(1.0, 4.0), size_ratio(0.0, 0.0), size_ratio(1.0, 0.0)
    (0.25, 0.0, inf)
    """
    if 0.0 < size < np.inf:
        return length / size
    return 0.0 if length == size == 0.0 else float("inf")


def relative_to(b: Float) -> Measure:
    """Return the residual measure ‖r‖ / ‖b‖ as a function of r."""
    size = two_norm(b)
    return lambda r: relative_size(r, size)


def energy_of_solution(b: Float) -> Measure:
    """Return the energy norm (x·Ax)^½ for A x ≈ b as a function of x, computed as (b·x)^½.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems.residuals.sizes import energy_of_solution
    >>> energy_of_solution(np.array([2.0]))(np.array([8.0]))  # 2 · 8 = x · A x
    4.0
    """
    return lambda x: float(np.sqrt(max(float(b @ x), 0.0)))
