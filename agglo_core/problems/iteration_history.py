"""History of an iteration: iterate, residuals, error estimates and outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from agglo_core.arrays import Float, frozen_float

MET = "tolerance met"
"""The reason of an iteration that converged."""
TESTS = ("residual", "energy error")
"""What has to be small for that."""

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
"""Why an iteration ended, for programs; empty where the method does not tell."""

_BY_PRECONDITIONER = ("indefinite preconditioner", "loss of conjugacy", "preconditioner not finite")


def untold() -> Float:
    """Numbers ``(0,)`` of what a method does not tell."""
    return frozen_float([])


@dataclass(frozen=True, eq=False)
class History:
    """An iterate ``x (n,)`` and the 2-norms of residuals that led to it, the first before any iteration.

    ``energy_error`` is an estimate of the error of x in the energy norm, relative to that of x, None if there
    is none; ``tests`` are those of ``"residual"`` and ``"energy error"`` that x has passed. ``reason`` says
    to people why the iteration ended, ``ended`` to programs. ``relative_residual`` is the measure of b − A x,
    computed from x; None if the method does not tell. ``gains (iterations,)`` are what the iterations took
    from the square of the error in the energy norm, empty if the method does not tell; ``energy_norm`` is
    that of x. Where the residual fell no further ``backward_error`` is that of x, as
    :func:`~agglo_core.problems.residuals.backward_error.backward_error` has it, if A is known entry by entry;
    an iteration that ``ended`` by ``"rounding"`` is then as accurate as double precision allows.
    ``correction`` is the next step, as long as the last, if the iteration converged and knows it: with a good
    preconditioner x is nearer yet with it, though not known to be.

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
    gains: Float = field(default_factory=untold)
    energy_norm: float = 0.0
    backward_error: float | None = None
    correction: Float | None = None

    @property
    def energy_errors(self) -> Float:
        """Estimates of the relative energy error before any iteration and after each; empty if unknown.

        What is left at the end, and all that was gained from an iterate on (Hestenes and Stiefel, 1952): an
        identity for conjugate gradients with any preconditioner, as a step along any direction keeps it.
        """
        if self.energy_error is None or len(self.gains) != self.iterations or not self.energy_norm > 0.0:
            return untold()
        parts = np.append(np.sqrt(np.maximum(self.gains, 0.0)) / self.energy_norm, self.energy_error)
        return frozen_float(np.sqrt(np.cumsum(parts[::-1] ** 2)[::-1]))

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.residuals) - 1

    @property
    def final(self) -> bool:
        """Whether nothing is gained by going on: it converged, or is limited by rounding."""
        return self.converged or self.ended == "rounding"

    @property
    def preconditioner_failed(self) -> bool:
        """Whether the preconditioner ended it: one in double precision, say, may go on from x."""
        return self.ended in _BY_PRECONDITIONER


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
    """How far an iteration has come, for ``tell``: digits won over those wanted, and its details.

    Parameters
    ----------
    iterations : int
        Done so far.
    size : float
        Of the residual, relative to the first one.
    tolerance : float
        Size wanted, below 1.

    Examples
    --------
    >>> from agglo_core.authoring import iterated
    >>> iterated(3, 1e-3, 1e-6)
    (0.5, 'iteration 3, relative residual 1.0e-03')
    """
    text = f"iteration {iterations}, relative residual {size:.1e}"
    if not 0.0 < tolerance < size < 1.0:
        return (1.0 if size <= tolerance else 0.0), text
    return float(np.log(size) / np.log(tolerance)), text


def mean_contraction(residuals: Float, first: int = 0) -> float | None:
    """Geometric mean of the factors by which residuals fall, from one with a number to the last.

    None without an iteration, or where they are not positive numbers.

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
