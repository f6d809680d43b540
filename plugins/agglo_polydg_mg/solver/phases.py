"""Phases shared by single and repeated solves: level set-up, iteration, solution."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.authoring import (
    Diffusion,
    Elasticity,
    Float,
    Hierarchy,
    History,
    Linear,
    Listener,
    OptionError,
    Problem,
    Solution,
    frozen_float,
    multigrid,
    phase,
    solvers,
)
from agglo_polydg_mg.elasticity.task import ElasticityTask
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.choose import Overrides
from agglo_polydg_mg.solver.convection_task import ConvectionTask
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask, Earlier

Task = DiffusionTask | solvers.LinearTask


def task_for(
    problem: Problem,
    hierarchy: Hierarchy,
    how: Any,
    overrides: Overrides,
    count: int | None,
    earlier: Earlier | None = None,
) -> Task:
    """Check that a problem fits a hierarchy, and discretise it unless it is a linear system.

    Discretised problems may use parts of an ``earlier`` problem of their kind on the hierarchy.
    """
    if not isinstance(problem, Linear) and not isinstance(how, PolyDG):
        if overrides.recipe != "auto":
            raise OptionError(f"recipe {overrides.recipe!r} requires the discretisation polydg")
        fine = solvers.fine_system(problem, hierarchy, how)
        return solvers.DiscretisedTask(fine, overrides.cycle, overrides.precision)
    if isinstance(problem, Diffusion) and solvers.has_convection(problem):
        earlier = (earlier or Earlier())._replace(plan=None)
        return ConvectionTask(problem, hierarchy, how, overrides, count, earlier)
    if isinstance(problem, Diffusion | Elasticity):
        made: Any = DiffusionTask if isinstance(problem, Diffusion) else ElasticityTask
        task: Task = made(problem, hierarchy, how, overrides, count, earlier)
        return task
    if isinstance(problem, Linear) and not problem.symmetric:
        return solvers.GeneralTask(problem, hierarchy, overrides.recipe, overrides.cycle, overrides.precision)
    if isinstance(problem, Linear):
        return solvers.LinearTask(
            problem, hierarchy, count, overrides.recipe, overrides.cycle, overrides.precision
        )
    raise OptionError(
        f"problem must be a Diffusion, an Elasticity or a Linear, given {type(problem).__name__}"
    )


def set_up(
    task: Task, watch: solvers.Stopwatch, progress: Listener | None, title: str = "setting up the levels"
) -> multigrid.LevelStack:
    """Build a task's multigrid levels, with timing and progress reports.

    Raises
    ------
    LinAlgError
        If a matrix is not positive definite.
    """
    if isinstance(task, DiffusionTask) and task.makes_levels:
        with watch("hierarchy"), phase(progress, "agglomerating"):
            _ = task.labels  # computed on first access
    with watch("setup"), phase(progress, title):
        stack: multigrid.LevelStack = task.stack()
        return stack


def initial_guess(task: Task, start: Float) -> list[History]:
    """Return a history without iterations that starts from the solution ``start (n,)`` in user numbering.

    Raises
    ------
    OptionError
        For another shape, values that are not finite, or a linear system.
    """
    if not isinstance(task, DiffusionTask):
        raise OptionError("start is an initial guess for discretised problems, not for linear systems")
    if np.shape(start) != task.fine.b.shape or not np.isfinite(start).all():
        raise OptionError(f"start must contain {task.fine.b.shape} finite numbers, given {np.shape(start)}")
    x = task.fine.factor * task.numbering.load(frozen_float(start))
    x = x if task.fine.offset is None else x - task.fine.offset
    return [History(frozen_float(x), frozen_float([np.nan]), False, "")]


def iterate(
    task: Task,
    stack: multigrid.LevelStack,
    tolerance: float,
    most: int,
    watch: solvers.Stopwatch,
    progress: Listener | None,
    before: list[History] | None = None,
    pace: float | None = None,
) -> list[History]:
    """Solve for all right-hand sides by iteration, and return their convergence histories.

    At most ``most`` iterations are done, including the iterations in ``before``.
    """
    n_remaining = most - max((item.iterations for item in before or () if not item.final), default=0)
    kind: Any = task.cycle
    M = multigrid.cycle(stack, kind)
    with watch("solve"), phase(progress, "solving") as notify:
        histories = task.iterate(M, tolerance, n_remaining, before, notify, pace)
    return (
        histories
        if before is None
        else [_join_histories(*item) for item in zip(before, histories, strict=True)]
    )


def build_solution(
    task: Task,
    histories: list[History],
    stack: multigrid.LevelStack,
    watch: solvers.Stopwatch,
    tolerance: float,
    *,
    fresh: bool = True,
) -> Solution:
    """Build the solution object from the convergence histories.

    The levels may belong to an earlier system.
    """
    advice = task.advice if fresh else ""  # reused levels are the cheapest choice
    solved = all(each.converged or each.ended == "rounding" for each in histories)
    if not solved and isinstance(task, DiffusionTask):
        advice = solvers.advice_after_failure(task.basis.degree, task.penalty)
    solution = replace(
        task.solution(histories, stack.operators, watch, tolerance),
        operator_complexity=stack.operator_complexity,
        grid_complexity=stack.grid_complexity,
        parts=task.parts(stack),
        memory=stack.memory,
        choice=task.choice + ("" if fresh else "; levels reused from an earlier system"),
        advice=advice,
    )
    return task.given_back(solution)


def zero_solution(task: Task, reason: str, watch: solvers.Stopwatch, tolerance: float) -> Solution:
    """Return the solution 0 for a task whose levels cannot be built."""
    nothing = task.solution(task.unsolved(reason), [(task.A, None)], watch, tolerance)
    return task.given_back(replace(nothing, choice=task.choice))


def _join_histories(first: History, second: History) -> History:
    """Join two convergence histories if the second continues the first."""
    if second is first or not first.iterations:
        return second
    residuals = np.concatenate((first.residuals, second.residuals[1:]))
    gains = np.concatenate((first.gains, second.gains))
    return replace(second, residuals=frozen_float(residuals), gains=frozen_float(gains))
