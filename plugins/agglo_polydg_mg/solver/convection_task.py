"""Problems with convection for the default solver, with levels smoothed downstream."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import Float, History, Int, OptionError, Tell, multigrid, solvers
from agglo_polydg_mg.auxiliary.downstream import downstream_stack
from agglo_polydg_mg.solver.choose import Overrides, Plan
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask

_ACCEPTED = (
    ("recipe", ("auto", "agglomerates")),
    ("cycle", ("auto", "V", "W", "F")),
    ("precision", ("auto", "double")),
)


class ConvectionTask(DiffusionTask):
    """Diffusion problem with convection, discretised on a hierarchy's mesh, with its multigrid levels.

    The levels are those of :func:`~agglo_polydg_mg.auxiliary.downstream.downstream_stack`.
    """

    def _choose(self, overrides: Overrides) -> Plan:
        """Return the plan, the same for all meshes.

        Raises
        ------
        OptionError
            For a recipe, cycle or precision for symmetric matrices alone.
        """
        for name, accepted in _ACCEPTED:
            given = getattr(overrides, name)
            if given not in accepted:
                raise OptionError(
                    f"{name} {given!r} requires a symmetric matrix, but the problem has convection: use one "
                    f"of {', '.join(accepted)}"
                )
        cycle: Any = "V" if overrides.cycle == "auto" else overrides.cycle
        reason = f"polynomials on agglomerates, cells downstream, {cycle}-cycle, float64 (convection)"
        return Plan(
            "agglomerates", cycle, np.float64, "cells", False, "aggregates", False, 0.0, reason, "linear"
        )

    @property
    def advice(self) -> str:
        """No advice: costs with convection are not tabulated."""
        return ""

    @cached_property
    def labels(self) -> list[Int]:
        """Agglomerate of each cell on the coarse levels, finest first."""
        if self.hierarchy.levels:
            return solvers.chosen_levels(self.hierarchy, self.count)
        return solvers.default_levels(self.hierarchy, self.count)

    def stack(self) -> multigrid.LevelStack:
        """Build the multigrid levels.

        Raises
        ------
        OptionError
            For an option for symmetric matrices alone.
        LinAlgError
            If a block or the matrix of the coarsest level is singular.
        """
        _ = self.plan  # checks the options
        mesh = self.numbering.mesh
        return downstream_stack(self._how, self.problem, mesh, self.basis, self.fine.A, self.labels)

    def change_method(self) -> bool:
        """Return False, because there are no fallback methods."""
        return False

    def iterate(
        self,
        M: LinearOperator,
        tolerance: float,
        most: int,
        before: Sequence[History] | None,
        tell: Tell,
        pace: float | None = None,
    ) -> list[History]:
        """Run :func:`~agglo_core.multigrid.gcr`, and return the convergence history in a list.

        The iteration continues from the end of the histories ``before``, if given.
        """
        start: Float | None = before[0].x if before else None
        fine, options = self.fine, {"tolerance": tolerance, "most": most, "pace": pace}
        return [multigrid.gcr(fine.A, fine.b, M.matvec, start, **options, measure=fine.measure, tell=tell)]
