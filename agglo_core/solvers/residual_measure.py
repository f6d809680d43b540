"""Residual size for stopping tests, robust to high-contrast coefficients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from agglo_core.arrays import Float, frozen_float
from agglo_core.problems.residuals.sizes import energy_of_solution, relative_size, two_norm


@dataclass(frozen=True, eq=False)
class ResidualMeasure:
    """Size of residuals ``r (n,)`` relative to the right-hand side ``b (n,)``.

    For a constant coefficient κ the size is ‖r‖ / ‖b‖. Otherwise, as rows of A and the Dirichlet terms in b
    are proportional to κ, the size is the larger of two ratios:

    - r and b divided by the cell coefficient, so that cells with small κ count;
    - r as is, with Dirichlet terms scaled to the smallest κ. An island of large κ among cells of small κ is
      held by forces of their size. Compared with Dirichlet terms at large κ elsewhere, a wrong value on the
      whole island would go unnoticed.

    Attributes
    ----------
    b : (n,) float
    kappa : (n,) float, optional
        Coefficient of each unknown's cell, or None if constant.
    load : (n,) float, optional
        b without Dirichlet terms, or None if b has none.
    norm : callable, optional
        Energy norm for solutions, including jumps from Dirichlet data, or None without such data.
    rows : callable, optional
        Residual measure for linear systems, used instead of the measure above
        (:func:`~agglo_core.problems.residuals.row_scales.row_measure`).
    """

    b: Float
    kappa: Float | None = None
    load: Float | None = None
    norm: Callable[[Float], float] | None = None
    rows: Callable[[Float], float] | None = None

    def with_load(self, load: Float) -> ResidualMeasure:
        """Return the measure for the right-hand side b + load, without further Dirichlet terms."""
        own = None if self.load is None else frozen_float(self.load + load)
        return replace(self, b=frozen_float(self.b + load), load=own)

    def energy(self, x: Float) -> float:
        """Return the energy norm of ``x (n,)``, the reference for relative energy errors."""
        return energy_of_solution(self.b)(x) if self.norm is None else self.norm(x)

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        """Reference values for ‖r‖ and ‖r / κ‖, from the right-hand side."""
        if self.kappa is None:
            return two_norm(self.b), 0.0
        load = self.b if self.load is None else self.load
        counted = load + (self.b - load) * (self.kappa.min() / self.kappa)
        return two_norm(counted), two_norm(self.b / self.kappa)

    def __call__(self, r: Float) -> float:
        """Return the relative size of a residual r, or 0 if r and b are 0."""
        if self.rows is not None:
            return self.rows(r)
        plain, scaled = self._sizes
        size = relative_size(r, plain)
        return size if self.kappa is None else max(size, relative_size(r / self.kappa, scaled))
