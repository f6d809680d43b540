"""The default solver: conjugate gradients preconditioned by multigrid on agglomerates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Diffusion,
    Hierarchy,
    History,
    Listener,
    OptionError,
    Problem,
    Solution,
    frozen_float,
    multigrid,
    pcg,
    phase,
)
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.operators import FineSystem, fine_system
from agglo_polydg_mg.option_checks import require_count, require_fraction, require_name
from agglo_polydg_mg.penalty import Penalty
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.recipes import CYCLES, PRECISIONS, RECIPES, Plan, Wishes, levels_by_default, plan_for
from agglo_polydg_mg.stationary import unsolved
from agglo_polydg_mg.stopwatch import Stopwatch

__all__ = ["PolyDGMultigrid"]


class PolyDGMultigrid:
    """Conjugate gradients preconditioned by one multigrid cycle, whose recipe mesh and coefficient choose.

    Converged is said when both the residual and an estimate of the energy error are ``tolerance`` or less;
    see :func:`agglo_core.multigrid.pcg`.

    Parameters
    ----------
    degree : int
        Of the polynomials, 1..6.
    tolerance : float
    max_iterations : int
    recipe : "auto", "conforming" or "patches"
        A continuous space inside the discontinuous one, with its own multigrid on the agglomerates
        (:mod:`~agglo_polydg_mg.conforming_stack`); or polynomials on agglomerates, smoothed patch by patch
        (:mod:`~agglo_polydg_mg.patch_recipe`).
    cycle : "auto", "V", "W", "F" or "K"
    precision : "auto", "single" or "double"
        Of the cycle. Where single precision turns out not to suffice, double precision takes over.
    penalty : float, "paper" or "sharp"
        See :class:`~agglo_polydg_mg.polydg.PolyDG`.
    levels : int, optional
        How many of mesh, level 0, 1, … to use; by default all. Without a hierarchy levels of 8 cells to an
        agglomerate are made, and these are used as far as there are so many.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    needs_levels: ClassVar[bool] = False
    tells_progress: ClassVar[bool] = True
    galerkin: ClassVar[bool] = False  # they are, but in single precision and without small entries

    def __init__(
        self,
        degree: int = 1,
        tolerance: float = 1e-6,
        max_iterations: int = 300,
        recipe: Literal["auto", "conforming", "patches"] = "auto",
        cycle: Literal["auto", "V", "W", "F", "K"] = "auto",
        precision: Literal["auto", "single", "double"] = "auto",
        penalty: Penalty = "sharp",
        levels: int | None = None,
    ) -> None:
        require_fraction("tolerance", tolerance)
        require_count("max_iterations", max_iterations, 1)
        for name, value, known in (
            ("recipe", recipe, RECIPES),
            ("cycle", cycle, CYCLES),
            ("precision", precision, PRECISIONS),
        ):
            require_name(name, value, known)
        if levels is not None:
            require_count("levels", levels, 2)
        self.discretisation = PolyDG(degree, penalty, scaled_basis=True)
        self.tolerance, self.max_iterations, self.levels = tolerance, max_iterations, levels
        self.wishes = Wishes(recipe, cycle, precision)

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve; ``converged`` and ``reason`` say how it ended, ``choice`` which recipe was taken and why.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, or data are not finite.
        MeshError
            For a mesh in 3-D, or of cells that overlap themselves.
        """
        watch = Stopwatch()
        with watch("assemble"), phase(progress, "assembling"):
            fine = fine_system(problem, hierarchy, self.discretisation)
        made = _Setup(self, problem, fine, hierarchy)
        try:
            with watch("setup"), phase(progress, "setting up the levels"):
                stack = made.stack()
        except np.linalg.LinAlgError as error:
            return _told(
                fine.solution(unsolved(fine.b, str(error)), [(fine.A, None)], watch.wall), made, watch
            )
        with watch("solve"), phase(progress, "solving") as tell:
            history = self._iterate(fine, made, stack, None, tell)
        if history.preconditioner_failed and made.plan.dtype == np.float32:
            made.in_double()
            with watch("setup"), phase(progress, "setting up the levels in double precision"):
                stack = made.stack()
            with watch("solve"), phase(progress, "solving") as tell:
                history = _joined(history, self._iterate(fine, made, stack, history, tell))
        solution = fine.solution(history, stack.operators, watch.wall)
        return _told(
            replace(
                solution,
                operator_complexity=stack.operator_complexity,
                grid_complexity=stack.grid_complexity,
                parts=made.parts(stack),
                memory=stack.memory,
            ),
            made,
            watch,
        )

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """One cycle ``(n, n)`` in double precision: symmetric unless ``cycle`` is F or K.

        Raises
        ------
        OptionError
            As :meth:`solve`, or if the matrix is not positive definite.
        MeshError
            As :meth:`solve`.
        """
        made = _Setup(self, problem, fine_system(problem, hierarchy, self.discretisation), hierarchy)
        made.in_double()
        try:
            return multigrid.cycle(made.stack(), made.plan.cycle)
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"there is no preconditioner for this matrix: {failure}") from failure

    def _iterate(
        self, fine: FineSystem, made: _Setup, stack: Any, before: History | None, tell: Any
    ) -> History:
        return pcg(
            fine.A,
            fine.b,
            multigrid.cycle(stack, made.plan.cycle),
            None if before is None else before.x,
            tolerance=self.tolerance,
            most=self.max_iterations - (0 if before is None else before.iterations),
            stop="both",
            probe=False,
            measure=fine.measure,
            energy=fine.measure.energy,
            tell=tell,
        )


class _Setup:
    """What the levels of a system are made of, so that they can be made again in another precision."""

    def __init__(
        self, solver: PolyDGMultigrid, problem: Problem, fine: FineSystem, hierarchy: Hierarchy
    ) -> None:
        self.problem, self.fine, self.hierarchy, self.count = problem, fine, hierarchy, solver.levels
        diffusion = isinstance(problem, Diffusion) and hierarchy.fine is not None
        how = solver.discretisation
        self.basis = Basis(hierarchy.fine, how.degree, how.scaled_basis) if diffusion else None
        self.plan: Plan = plan_for(problem, fine, self.basis, solver.wishes)

    def stack(self) -> Any:
        labels = levels_by_default(self.hierarchy, self.count)
        return self.plan.stack(self.problem, self.fine, self.basis, labels)

    def parts(self, stack: Any) -> tuple[int | None, ...]:
        """Agglomerates of each level; None of a level with unknowns at vertices or of the matrix alone."""
        below, cells = stack.levels[1:], self.hierarchy.graph.n
        if self.plan.recipe != "patches":
            return cells, *(None for _ in below)
        return cells, *(int(each.labels.max()) + 1 for each in below)

    def in_double(self) -> None:
        """Go on in double precision."""
        if self.plan.dtype != np.float64:
            reason = f"{self.plan.reason}; double precision took over"
            self.plan = replace(self.plan, dtype=np.float64, reason=reason)


def _joined(first: History, second: History) -> History:
    """One history of two, the second of which went on from where the first ended."""
    return replace(second, residuals=frozen_float(np.concatenate((first.residuals, second.residuals[1:]))))


def _told(solution: Solution, made: _Setup, watch: Stopwatch) -> Solution:
    return replace(solution, cpu_seconds=watch.cpu, choice=made.plan.reason)
