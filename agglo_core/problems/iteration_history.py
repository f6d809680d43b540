"""History of an iteration: iterate, residuals, error estimates and outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from agglo_core.arrays import Float, frozen_float

MET = "tolerance met"
"""Reason for convergence."""
TESTS = ("residual", "energy error")
"""Names of the two convergence tests."""

Ended = Literal[
    "",
    "met",
    "most iterations",
    "indefinite matrix",
    "singular matrix",
    "indefinite preconditioner",
    "loss of conjugacy",
    "preconditioner not finite",
    "matrix not finite",
    "stagnation",
    "rounding",
    "underflow",
]
"""Machine-readable end of an iteration, empty if the method does not report any."""

_BY_PRECONDITIONER = ("indefinite preconditioner", "loss of conjugacy", "preconditioner not finite")


def empty_array() -> Float:
    """Return an empty array ``(0,)``, for data that a method does not report."""
    return frozen_float([])


@dataclass(frozen=True, eq=False)
class History:
    """Final iterate ``x (n,)`` of an iteration, with residual history and outcome.

    ``residuals`` are 2-norms, starting before the first iteration.

    ``energy_error`` is an estimate of the relative error in the energy norm, or None. ``tests`` names the
    passed tests, ``"residual"`` and ``"energy error"``. ``reason`` explains the end in words, ``ended`` is
    the machine-readable code. ``relative_residual`` is the measure of b − A x, recomputed from x, or None.
    ``gains (iterations,)`` are the reductions of the squared energy error per iteration, or empty, and
    ``energy_norm`` is the energy norm of x.

    ``backward_error`` is set if the residual stagnates and the entries of A are available (see
    :func:`~agglo_core.problems.residuals.backward_error.backward_error`). An iteration that ``ended`` by
    ``"rounding"`` is as accurate as double precision allows. ``correction`` is the next step, with the length
    of the last, if available after convergence: with a good preconditioner, x + correction is more accurate,
    without proof.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import History
    >>> history = History(np.zeros(1), np.array([1.0, 0.1]), converged=True, reason="converged")
    >>> history.iterations, history.final
    (1, True)
    """

    x: Float
    residuals: Float
    converged: bool
    reason: str
    energy_error: float | None = None
    tests: tuple[str, ...] = ()
    ended: Ended = ""
    relative_residual: float | None = None
    gains: Float = field(default_factory=empty_array)
    energy_norm: float = 0.0
    backward_error: float | None = None
    correction: Float | None = None

    @property
    def energy_errors(self) -> Float:
        """Estimates of the relative energy error before the first and after each iteration, empty if unknown.

        The estimates sum the final error and all later gains (Hestenes and Stiefel, 1952). The identity holds
        for conjugate gradients with any preconditioner, because exact steps along any direction preserve it.
        """
        if self.energy_error is None or len(self.gains) != self.iterations or not self.energy_norm > 0.0:
            return empty_array()
        parts = np.append(np.sqrt(np.maximum(self.gains, 0.0)) / self.energy_norm, self.energy_error)
        return frozen_float(np.sqrt(np.cumsum(parts[::-1] ** 2)[::-1]))

    @property
    def iterations(self) -> int:
        """Iteration count."""
        return len(self.residuals) - 1

    @property
    def final(self) -> bool:
        """Return True if further iterations cannot help: converged, or limited by rounding."""
        return self.converged or self.ended == "rounding"

    @property
    def preconditioner_failed(self) -> bool:
        """Return True if a faulty preconditioner ended the iteration.

        Another preconditioner, for example in double precision, may continue from x.
        """
        return self.ended in _BY_PRECONDITIONER


def worst_column(histories: Sequence[History]) -> int:
    """Return the index of the worst of several histories.

    It is one that has not converged, if there is any, then the one with most iterations.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems.iteration_history import History, unsolved, worst_column
    >>> worst_column([History(np.zeros(1), np.ones(9), True, "converged"), unsolved(np.ones(1), "failed")])
    1
    """

    def badness(j: int) -> tuple[bool, int, float]:
        history = histories[j]
        return not history.converged, history.iterations, history.relative_residual or 0.0

    return max(range(len(histories)), key=badness)


def joint_outcome(histories: Sequence[History]) -> dict[str, Any]:
    """Return the attributes of a :class:`~agglo_core.problems.Solution` for one or several columns.

    Convergence, tests and errors hold for all columns; residuals, iterations and reason are those of the
    :func:`worst_column`.
    """
    worst, errors = histories[worst_column(histories)], [h.energy_error for h in histories]
    converged = all(h.converged for h in histories)
    return {
        "converged": converged,
        "reason": worst.reason,
        "residuals": worst.residuals,
        "iterations": worst.iterations,
        "energy_error": None if None in errors else max(h for h in errors if h is not None),
        "energy_errors": worst.energy_errors,
        "tests": tuple(name for name in TESTS if all(name in h.tests for h in histories)),
        "backward_error": max((h.backward_error or 0.0 for h in histories), default=0.0) or None,
        "rounding_limited": not converged and all(h.final for h in histories),
    }


def unsolved(b: Float, reason: str) -> History:
    """Return the history of a method that could not start.

    Examples
    --------
    >>> from agglo_core.problems.iteration_history import unsolved
    >>> unsolved(np.ones(4), "the matrix is singular").residuals
    array([2.])
    """
    return History(frozen_float(np.zeros(len(b))), frozen_float([np.linalg.norm(b)]), False, reason)


def iterated(iterations: int, size: float, tolerance: float) -> tuple[float, str]:
    """Return the iteration progress as a fraction (digits gained over digits required) and as text.

    Parameters
    ----------
    iterations : int
        Completed iterations.
    size : float
        Residual relative to the first residual.
    tolerance : float
        Required size, below 1.

    Examples
    --------
    >>> from agglo_core.problems.iteration_history import iterated
    >>> iterated(3, 1e-3, 1e-6)
    (0.5, 'iteration 3, relative residual 1.0e-03')
    """
    text = f"iteration {iterations}, relative residual {size:.1e}"
    if not 0.0 < tolerance < size < 1.0:
        return (1.0 if size <= tolerance else 0.0), text
    return float(np.log(size) / np.log(tolerance)), text


def mean_contraction(residuals: Float, first: int = 0) -> float | None:
    """Return the geometric mean of the residual reduction factors, from index ``first`` to the end.

    The result is None without iterations, or for residuals that are not positive and finite.

    Examples
    --------
    >>> round(mean_contraction([1.0, 0.5, 0.01]), 12)
    0.1
    """
    values = np.asarray(residuals, dtype=np.float64).ravel()
    steps = len(values) - 1 - first
    if steps < 1 or not (0.0 < values[first] < np.inf and 0.0 < values[-1] < np.inf):
        return None
    return float(np.exp((np.log(values[-1]) - np.log(values[first])) / steps))
