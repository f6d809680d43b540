"""The paper's solver: a stationary V-cycle with additive Schwarz smoothing (paper, section 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal, NoReturn

from agglo_core.authoring import (
    Hierarchy,
    Linear,
    Listener,
    MultigridLevel,
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
from agglo_polydg_mg.paper.schwarz import Smooth, Solve, smoother_of


class PaperMultigrid(ComposedMultigrid):
    """Solve by V-cycles with the transfer, coarse matrices and smoother of the paper.

    The cycles start from zero and repeat until the residual is below ``tolerance`` times the right-hand
    side. If the coefficient is not constant,
    :class:`~agglo_core.solvers.residual_measure.ResidualMeasure` defines the residual norm, so that no
    contrast hides residuals. The general class is
    :class:`~agglo_polydg_mg.paper.composed_multigrid.ComposedMultigrid`.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    smoothing_steps : int
        Steps before and after each coarse correction.
    levels : int, optional
        Number of levels to use from mesh, level 0, 1, …; by default all. The last level is solved
        directly.
    tolerance : float
    max_iterations : int
    penalty : float, "paper" or "sharp"
        Jump penalty: the constant C, ``paper`` for C = 10, or ``sharp``, see
        :class:`~agglo_polydg_mg.polydg.PolyDG`.
    scaled_basis : bool
        Scale the basis by each cell's bounding box size. The paper does not.
    operators : "rediscretised" or "inherited"
        Coarse matrices: discretised on the agglomerates as in the paper, or Pᵀ A P. A
        :class:`~agglo_core.problems.Linear` problem always inherits them.
    smoother : str, object with ``setup``, or callable
        Name of a component of kind ``smoother``, for example ``"schwarz"`` (conjugate gradients
        preconditioned by additive Schwarz as in the paper) or ``"block_jacobi"``; a
        :class:`~agglo_core.protocols.Smoother`; or a function that replaces its ``setup``.
    schwarz_coarse : bool
        Pass the correction by the next level to smoothers that use it. The coarse matrix of this
        correction is inherited for any ``operators``, as in the paper's experiments.
    coarse_solver : str, object with ``solver_for``, or callable
        Name of a component of kind ``coarse_solver``, for example ``"lu"``, ``"dense"`` or
        ``"elimination"``; a :class:`~agglo_core.multigrid.CoarseSolver`; or a function that maps a
        matrix to a solver.
    registry : Registry, optional
        Registry for the name of the smoother; by default the program's.

    Notes
    -----
    The paper's smoother makes the cycle a nonlinear map: it cannot precondition conjugate gradients.
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
        smoother: str | Smoother | Callable[[MultigridLevel], Smooth] = "schwarz",
        schwarz_coarse: bool = True,
        coarse_solver: str | multigrid.CoarseSolver | Callable[[Any], Solve] = "lu",
        *,
        registry: Registry | None = None,
    ) -> None:
        solvers.require_name("operators", operators, ("rediscretised", "inherited"))
        solvers.require_truth("schwarz_coarse", schwarz_coarse)
        smoother_member = smoother_of(smoother, registry)
        super().__init__(
            degree,
            transfer="injection",
            coarse_operator="galerkin" if operators == "inherited" else "rediscretised",
            smoother=smoother_member,  # type: ignore[arg-type]  # with its name
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
        self.smoother = smoother_member.tool
        self._inherited = multigrid.Composition(
            "injection", "galerkin", smoother_member, coarse_solver, registry=registry
        )

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve a problem on a hierarchy by V-cycles.

        The solution's ``converged`` and ``reason`` state the outcome; ``progress`` receives the
        phases.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, no level is coarser than the mesh, or data are not
            finite.
        MeshError
            For a mesh with self-overlapping cells or agglomerates; in 3-D, with nonconvex ones.
        """
        solution = super().solve(problem, hierarchy, progress)
        if solution.converged or solution.iterations >= self.max_iterations:
            return solution
        rest = "the solver direct or polydg_cg"
        way_out = f"try {rest}" if self.parts_for(problem).galerkin else f"try operators=inherited, or {rest}"
        return replace(solution, reason=f"{solution.reason}; {way_out}")

    def parts_for(self, problem: Problem) -> multigrid.Composition:
        """Return the multigrid parts for a problem, with Galerkin coarse matrices for a linear system."""
        return self._inherited if isinstance(problem, Linear) else self.composition

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> NoReturn:
        """Raise OptionError: conjugate gradients as a smoother make the cycle nonlinear.

        Raises
        ------
        OptionError
            Always; the message names alternatives.
        """
        raise OptionError(
            "the paper's cycle cannot precondition Krylov methods: its smoother (conjugate gradient "
            "steps) makes it nonlinear; use another solver, or combine the levels (A, P) in the operators "
            "of its solution with a linear smoother"
        )
