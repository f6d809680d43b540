"""Solving systems one after the other, as in time stepping: levels are kept as long as they serve."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from agglo_core.authoring import (
    Float,
    Hierarchy,
    History,
    Listener,
    Problem,
    Solution,
    frozen_float,
    phase,
    solvers,
)
from agglo_polydg_mg.forms.unit_forms import UnitForms
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.choose import Overrides, Plan
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask
from agglo_polydg_mg.solver.earlier_solutions import KEPT, best_combination
from agglo_polydg_mg.solver.numbering import Numbering
from agglo_polydg_mg.solver.phases import Task, iterate, set_up, solved, task_for, unsolved

_MORE: Final = 1.5
"""Levels are renewed once a solve takes more than so many times the iterations of fresh ones from 0, and
within a solve whose first iterations promise that."""
_FAR_MORE: Final = 3.0
"""A solve that takes more than so many times those goes on with fresh levels."""


class RepeatedSolves:
    """Solves problems on one hierarchy, with levels that are made once and kept while they serve.

    Each system is assembled anew; the levels of an earlier one precondition it, which costs iterations as the
    matrix changes, but never accuracy: convergence is judged by the matrix at hand. Each solve starts from
    the combination of the last eight solutions that has the smallest error
    (:func:`~agglo_polydg_mg.solver.earlier_solutions.best_combination`). Levels are renewed for the next
    solve after one that took over 1.5 times the iterations that fresh levels take from 0. They are renewed
    within a solve whose first five iterations promise as many, or that takes over 3 times as many; that solve
    goes on from where it is, and the next one makes levels of its own: after another such solve the next two,
    and so on, twice as many each time until kept levels serve again. Levels of another number of unknowns are
    never used. From the second system on, what a κ of one number in each cell only scales is kept
    (:class:`~agglo_polydg_mg.forms.unit_forms.UnitForms`): about twice the memory of the matrix, 2 GiB at
    most. ``operators`` of a Solution are those of the levels in use, of an earlier system perhaps, as its
    ``choice`` then says. Made by :meth:`~agglo_polydg_mg.solver.polydg_multigrid.PolyDGMultigrid.repeated`;
    not for several threads at once.

    Attributes
    ----------
    setups : int
        How many times levels have been made.

    Examples
    --------
    >>> from agglo_core import agglomerate, samples
    >>> from agglo_core.problems import Diffusion
    >>> from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid
    >>> steps = PolyDGMultigrid().repeated(agglomerate(samples.squares(8), n_parts=(16, 4)))
    >>> all(steps.solve(Diffusion(kappa=1.0 + 0.1 * k)).converged for k in range(3)), steps.setups
    (True, 1)
    """

    def __init__(
        self,
        hierarchy: Hierarchy,
        how: PolyDG,
        overrides: Overrides,
        count: int | None,
        tolerance: float,
        most: int,
    ) -> None:
        self.setups = 0
        self._made_of = (hierarchy, how, overrides, count)
        self._tolerance, self._most = tolerance, most
        self._kept: Any = None
        self._usual: float | None = None  # iterations from 0 with fresh levels
        self._pause = self._paused = (
            0  # solves with levels of their own after kept levels failed, and those left
        )
        self._before: list[int] = []  # iterations with others, when they were made
        self._earlier: list[list[Float]] = []
        self._units: UnitForms | None = None
        self._numbering: Numbering | None = None
        self._plan: Plan | None = None
        self._renumbered = False  # what is kept

    def solve(self, problem: Problem, progress: Listener | None = None) -> Solution:
        """Solve, as :meth:`.PolyDGMultigrid.solve` does, with the same errors."""
        watch, setups = solvers.Stopwatch(), self.setups
        with watch("assemble"), phase(progress, "assembling"):
            plan = self._plan if self._kept else None
            task = task_for(problem, *self._made_of, self._units, plan, self._numbering)
        if isinstance(task, DiffusionTask) and self._units is None:
            self._units, self._numbering = UnitForms(task.basis), task.numbering  # nothing is made of it yet
        renumbered = isinstance(task, DiffusionTask) and task.numbering.cells is not None
        if renumbered != self._renumbered:  # a linear system before or after a diffusion problem
            self._kept, self._earlier, self._renumbered = None, [], renumbered
        if self._kept is not None and self._kept.levels[0].A.shape != task.A.shape:
            self._kept = None
        try:
            histories = self._histories(task, watch, progress)
        except np.linalg.LinAlgError as error:
            self._kept = None
            return unsolved(task, str(error), watch, self._tolerance)
        fresh = self.setups > setups
        solution = solved(task, histories, self._kept, watch, self._tolerance, fresh=fresh)
        self._judge(histories)
        return solution

    def _histories(self, task: Task, watch: solvers.Stopwatch, progress: Listener | None) -> list[History]:
        """Iterate with the levels there are, then as far as needed with fresh ones, then with others."""
        histories = self._started(task, watch)
        if self._paused:
            self._paused, self._kept = self._paused - 1, None
        if self._kept is not None:
            most, pace = self._most, None
            if self._usual is not None:
                most = min(most, math.ceil(_FAR_MORE * self._usual))
                pace = _MORE * self._usual + 1.0
            histories = self._iterate(task, most, histories, watch, progress, pace)
            if _finished(histories, self._most):
                self._pause = 0
                return histories
            self._pause = self._paused = max(1, 2 * self._pause)
        task.renew_plan()
        self._renew(task, histories, watch, progress)
        histories = self._iterate(task, self._most, histories, watch, progress)
        while any(each.preconditioner_failed for each in histories) and task.change_method():
            self._renew(task, histories, watch, progress, "setting up other levels")
            histories = self._iterate(task, self._most, histories, watch, progress)
        return histories

    def _started(self, task: Task, watch: solvers.Stopwatch) -> list[History] | None:
        """Histories of no iterations that end where to begin; None to begin from 0."""
        columns = task.columns
        if not self._earlier or [each.shape for each in self._earlier[-1]] != [b.shape for b in columns]:
            self._earlier = []
            return None
        with watch("solve"):
            starts = [
                best_combination(task.A, b, [each[j] for each in self._earlier])
                for j, b in enumerate(columns)
            ]
        return [History(x, frozen_float([np.nan]), False, "") for x in starts]

    def _renew(
        self,
        task: Task,
        before: list[History] | None,
        watch: solvers.Stopwatch,
        progress: Listener | None,
        title: str = "setting up the levels",
    ) -> None:
        self._kept = None  # the levels of before are not needed while those to come are made
        self._kept = set_up(task, watch, progress, title)
        self._plan = task.plan if isinstance(task, DiffusionTask) else None
        self.setups, self._usual = self.setups + 1, None
        self._before = [each.iterations for each in before or ()]

    def _iterate(
        self,
        task: Task,
        most: int,
        before: list[History] | None,
        watch: solvers.Stopwatch,
        progress: Listener | None,
        pace: float | None = None,
    ) -> list[History]:
        return iterate(task, self._kept, self._tolerance, most, watch, progress, before, pace)

    def _judge(self, histories: list[History]) -> None:
        """Keep the solutions for the next system, and the levels if they serve."""
        if not all(each.final for each in histories):
            self._kept, self._earlier = None, []
            return
        self._earlier = [*self._earlier[1 - KEPT :], [_nearer(each) for each in histories]]
        at = max(range(len(histories)), key=lambda j: histories[j].iterations)
        slowest = histories[at]
        if self._usual is None:
            residuals = slowest.residuals[self._before[at] if self._before else 0 :]
            digits = _digits(residuals)
            wanted = max(digits, -math.log10(self._tolerance))
            self._usual = (len(residuals) - 1) * wanted / digits if digits > 0.0 else None
        elif slowest.iterations > _MORE * self._usual + 1.0:
            self._kept = None


def _finished(histories: list[History], most: int) -> bool:
    return all(each.final or each.iterations >= most for each in histories)


def _nearer(history: History) -> Float:
    """The solution with what is known of its error: extrapolation makes much of what a few lack."""
    return history.x if history.correction is None else frozen_float(history.x + history.correction)


def _digits(residuals: Float) -> float:
    """Digits by which residuals fell."""
    first, last = float(residuals[0]), float(residuals[-1])
    return math.log10(first / last) if 0.0 < last < first else 0.0
