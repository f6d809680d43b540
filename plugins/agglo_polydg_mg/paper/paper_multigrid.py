"""The paper's solver: a stationary V-cycle with additive Schwarz smoothing (paper, section 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NoReturn

from agglo_core.authoring import (
    Hierarchy,
    Linear,
    Listener,
    OptionError,
    Problem,
    Registry,
    Smoother,
    Solution,
    multigrid,
    solvers,
)
from agglo_polydg_mg.forms.penalty import PAPER, Penalty
from agglo_polydg_mg.paper.composed_multigrid import ComposedMultigrid
from agglo_polydg_mg.paper.schwarz import SmootherMaker, Solve, smoother_of


class PaperMultigrid(ComposedMultigrid):
    """The paper's choice of parts for :class:`~agglo_polydg_mg.paper.composed_multigrid.ComposedMultigrid`.

    V-cycles from zero until the residual has fallen below ``tolerance`` times the right-hand side.

    :class:`~agglo_core.solvers.residual_measure.ResidualMeasure` says how residuals are measured where
    the coefficient is not constant, so that no contrast hides them.

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
        :func:`~agglo_polydg_mg.paper.schwarz.schwarz`.
    schwarz_coarse : bool
        Whether smoothers that use it get the correction of the next level. The coarse matrix of this
        correction is inherited whatever ``operators`` says, as in the paper's experiments.
    coarse_solver : str, object with ``solver_for``, or callable
        Name of a component of kind ``coarse_solver``, such as ``"lu"``, ``"dense"`` and ``"elimination"``; a
        :class:`~agglo_core.multigrid.CoarseSolver`; or a function that makes a solver from a matrix.
    registry : Registry, optional
        Where the name of a smoother is looked up; by default that of the program.

    Notes
    -----
    The paper's smoother makes the cycle a nonlinear map: it cannot precondition conjugate
    gradients.
    """

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
        coarse_solver: str | multigrid.CoarseSolver | Callable[[Any], Solve] = "lu",
        *,
        registry: Registry | None = None,
    ) -> None:
        solvers.require_name("operators", operators, ("rediscretised", "inherited"))
        solvers.require_truth("schwarz_coarse", schwarz_coarse)
        chosen = smoother_of(smoother, registry)
        super().__init__(
            degree,
            transfer="injection",
            coarse_operator="galerkin" if operators == "inherited" else "rediscretised",
            smoother=chosen,  # type: ignore[arg-type]  # with its name
            coarse_solver=coarse_solver,
            cycle="V",
            outer="stationary",
            smoothing_steps=smoothing_steps,
            levels=levels,
            tolerance=tolerance,
            max_iterations=max_iterations,
            penalty=penalty,
            scaled_basis=scaled_basis,
            corrections=schwarz_coarse,
            registry=registry,
        )
        self.smoother = chosen.tool
        self._inherited = multigrid.Composition(
            "injection", "galerkin", chosen, coarse_solver, registry=registry
        )

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve by V-cycles; ``converged`` and ``reason`` say how it ended; ``progress`` is told the phases.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, no level is coarser than the mesh, or data are not finite.
        MeshError
            For a mesh of cells or agglomerates that overlap themselves; in 3-D, that are not convex.
        """
        solution = super().solve(problem, hierarchy, progress)
        if solution.converged or solution.iterations >= self.max_iterations:
            return solution
        rest = "the solver direct or polydg_cg"
        way_out = f"try {rest}" if self.parts_for(problem).galerkin else f"try operators=inherited, or {rest}"
        return replace(solution, reason=f"{solution.reason}; {way_out}")

    def parts_for(self, problem: Problem) -> multigrid.Composition:
        """The parts for a problem: matrices of a linear system are always inherited."""
        return self._inherited if isinstance(problem, Linear) else self.composition

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
