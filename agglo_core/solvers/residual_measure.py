"""Size of a residual for stopping tests, robust to high contrast of the coefficient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from agglo_core.arrays import Float
from agglo_core.problems.residuals.sizes import energy_of_solution, relative_size, two_norm


@dataclass(frozen=True, eq=False)
class ResidualMeasure:
    """Size of a residual ``r (n,)`` relative to the right-hand side ``b (n,)``.

    Where the coefficient κ is constant it is ‖r‖ / ‖b‖. Otherwise it is the larger of two such ratios, since
    rows of A are proportional to κ, and so are the terms of Dirichlet data in b:

    - r and b are divided by the coefficient of the cell, so that cells of small κ count;
    - r is taken as it is, and Dirichlet data are counted as if κ were everywhere its smallest value. An
      island of large κ between cells of small κ is held by forces of their size: beside those of
      Dirichlet data elsewhere at large κ, a wrong value of the whole island would go unnoticed.

    Attributes
    ----------
    b : (n,) float
    kappa : (n,) float, optional
        Coefficient of the cell of each unknown; None where it is constant.
    load : (n,) float, optional
        b without the terms of Dirichlet data; None if there are none.
    norm : callable, optional
        Energy norm of a solution with the jumps from its Dirichlet data; None if there are none.
    rows : callable, optional
        Measure of residuals of a linear system in place of these
        (:func:`~agglo_core.problems.residuals.row_scales.row_measure`).
    """

    b: Float
    kappa: Float | None = None
    load: Float | None = None
    norm: Callable[[Float], float] | None = None
    rows: Callable[[Float], float] | None = None

    def energy(self, x: Float) -> float:
        """What the energy norm of the error of ``x (n,)`` is compared with: the energy norm of x."""
        return energy_of_solution(self.b)(x) if self.norm is None else self.norm(x)

    @cached_property
    def _sizes(self) -> tuple[float, float]:
        """What ‖r‖ and ‖r / κ‖ are compared with."""
        if self.kappa is None:
            return two_norm(self.b), 0.0
        load = self.b if self.load is None else self.load
        counted = load + (self.b - load) * (self.kappa.min() / self.kappa)
        return two_norm(counted), two_norm(self.b / self.kappa)

    def __call__(self, r: Float) -> float:
        """Relative size; 0 where r and b are 0."""
        if self.rows is not None:
            return self.rows(r)
        plain, scaled = self._sizes
        size = relative_size(r, plain)
        return size if self.kappa is None else max(size, relative_size(r / self.kappa, scaled))
