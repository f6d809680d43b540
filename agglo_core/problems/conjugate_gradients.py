"""Plain conjugate gradients: the baseline for every method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.progress import Tell, to_nobody

__all__ = ["MET", "History", "conjugate_gradients", "iterated", "relative_size", "relative_to"]

MET = "tolerance met"
"""The reason of an iteration that converged."""

Measure = Callable[[Float], float]
"""Residual ``(n,)`` to its size relative to the right-hand side."""


@dataclass(frozen=True, eq=False)
class History:
    """An iterate ``x (n,)`` and the 2-norms of residuals that led to it, the first before any iteration."""

    x: Float
    residuals: Float
    converged: bool
    reason: str

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.residuals) - 1


def relative_size(r: Float, size: float) -> float:
    """‖r‖ over a size; 0 where both are 0."""
    length = float(np.linalg.norm(r))
    if size > 0.0:
        return length / size
    return float("inf") if length > 0.0 else 0.0


def relative_to(b: Float) -> Measure:
    """The measure ‖r‖ / ‖b‖."""
    size = float(np.linalg.norm(b))
    return lambda r: relative_size(r, size)


def conjugate_gradients(
    A: Any,
    b: Float,
    tolerance: float = 1e-6,
    most: int = 10_000,
    measure: Measure | None = None,
    tell: Tell = to_nobody,
) -> History:
    """Plain conjugate gradients from 0 until ``measure`` says ``tolerance`` or less.

    Parameters
    ----------
    A : (n, n) sparse
    b : (n,) float
    tolerance : float
    most : int
        Iterations.
    measure : callable, optional
        Of residuals; by default ‖r‖ / ‖b‖.
    tell : callable, optional
        Told how far the iteration has come, see :func:`iterated`.

    Notes
    -----
    The recursion's residual is tested, and where it is small enough b − A x as well. As in MATLAB's
    ``pcg``, an iteration that does not converge returns the iterate of smallest residual, whose number is
    the length of the history; ``reason`` says how many iterations were done.
    """
    measure = measure or relative_to(b)
    x, r = np.zeros(len(b)), b.copy()
    p, rho, why = r, float(r @ r), ""
    residuals, sizes, best = [float(np.sqrt(rho))], [measure(r)], x
    smallest = 0
    while sizes[-1] > tolerance and len(residuals) <= most:
        Ap = A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            why = "the matrix is not positive definite: "
            break
        alpha = rho / curvature
        x, r = x + alpha * p, r - alpha * Ap
        rho, before = float(r @ r), rho
        p = r + (rho / before) * p
        residuals.append(float(np.sqrt(rho)))
        sizes.append(_confirmed(measure, tolerance, r, A, b, x))
        if sizes[-1] < sizes[smallest]:
            best, smallest = x, len(sizes) - 1
        tell(*iterated(len(residuals) - 1, sizes[-1], tolerance))
    converged, done = sizes[smallest] <= tolerance, len(sizes) - 1
    reason = f"{why}smallest relative residual {sizes[smallest]:.1e} in iteration {smallest} of {done}"
    reason = MET if converged else f"{reason}, wanted {tolerance:.1e}"
    return History(frozen_float(best), frozen_float(residuals[: smallest + 1]), converged, reason)


def iterated(iterations: int, size: float, tolerance: float) -> tuple[float, str]:
    """How far an iteration has come, for ``tell``: digits won over those wanted, and its details.

    Parameters
    ----------
    iterations : int
        Done so far.
    size : float
        Of the residual, relative to the first one.
    tolerance : float
        Size wanted, below 1.
    """
    text = f"iteration {iterations}, relative residual {size:.1e}"
    if not 0.0 < tolerance < size < 1.0:
        return (1.0 if size <= tolerance else 0.0), text
    return float(np.log(size) / np.log(tolerance)), text


def _confirmed(measure: Measure, tolerance: float, r: Float, A: Any, b: Float, x: Float) -> float:
    """Size of the recursion's residual; of b − A x where that would end the iteration."""
    size = measure(r)
    return size if size > tolerance else max(size, measure(b - A @ x))
