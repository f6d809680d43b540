"""Default solver: conjugate gradients preconditioned by multigrid on agglomerates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Float,
    Hierarchy,
    Listener,
    OptionError,
    Problem,
    Registry,
    Solution,
    multigrid,
    phase,
    solvers,
)
from agglo_polydg_mg.forms.penalty import Penalty
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.choose import CYCLES, PRECISIONS, RECIPES, Overrides
from agglo_polydg_mg.solver.phases import (
    Task,
    build_solution,
    initial_guess,
    iterate,
    set_up,
    task_for,
    zero_solution,
)
from agglo_polydg_mg.solver.repeated_solves import RepeatedSolves


class PolyDGMultigrid:
    """Solve by conjugate gradients with one multigrid cycle as preconditioner.

    Mesh and coefficient determine the cycle recipe. The solution counts as converged if both the
    residual and an estimate of the energy error are at most ``tolerance``; see
    :func:`agglo_core.multigrid.pcg`.

    Problems with convection are solved by :func:`agglo_core.multigrid.gcr`, with polynomials on agglomerates
    and cells smoothed downstream (:mod:`~agglo_polydg_mg.auxiliary.downstream`). Their energy error is
    unknown, and the residual alone is tested. Linear systems with ``symmetric=False`` are solved alike, with
    aggregates of strongly coupled unknowns (:func:`~agglo_core.multigrid.flow_stack`). Both take the cycles
    V, W and F and double precision. Convection takes the recipes ``auto`` and ``agglomerates``.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    tolerance : float
    max_iterations : int
    recipe : "auto", "conforming", "patches" or "agglomerates"
        Coarse spaces and their smoother. ``conforming``: a continuous space inside the discontinuous space,
        with its own multigrid on the graph of its matrix, or on agglomerates if given
        (:mod:`~agglo_polydg_mg.auxiliary.conforming_stack`). ``patches``: polynomials on agglomerates,
        smoothed patch by patch (:mod:`~agglo_polydg_mg.auxiliary.patch_recipe`). ``agglomerates``: in 3-D,
        polynomials on agglomerates, smoothed cell by cell. Linear systems take ``auto``, or
        ``agglomerates`` to use the agglomerates as aggregates even if each cell has one unknown.
    cycle : "auto", "V", "W", "F" or "K"
    precision : "auto", "single" or "double"
        Cycle precision. If single precision does not suffice, the solver switches to double.
    penalty : float, "paper" or "sharp"
        See :class:`~agglo_polydg_mg.polydg.PolyDG`.
    levels : int, optional
        Number of levels to use from mesh, level 0, 1, …; by default all. For a diffusion problem without
        levels, agglomerates with 8 cells each are made if ``levels`` is given, or for the recipe
        ``patches``.
    discretisation : str, tuple or object
        Name of a discretisation, name with options, or an object. Other discretisations than ``polydg`` use
        classical coarsening of their matrix, with unknowns inside the cells eliminated.
    registry : Registry, optional
        Registry of names. Default: the program's.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "elasticity", "linear")
    needs_levels: ClassVar[bool] = False
    reports_progress: ClassVar[bool] = True
    takes_start: ClassVar[bool] = True
    galerkin: ClassVar[bool] = False  # only nearly: single precision, small entries dropped

    def __init__(
        self,
        degree: int = 1,
        tolerance: float = 1e-6,
        max_iterations: int = 300,
        recipe: Literal["auto", "conforming", "patches", "agglomerates"] = "auto",
        cycle: Literal["auto", "V", "W", "F", "K"] = "auto",
        precision: Literal["auto", "single", "double"] = "auto",
        penalty: Penalty = "sharp",
        levels: int | None = None,
        discretisation: str | tuple[str, Mapping[str, Any]] | Any = "polydg",
        *,
        registry: Registry | None = None,
    ) -> None:
        solvers.require_fraction("tolerance", tolerance)
        solvers.require_count("max_iterations", max_iterations, 1)
        for name, value, choices in (
            ("recipe", recipe, RECIPES),
            ("cycle", cycle, CYCLES),
            ("precision", precision, PRECISIONS),
        ):
            solvers.require_name(name, value, choices)
        if levels is not None:
            solvers.require_count("levels", levels, 2)
        own, defaults = {"penalty": penalty}, {"penalty": "sharp"}
        self.discretisation = (
            PolyDG(degree, penalty, scaled_basis=True)
            if discretisation == "polydg"
            else solvers.chosen_discretisation(discretisation, registry, degree, own, defaults)
        )
        self.tolerance, self.max_iterations, self.levels = tolerance, max_iterations, levels
        self.overrides = Overrides(recipe, cycle, precision)

    def __repr__(self) -> str:
        return solvers.show_options(self)

    def solve(
        self,
        problem: Problem,
        hierarchy: Hierarchy,
        progress: Listener | None = None,
        start: Float | None = None,
    ) -> Solution:
        """Solve a problem on a hierarchy, from the initial guess ``start (n,)`` if the solver discretises it.

        The solution's ``converged`` and ``reason`` state the outcome, ``choice`` the recipe and its
        reason. A linear system may have blocks with any sizes, near-null vectors, and several
        right-hand sides ``b (n, k)``. With one unknown per cell the preconditioner is classical
        multigrid, otherwise smoothed aggregation with block Gauss–Seidel, on the agglomerates of the
        hierarchy or, without any, on the matrix graph.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, or data are not finite.
        MeshError
            If cells overlap themselves.
        """
        watch = solvers.Stopwatch()
        with watch("assemble"), phase(progress, "assembling"):
            task = self._task(problem, hierarchy)
        try:
            # Choose the plan from mesh, penalty and coefficient, and build the levels
            stack = set_up(task, watch, progress)
            begun = None if start is None else initial_guess(task, start)
            histories = iterate(task, stack, self.tolerance, self.max_iterations, watch, progress, begun)
            # If the preconditioner fails, continue in double precision or with another recipe
            while any(each.preconditioner_failed for each in histories) and task.change_method():
                del stack  # frees the memory for the other levels
                stack = set_up(task, watch, progress, "setting up other levels")
                histories = iterate(
                    task, stack, self.tolerance, self.max_iterations, watch, progress, histories
                )
        except np.linalg.LinAlgError as error:
            return zero_solution(task, str(error), watch, self.tolerance)
        return build_solution(task, histories, stack, watch, self.tolerance)

    def repeated(self, hierarchy: Hierarchy) -> RepeatedSolves:
        """Return a solver for a sequence of problems on a hierarchy, as in time stepping.

        It reuses the levels; see :class:`~agglo_polydg_mg.solver.repeated_solves.RepeatedSolves`.
        """
        if not isinstance(self.discretisation, PolyDG):
            raise OptionError("repeated solves require the discretisation polydg: use the solver direct")
        return RepeatedSolves(
            hierarchy,
            self.discretisation,
            self.overrides,
            self.levels,
            self.tolerance,
            self.max_iterations,
        )

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """Return one multigrid cycle as a preconditioner ``(n, n)``, in double precision.

        The cycle is symmetric unless ``cycle`` is F or K.

        Raises
        ------
        OptionError
            See :meth:`solve`; also if the matrix is not symmetric and positive definite.
        MeshError
            See :meth:`solve`.
        """
        solvers.require_symmetric_problem(problem, "aspreconditioner")
        task = self._task(problem, hierarchy)
        task.use_double()
        try:
            kind: Any = task.cycle
            M = multigrid.cycle(task.stack(), kind)
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"cannot build a preconditioner for this matrix: {failure}") from failure
        return task.preconditioner(M)

    def _task(self, problem: Problem, hierarchy: Hierarchy) -> Task:
        return task_for(problem, hierarchy, self.discretisation, self.overrides, self.levels)
