"""Compose a multigrid solver from named parts, a cycle and an outer iteration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Hierarchy,
    Int,
    Listener,
    Notify,
    OptionError,
    Problem,
    Registry,
    Smoother,
    Solution,
    multigrid,
    phase,
    solvers,
)
from agglo_core.progress import ignore_progress
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.paper.level_spaces import LevelSpaces, level_spaces
from agglo_polydg_mg.paper.outer_iterations import (
    CYCLES,
    OUTER,
    Cycle,
    Outer,
    iterate,
    require_linear,
    require_together,
)
from agglo_polydg_mg.paper.schwarz import Solve
from agglo_polydg_mg.polydg import PolyDG


class ComposedMultigrid:
    """Solve PolyDG or linear systems by multigrid with user-chosen parts.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    transfer : str, object with ``prolongation``, or callable
        ``smoothed``, ``injection``, ``aggregation`` or another component of kind ``transfer``. Parts
        are documented in :class:`agglo_core.multigrid.Composition`.
    coarse_operator : str, object with ``coarse_matrix``, or callable
        ``galerkin``, ``rediscretised`` or another component of kind ``coarse_operator``.
    smoother : str, object with ``setup``, or callable
        Component of kind ``smoother``: ``gauss_seidel``, ``chebyshev``, ``vertex_patches``,
        ``schwarz``, ….
    coarse_solver : str, object with ``solver_for``, or callable
        ``elimination``, ``dense``, ``lu`` or another component of kind ``coarse_solver``.
    cycle : "V", "W", "F" or "K"
        F is not symmetric and K not linear; see :func:`agglo_core.multigrid.cycle`.
    outer : "cg", "flexible_cg" or "stationary"
        Conjugate gradients, for a linear and symmetric cycle; flexible conjugate gradients, for any
        cycle; or the repeated cycle alone.
    smoothing_steps : int
        Steps before and after each coarse correction.
    levels : int, optional
        Number of levels to use from mesh, level 0, 1, …; by default all. The last level is solved
        directly.
    tolerance : float
    max_iterations : int
    penalty : float, "paper" or "sharp"
        See :class:`~agglo_polydg_mg.polydg.PolyDG`.
    scaled_basis : bool
        Scale the basis by each cell's bounding box size.
    corrections : bool
        Pass the correction by the next level to smoothers that use it. Its matrices are inherited,
        Pᵀ A P from the mesh down, for any coarse operator.
    registry : Registry, optional
        Registry for names; by default the program's.

    Raises
    ------
    OptionError
        For any other value, and for a cycle that the iteration cannot use.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    reports_progress: ClassVar[bool] = True

    def __init__(
        self,
        degree: int = 1,
        transfer: str | multigrid.Transfer = "smoothed",
        coarse_operator: str | multigrid.CoarseOperator = "galerkin",
        smoother: str | Smoother = "gauss_seidel",
        coarse_solver: str | multigrid.CoarseSolver | Callable[[Any], Solve] = "elimination",
        cycle: Cycle = "V",
        outer: Outer = "cg",
        smoothing_steps: int = 1,
        levels: int | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 1000,
        penalty: Penalty = "sharp",
        scaled_basis: bool = True,
        corrections: bool = True,
        *,
        registry: Registry | None = None,
    ) -> None:
        solvers.require_count("smoothing_steps", smoothing_steps, 1)
        solvers.require_count("max_iterations", max_iterations, 1)
        if levels is not None:
            solvers.require_count("levels", levels, 2)
        solvers.require_fraction("tolerance", tolerance)
        solvers.require_name("cycle", cycle, CYCLES)
        solvers.require_name("outer", outer, OUTER)
        solvers.require_truth("corrections", corrections)
        require_together(cycle, outer)
        self.discretisation = PolyDG(degree, penalty, scaled_basis)
        self.composition = multigrid.Composition(
            transfer, coarse_operator, smoother, coarse_solver, registry=registry
        )
        self.cycle, self.outer = cycle, outer
        self.smoothing_steps, self.levels, self.corrections = smoothing_steps, levels, corrections
        self.tolerance, self.max_iterations = tolerance, max_iterations

    def __repr__(self) -> str:
        return solvers.show_options(self)

    @property
    def galerkin(self) -> bool:
        """True if coarse matrices are Pᵀ A P."""
        return self.composition.galerkin

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve a problem on a hierarchy.

        The solution's ``converged`` and ``reason`` state the outcome, ``choice`` names the parts.

        Raises
        ------
        OptionError
            If problem, hierarchy and parts do not fit together, no level is coarser than the mesh, data
            are not finite, or the cycle is not linear and symmetric with ``outer`` ``cg``.
        MeshError
            For a mesh with self-overlapping cells; for such agglomerates if rediscretised.
        """
        # 1. Assemble the system and the level spaces
        watch = solvers.Stopwatch()
        labels = solvers.chosen_levels(hierarchy, self.levels)
        with watch("assemble"), phase(progress, "assembling"):
            spaces = level_spaces(problem, hierarchy, labels, self.discretisation)
        fine, parts = spaces.fine, self.parts_for(problem)
        choice = f"{parts.title}, {self.cycle}-cycle, {self.outer}"
        # 2. Set up the levels and the cycle
        try:
            with watch("setup"), phase(progress, "setting up the levels") as notify:
                stack = self._stack(parts, spaces, labels, notify)
                M = self._cycle(parts, stack)
        except np.linalg.LinAlgError as failure:
            watch.wall["solve"] = watch.cpu["solve"] = 0.0
            history = solvers.unsolved(fine.b, str(failure))
            nothing = fine.solution(history, [(fine.A, None)], watch, self.tolerance)
            return replace(nothing, choice=choice)
        # 3. Iterate
        with watch("solve"), phase(progress, "solving") as notify:
            history = iterate(self.outer, fine, M, self.tolerance, self.max_iterations, notify)
        return replace(
            fine.solution(history, stack.operators, watch, self.tolerance),
            operator_complexity=stack.operator_complexity,
            grid_complexity=stack.grid_complexity,
            parts=stack.parts,
            memory=stack.memory,
            choice=choice,
        )

    def parts_for(self, problem: Problem) -> multigrid.Composition:
        """Return the multigrid parts for a problem: transfer, coarse operator, smoother, coarse solver."""
        return self.composition

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """Return one multigrid cycle as a preconditioner ``(n, n)``, symmetric if ``outer`` is ``cg``.

        Raises
        ------
        OptionError, MeshError
            See :meth:`solve`; also if the matrix is not positive definite.
        """
        labels = solvers.chosen_levels(hierarchy, self.levels)
        spaces = level_spaces(problem, hierarchy, labels, self.discretisation)
        parts = self.parts_for(problem)
        try:
            M = self._cycle(parts, self._stack(parts, spaces, labels))
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"cannot build a preconditioner for this matrix: {failure}") from failure
        return spaces.fine.preconditioner(M)

    def _stack(
        self,
        parts: multigrid.Composition,
        spaces: LevelSpaces,
        labels: Sequence[Int],
        notify: Notify = ignore_progress,
    ) -> multigrid.LevelStack:
        return parts.stack(
            spaces.system,
            labels,
            injected=spaces.injected,
            rediscretised=spaces.rediscretised,
            steps=self.smoothing_steps,
            corrections=self.corrections,
            notify=notify,
        )

    def _cycle(self, parts: multigrid.Composition, stack: multigrid.LevelStack) -> LinearOperator:
        M = multigrid.cycle(stack, self.cycle)
        if self.outer == "cg":
            require_linear(M, parts.title)
        return M
