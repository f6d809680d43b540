"""Problems with convection for the default solver, with levels smoothed downstream."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import Float, History, Int, Notify, OptionError, multigrid, solvers
from agglo_polydg_mg.auxiliary.downstream import downstream_stack
from agglo_polydg_mg.auxiliary.strong_faces import strong_part
from agglo_polydg_mg.forms.coefficients import cell_means
from agglo_polydg_mg.forms.convection import face_flows
from agglo_polydg_mg.solver.choose import BAD, Overrides, Plan
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask

_ACCEPTED = (
    ("recipe", ("auto", "agglomerates")),
    ("cycle", ("auto", "V", "W", "F")),
    ("precision", ("auto", "double")),
)
_FACTORISED = {2: 90_000, 3: 6_000}
"""Most unknowns of the coarsest level, by dimension: with more levels the iterations grow where streamlines
are closed, and factors take much memory in 3-D (benchmarks/elliptic.py --rows Péclet)."""


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
        cycle: Any = "W" if overrides.cycle == "auto" else overrides.cycle
        mesh = self.basis.mesh
        bad = mesh.dim == 2 and strong_part(mesh, self._sigma) > BAD
        smoother: Any = "patches" if bad else "cells"
        reason = f"polynomials on agglomerates, {smoother} downstream, {cycle}-cycle, float64 (convection)"
        return Plan(
            "agglomerates",
            cycle,
            np.float64,
            smoother,
            False,
            "aggregates",
            False,
            False,
            0.0,
            reason,
            "linear",
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
        mesh, owner, other = self.basis.mesh, *self.basis.mesh.face_cells.T
        kappa = cell_means(mesh, self.problem.kappa)
        mean = 2.0 / (1.0 / kappa[owner] + 1.0 / kappa[other])  # used on inner faces alone
        diffusion = self._sigma * mean * mesh.face_measures
        strength = 0.5 * np.abs(face_flows(mesh, self.problem.convection)) + diffusion
        inner, fewest = other >= 0, _FACTORISED[mesh.dim] // self.basis.n_local
        ends = mesh.face_cells[inner]
        return multigrid.paired_levels(ends, strength[inner], mesh.n_cells, fewest, self.count)

    def stack(self) -> multigrid.LevelStack:
        """Build the multigrid levels.

        Raises
        ------
        OptionError
            For an option for symmetric matrices alone.
        LinAlgError
            If a block or the matrix of the coarsest level is singular.
        """
        mesh = self.numbering.mesh
        patches = multigrid.vertex_patches(mesh) if self.plan.smoother == "patches" else None
        return downstream_stack(self._how, self.problem, mesh, self.basis, self.fine.A, self.labels, patches)

    @property
    def _sigma(self) -> Float:
        """Jump penalty of each face of the basis mesh."""
        sigma = self.fine.sigma
        assert sigma is not None  # every discretised system has a penalty
        return sigma

    def change_method(self) -> bool:
        """Return False, because there are no fallback methods."""
        return False

    def iterate(
        self,
        M: LinearOperator,
        tolerance: float,
        most: int,
        before: Sequence[History] | None,
        notify: Notify,
        pace: float | None = None,
    ) -> list[History]:
        """Run :func:`~agglo_core.multigrid.gcr`, and return the convergence history in a list.

        The iteration continues from the end of the histories ``before``, if given.
        """
        start: Float | None = before[0].x if before else None
        fine = self.fine
        limits: dict[str, Any] = {"tolerance": tolerance, "most": most, "pace": pace}
        return [multigrid.gcr(fine.A, fine.b, M.matvec, start, **limits, measure=fine.measure, notify=notify)]
