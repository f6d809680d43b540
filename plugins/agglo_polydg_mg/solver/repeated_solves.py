"""Solve sequences of systems, as in time stepping, and reuse the multigrid levels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from agglo_core.authoring import (
    Float,
    Hierarchy,
    History,
    Listener,
    OptionError,
    Problem,
    Solution,
    frozen_float,
    phase,
    solvers,
)
from agglo_core.threads import one_blas_thread
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.choose import Overrides, Plan
from agglo_polydg_mg.solver.diffusion_task import DiffusionTask, Earlier
from agglo_polydg_mg.solver.earlier_solutions import KEPT, best_combination
from agglo_polydg_mg.solver.equal_matrices import coefficients_of, equal_coefficients
from agglo_polydg_mg.solver.phases import Task, build_solution, iterate, set_up, task_for, zero_solution

_MORE: Final = 1.2
"""Levels are rebuilt after a solve that takes more than this many times the iterations of fresh levels from
0. A larger value saves set-ups and takes more iterations (benchmarks/time_steps.py --rates 0.05 0.5)."""
_CHANGED: Final = 10.0
"""Levels are rebuilt before a solve if the ratio of the diagonal entries to those of their matrix varies by
more than this factor: iterations grow with its root (benchmarks/time_steps.py --rates 0.5 --front)."""


class RepeatedSolves:
    """Solve a sequence of problems on one hierarchy, reusing the multigrid levels.

    Each system is assembled; the levels of an earlier system precondition it. As the matrix changes this
    costs iterations, but never accuracy: convergence is tested with the current matrix. Each solve starts
    from the combination of the last eight solutions with the smallest error
    (:func:`~agglo_polydg_mg.solver.earlier_solutions.best_combination`), or from 0 if its residual is larger.

    Levels are rebuilt for the next solve after more than 1.2 times the iterations that fresh levels take
    from 0. They are rebuilt within a solve that falls behind by over 0.3 times as many (see ``pace`` of
    :func:`agglo_core.multigrid.pcg`). That solve continues from its iterate, and the next solve builds
    levels of its own; after another such solve the next two do, then four, and so on until reused levels
    serve again. Levels with a different number of unknowns are never reused, nor those of a matrix whose
    diagonal entries have changed by factors that differ by more than 10.

    ``operators`` of a Solution belong to the levels in use, possibly from an earlier system, as its
    ``choice`` then states.

    Create an instance by :meth:`~agglo_polydg_mg.solver.polydg_multigrid.PolyDGMultigrid.repeated`. It is
    not thread-safe.

    Attributes
    ----------
    setups : int
        Number of times levels have been built.

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
        self._diagonal: Any = None  # of the matrix of the levels
        self._fitting: Any = None  # last matrix for which the levels were found to fit
        self._usual: float | None = None  # iterations from 0 with fresh levels
        self._pause = self._paused = (
            0  # solves with own levels after reused levels failed: number, and remaining
        )
        self._before: list[int] = []  # iterations before the levels were built
        self._earlier: list[list[Float]] = []
        self._geometry: dict[str, Earlier] = {}  # numbering and basis by kind of problem
        self._plan: Plan | None = None
        self._task: Task | None = None
        self._coefficients: Mapping[str, Any] = {}
        self._kind: type[Task] | None = None  # kind of system of the kept data

    def solve(
        self, problem: Problem, progress: Listener | None = None, *, load: Float | None = None
    ) -> Solution:
        """Solve as :meth:`.PolyDGMultigrid.solve` does, but reuse earlier levels and solutions.

        ``load (n,)`` is added to the right-hand side of a discretised problem. The matrix is reused if only
        source and boundary values differ from those of the last problem, and coefficients are numbers or
        cell values. It raises the same exceptions.
        """
        watch = solvers.Stopwatch()
        with watch("assemble"), phase(progress, "assembling"):
            plan = self._plan if self._kept else None
            coefficients, kept = coefficients_of(problem), None
            if isinstance(self._task, DiffusionTask) and equal_coefficients(coefficients, self._coefficients):
                kept = self._task.kept
            earlier = self._geometry.get(getattr(problem, "kind", ""), Earlier())
            task = task_for(problem, *self._made_of, earlier._replace(plan=plan, kept=kept))
            self._task, self._coefficients = task, coefficients
        return self._solve(_with_load(task, load), watch, progress)

    def solve_again(self, load: Float, progress: Listener | None = None) -> Solution:
        """Solve the last problem of :meth:`solve` with another ``load (n,)`` added, without assembling.

        Raises
        ------
        OptionError
            Without such a problem; see also :meth:`solve`.
        """
        if self._task is None:
            raise OptionError("no problem has been solved yet: call solve first")
        watch = solvers.Stopwatch()
        with watch("assemble"):
            task = _with_load(self._task, load, self._plan if self._kept else None)
        return self._solve(task, watch, progress)

    def _solve(self, task: Task, watch: solvers.Stopwatch, progress: Listener | None) -> Solution:
        # 1. Keep numbering and basis
        setups = self.setups
        if isinstance(task, DiffusionTask):
            self._geometry[task.problem.kind] = Earlier(task.numbering, task.basis)
        # 2. Drop levels and solutions that do not fit this system
        if type(task) is not self._kind:  # other numbering, or other levels
            self._kept, self._earlier, self._kind = None, [], type(task)
        if self._kept is not None and not self._fits(task.A):
            self._kept = None
        # 3. Iterate
        try:
            histories = self._histories(task, watch, progress)
        except np.linalg.LinAlgError as error:
            self._kept = None
            return zero_solution(task, str(error), watch, self._tolerance)
        # 4. Keep solution and levels for the next solve
        fresh = self.setups > setups
        solution = build_solution(task, histories, self._kept, watch, self._tolerance, fresh=fresh)
        self._judge(histories)
        return solution

    def _histories(self, task: Task, watch: solvers.Stopwatch, progress: Listener | None) -> list[History]:
        """Iterate with the kept levels, then if needed with fresh levels, then with fallback methods."""
        # 1. Kept levels, unless recent failures suspend them
        histories = self._started(task, watch)
        if self._paused:
            self._paused, self._kept = self._paused - 1, None
        if self._kept is not None:
            histories = self._iterate(task, self._most, histories, watch, progress, self._usual)
            if _all_finished(histories, self._most):
                self._pause = 0
                return histories
            self._pause = self._paused = max(1, 2 * self._pause)
        # 2. Fresh levels
        task.renew_plan()
        self._renew(task, histories, watch, progress)
        histories = self._iterate(task, self._most, histories, watch, progress)
        # 3. Other methods, while the preconditioner fails
        while any(each.preconditioner_failed for each in histories) and task.change_method():
            self._renew(task, histories, watch, progress, "setting up other levels")
            histories = self._iterate(task, self._most, histories, watch, progress)
        return histories

    def _fits(self, A: Any) -> bool:
        """Return True if the kept levels belong to a similar matrix, judged by its diagonal."""
        if A is self._fitting:
            return True
        diagonal = A.diagonal()
        if diagonal.shape != self._diagonal.shape:
            return False
        ratio = diagonal / self._diagonal
        fits = bool(ratio.max() <= _CHANGED * ratio.min())
        self._fitting = A if fits else None
        return fits

    def _started(self, task: Task, watch: solvers.Stopwatch) -> list[History] | None:
        """Return initial guesses as histories without iterations, or None without earlier solutions."""
        columns = task.columns
        if not self._earlier or [item.shape for item in self._earlier[-1]] != [b.shape for b in columns]:
            self._earlier = []
            return None
        with watch("solve"), one_blas_thread():  # the vectors are too short for several
            starts = [
                _not_worse_than_zero(
                    task.A, b, best_combination(task.A, b, [item[j] for item in self._earlier])
                )
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
        self._kept = None  # frees the old levels before the new ones are built
        self._kept, self._diagonal = set_up(task, watch, progress, title), task.A.diagonal()
        self._fitting = task.A
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
        """Keep the solutions for the next system, and the levels unless they took too many iterations."""
        if not all(history.final for history in histories):
            self._kept, self._earlier = None, []
            return
        self._earlier = [*self._earlier[1 - KEPT :], [_corrected_solution(history) for history in histories]]
        at = max(range(len(histories)), key=lambda j: histories[j].iterations)
        slowest = histories[at]
        if self._usual is None:
            residuals = slowest.residuals[self._before[at] if self._before else 0 :]
            digits = _digits(residuals)
            required_digits = max(digits, -math.log10(self._tolerance))
            self._usual = (len(residuals) - 1) * required_digits / digits if digits > 0.0 else None
        elif slowest.iterations > _MORE * self._usual:
            self._kept = None


def _with_load(task: Task, load: Float | None, plan: Plan | None = None) -> Task:
    if load is None:
        return task
    if not isinstance(task, DiffusionTask):
        raise OptionError("a load can be added only to discretised problems: alter b of the linear system")
    return task.with_load(load, plan)


def _not_worse_than_zero(A: Any, b: Float, x: Float) -> Float:
    """Return x, or 0 if the residual of x exceeds that of 0, as behind a front."""
    return x if np.linalg.norm(b - A @ x) <= np.linalg.norm(b) else frozen_float(np.zeros_like(x))


def _all_finished(histories: list[History], most: int) -> bool:
    return all(each.final or each.iterations >= most for each in histories)


def _corrected_solution(history: History) -> Float:
    """Return the last iterate plus the correction that its history contains.

    Extrapolation amplifies small errors, so the correction pays.
    """
    return history.x if history.correction is None else frozen_float(history.x + history.correction)


def _digits(residuals: Float) -> float:
    """Return the number of decimal digits by which the residuals fell."""
    first, last = float(residuals[0]), float(residuals[-1])
    return math.log10(first / last) if 0.0 < last < first else 0.0
