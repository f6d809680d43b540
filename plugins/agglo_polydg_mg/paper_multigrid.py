"""The paper's solver: a stationary V-cycle with additive Schwarz smoothing (paper, section 5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal, NoReturn

import numpy as np

from agglo_core.authoring import (
    Hierarchy,
    Int,
    Linear,
    Listener,
    MultigridLevel,
    OptionError,
    Problem,
    Registry,
    Smoother,
    Solution,
    Tell,
    frozen_int,
    phase,
)
from agglo_polydg_mg.operators import LevelOperators, level_operators
from agglo_polydg_mg.option_checks import chosen, require_count, require_fraction, require_name, require_truth
from agglo_polydg_mg.penalty import PAPER, Penalty
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.schwarz import COARSE_SOLVERS, SmootherMaker, SolveMaker, correction
from agglo_polydg_mg.smoothers import set_up, smoother_of, smoother_title
from agglo_polydg_mg.stationary import SmoothedLevel, Step, stationary, unsolved, v_cycle
from agglo_polydg_mg.stopwatch import Stopwatch
from agglo_polydg_mg.transfer import chosen_levels

__all__ = ["PaperMultigrid"]


class PaperMultigrid:
    """V-cycles from zero until the residual has fallen below ``tolerance`` times the right-hand side.

    :class:`~agglo_polydg_mg.residual_measure.ResidualMeasure` says how residuals are measured where the
    coefficient is not constant, so that no contrast hides them.

    Parameters
    ----------
    degree : int
        Of the polynomials, 1..6.
    smoothing_steps : int
        Before and after each coarse correction.
    levels : int, optional
        How many of mesh, level 0, 1, … to use; by default all. The last one is solved directly.
    tolerance : float
    max_iterations : int
    penalty : float, "paper" or "sharp"
        Of jumps: the constant C, ``paper`` for C = 10, or ``sharp``, see
        :class:`~agglo_polydg_mg.polydg.PolyDG`.
    scaled_basis : bool
        Scale the basis by the size of each cell's bounding box. The paper does not.
    operators : "rediscretised" or "inherited"
        Coarse matrices: discretised on the agglomerates as in the paper, or Pᵀ A P. Those of a
        :class:`~agglo_core.problems.Linear` problem are always inherited.
    smoother : str, object with ``setup``, or callable
        Name of a component of kind ``smoother``, such as ``"schwarz"`` (conjugate gradients preconditioned
        by additive Schwarz as in the paper) and ``"block_jacobi"``; a
        :class:`~agglo_core.protocols.Smoother`; or a function that makes one from the same arguments as
        :func:`~agglo_polydg_mg.schwarz.schwarz`.
    schwarz_coarse : bool
        Whether smoothers that use it get the correction of the next level. The coarse matrix of this
        correction is inherited whatever ``operators`` says, as in the paper's experiments.
    coarse_solver : "lu", "dense" or callable
        Sparse or dense direct solver, or a function that makes one from a matrix.
    registry : Registry, optional
        Where the name of a smoother is looked up; by default that of the program.

    Notes
    -----
    The paper's smoother makes the cycle a nonlinear map: it cannot precondition conjugate
    gradients.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    tells_progress: ClassVar[bool] = True

    def __init__(
        self,
        degree: int = 1,
        smoothing_steps: int = 3,
        levels: int | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 2000,
        penalty: Penalty = PAPER,
        scaled_basis: bool = False,
        operators: Literal["rediscretised", "inherited"] = "rediscretised",
        smoother: str | Smoother | SmootherMaker = "schwarz",
        schwarz_coarse: bool = True,
        coarse_solver: str | SolveMaker = "lu",
        *,
        registry: Registry | None = None,
    ) -> None:
        require_count("smoothing_steps", smoothing_steps, 1)
        require_count("max_iterations", max_iterations, 1)
        if levels is not None:
            require_count("levels", levels, 2)
        require_fraction("tolerance", tolerance)
        require_name("operators", operators, ("rediscretised", "inherited"))
        require_truth("schwarz_coarse", schwarz_coarse)
        self.discretisation = PolyDG(degree, penalty, scaled_basis)
        self.smoothing_steps, self.levels = smoothing_steps, levels
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.inherited = self.galerkin = operators == "inherited"
        self.smoother = smoother_of(smoother, registry)
        self._smoother_title = smoother_title(smoother, registry)
        self.coarse_solver = chosen("coarse_solver", coarse_solver, COARSE_SOLVERS)
        self.schwarz_coarse = schwarz_coarse

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve by V-cycles; ``converged`` and ``reason`` say how it ended; ``progress`` is told the phases.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, no level is coarser than the mesh, or data are not finite.
        MeshError
            For a mesh in 3-D, or of cells or agglomerates that overlap themselves.
        """
        watch = Stopwatch()
        labels = chosen_levels(hierarchy, self.levels)
        with watch("assemble"), phase(progress, "assembling"):
            operators = level_operators(problem, hierarchy, labels, self.discretisation, self.inherited)
        fine = operators.fine
        try:
            with watch("setup"), phase(progress, "setting up the levels") as tell:
                step = self._cycle(operators, labels, tell)
        except np.linalg.LinAlgError as error:
            history = unsolved(fine.b, str(error))
        else:
            how_long = (self.tolerance, self.max_iterations)
            with watch("solve"), phase(progress, "solving") as tell:
                history = stationary(fine.A, fine.b, step, *how_long, fine.measure, tell)
        if not history.converged and history.iterations < self.max_iterations:
            history = replace(history, reason=f"{history.reason}; {self._way_out(problem)}")
        levels = list(zip(operators.A, [*operators.P, None], strict=True))
        return fine.solution(history, levels, watch, self.tolerance)

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> NoReturn:
        """Refuse: with conjugate gradients for a smoother the cycle is not linear.

        Raises
        ------
        OptionError
            Always; says what to take instead.
        """
        raise OptionError(
            "the paper's cycle cannot precondition Krylov methods: its smoother, some steps of conjugate "
            "gradients, makes it a nonlinear map; take another solver, or the levels (A, P) in the operators "
            "of its solution with a linear smoother"
        )

    def _way_out(self, problem: Problem) -> str:
        """What to try where the cycles fail."""
        rest = "the solver direct or polydg_cg"
        given = self.inherited or isinstance(problem, Linear)
        return f"try {rest}" if given else f"try operators=inherited, or {rest}"

    def _cycle(self, operators: LevelOperators, labels: Sequence[Int], tell: Tell) -> Step:
        """One V-cycle, ``(b, x)`` to a better x."""
        parts = [frozen_int(np.arange(operators.fine.A.shape[0] // operators.fine.width)), *labels]
        levels = []
        for level in range(len(operators.P)):
            tell(level / len(parts), f"level {level}")
            levels.append(self._level(operators, level, parts[level]))
        coarsest = self.coarse_solver(operators.A[-1])
        return lambda b, x: v_cycle(levels, coarsest, b, x)

    def _level(self, operators: LevelOperators, level: int, labels: Int) -> SmoothedLevel:
        A, P = operators.A[level], operators.P[level]
        wanted = self.schwarz_coarse and getattr(self.smoother, "uses_coarse", True)
        coarse = correction(P, self.coarse_solver(operators.inherited[level + 1])) if wanted else None
        offsets = frozen_int(np.arange(0, A.shape[0] + 1, operators.fine.width))
        B = operators.inherited[level]
        own = MultigridLevel(A, B, offsets, labels, P, coarse, self.smoothing_steps)
        return SmoothedLevel(A, P, set_up(self.smoother, self._smoother_title, own))
