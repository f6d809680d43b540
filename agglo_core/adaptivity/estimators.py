"""Estimators by the residuals that a discretisation offers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.problems import Diffusion, Solution
from agglo_core.solvers import factor_for, show_options, times

_OSCILLATION = "oscillation"


class Residual:
    """Estimate the error in the energy norm from the residuals of the equation.

    Implements :class:`~agglo_core.protocols.Estimator` for diffusion problems, discretised with a method
    ``residuals`` (:class:`~agglo_core.problems.Discretisation`).
    """

    accepts: ClassVar[tuple[str, ...]] = (Diffusion.kind,)
    inside: ClassVar[bool] = True

    def __repr__(self) -> str:
        return show_options(self)

    def indicate(self, solution: Solution) -> Float:
        """Return the share of each cell ``(n_cells,)`` in the estimate, the root of the sum of squares."""
        squares, factor = self._squares(solution)
        counted = [values for name, values in squares.items() if name != _OSCILLATION]
        return frozen_float(np.sqrt(sum(counted)) / factor)

    def terms(self, solution: Solution) -> Mapping[str, Float]:
        """Return the parts of the estimate ``(n_cells,)``, and the data oscillation that they contain."""
        squares, factor = self._squares(solution)
        return {name: frozen_float(np.sqrt(values) / factor) for name, values in squares.items()}

    def _squares(self, solution: Solution) -> tuple[Mapping[str, Float], float]:
        """Return the squared residuals of the solution times a factor, which keeps them in range."""
        how, mesh, problem = solution.discretisation, solution.mesh, solution.problem
        residuals = getattr(how, "residuals", None)
        if residuals is None or mesh is None or not isinstance(problem, Diffusion):
            raise OptionError(
                f"{type(self).__name__} estimates the error of diffusion problems, discretised with a method "
                f"residuals; given a solution of {type(problem).__name__} by {type(how).__name__}"
            )
        factor = factor_for(float(np.abs(solution.x).max(initial=0.0)))
        scaled = problem if factor == 1.0 else times(problem, factor)
        more = {} if self.inside else {"inside": False}
        return residuals(scaled, mesh, factor * solution.x, **more), factor


class GradientJump(Residual):
    """Estimate the error from the residuals on faces, without those inside the cells.

    As an estimate it lacks the source, but it serves to choose cells.
    """

    inside: ClassVar[bool] = False
