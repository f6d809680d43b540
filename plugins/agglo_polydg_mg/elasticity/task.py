"""Elasticity problems for the default solver: system, multigrid levels and one right-hand side."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from agglo_core.authoring import Int, Mesh, OptionError, System, multigrid, solvers
from agglo_polydg_mg.elasticity.discretisation import Assembled
from agglo_polydg_mg.elasticity.levels import elastic_stack
from agglo_polydg_mg.polydg import Kept
from agglo_polydg_mg.solver.choose import Overrides, Plan, choose
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask


class ElasticityTask(DiffusionTask):
    """Elasticity problem discretised on a hierarchy's mesh, with its multigrid levels.

    The recipe ``conforming`` has a continuous vector space below the cells
    (:func:`~agglo_polydg_mg.elasticity.levels.elastic_stack`). The recipe ``agglomerates`` is smoothed
    aggregation of the cells with their rigid motions, on the agglomerates of the hierarchy if it has any,
    the choice for polyhedra. Parameters and exceptions are those of
    :class:`~agglo_polydg_mg.solver.diffusion_task.DiffusionTask`.
    """

    _how: Any

    def __init__(self, problem: Any, hierarchy: Any, how: Any, *rest: Any) -> None:
        super().__init__(problem, hierarchy, how.of_kind(problem.kind), *rest)

    def _discretise(self, mesh: Mesh, kept: Kept | None) -> solvers.FineSystem:
        self._assembled: Assembled = self._how.assembled(self.problem, mesh, self.basis)
        fine: solvers.FineSystem = self._how.fine_from(self._assembled, self.problem, mesh)
        return fine

    def _choose(self, overrides: Overrides) -> Plan:
        if overrides.recipe == "patches":
            raise OptionError("recipe 'patches' is for diffusion problems; for elasticity use recipe='auto'")
        given, sigma = replace(overrides, recipe="auto"), self._assembled.sigma
        stiffness, diagonal = self._assembled.material.acoustic[:, 1], self.fine.A.diagonal()
        plan = choose(self.basis.mesh, sigma, stiffness, self.basis.degree, given, diagonal)
        recipe: Any = overrides.recipe
        if recipe == "auto":
            recipe = "agglomerates" if plan.recipe == "agglomerates" else "conforming"
        smoother: Any = "cells" if plan.smoother == "cells" or recipe != "conforming" else "groups"
        cycle: Any = "V" if overrides.cycle == "auto" else overrides.cycle
        details = plan.reason[plan.reason.rindex("(") :]
        coarse = "continuous vectors and" if recipe == "conforming" else "rigid motions of the cells and"
        reason = (
            f"{coarse} their aggregates, {smoother}, {cycle}-cycle, {np.dtype(plan.dtype).name} {details}"
        )
        return replace(plan, recipe=recipe, smoother=smoother, cycle=cycle, reason=reason)

    @property
    def advice(self) -> str:
        """Advice to use a direct solver for small systems."""
        return solvers.advice_of_multigrid(self.fine.A, "linear", 1, self.penalty)

    @property
    def penalty(self) -> str:
        """``sharp``, the penalty that solvers accept for elasticity."""
        return "sharp"

    @property
    def makes_levels(self) -> bool:
        """False, because aggregates come from the matrix if the hierarchy has no agglomerates."""
        return False

    @cached_property
    def labels(self) -> list[Int]:
        """Agglomerate of each cell on the coarse levels, finest first, or none."""
        return solvers.chosen_levels(self.hierarchy, self.count) if self.hierarchy.levels else []

    def change_method(self) -> bool:
        """Switch to double precision, then to aggregates of cells, and return False if nothing is left."""
        if self.single:
            self.use_double()
            return True
        if self.plan.recipe == "agglomerates" or self._overrides.recipe != "auto":
            return False
        plan = self._choose(Overrides("agglomerates", self._overrides.cycle, "double"))
        self._plan = replace(plan, reason=f"{plan.reason} instead of: {self.plan.reason}, which failed")
        return True

    def parts(self, stack: multigrid.LevelStack) -> tuple[int | None, ...]:
        """Return the cell count on the finest level, and None on levels of vertices or aggregates."""
        return self.hierarchy.graph.n, *(None for _ in stack.levels[1:])

    def _build_levels(self, fine: solvers.FineSystem) -> multigrid.LevelStack:
        dtype, assembled = self.plan.dtype, self._assembled
        if self.plan.recipe == "conforming":
            return elastic_stack(
                assembled, fine.A, self.labels, groups=self.plan.smoother == "groups", dtype=dtype
            )
        parts = assembled.system.block_offsets, None, assembled.system.near_null
        return multigrid.stack_of_system(System.trusted(fine.A, fine.b, *parts), self.labels, dtype)
