"""The paper's solver: a stationary V-cycle with additive Schwarz smoothing (paper, section 5)."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Literal

import numpy as np

from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.problem import Diffusion, Linear, Problem, Solution
from agglo_polydg_mg.cycle import Level, Step, stationary, unsolved, v_cycle
from agglo_polydg_mg.operators import Chain, Discretisation, linear_chain, polydg_chain
from agglo_polydg_mg.schwarz import COARSE_SOLVERS, SMOOTHERS, block_jacobi, correction
from agglo_polydg_mg.transfer import chosen_levels

__all__ = ["PaperMultigrid"]


class PaperMultigrid:
    """V-cycles from zero until the residual has fallen below ``tolerance`` times the right-hand side.

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
    penalty : float
        Constant C of the penalty of jumps.
    scaled_basis : bool
        Scale the basis by the size of each cell's bounding box. The paper does not.
    operators : "rediscretised" or "inherited"
        Coarse matrices: discretised on the agglomerates as in the paper, or Pᵀ A P. Those of a
        :class:`~agglo_core.problem.Linear` problem are inherited in any case.
    smoother : "schwarz" or "block_jacobi"
        Conjugate gradients preconditioned by additive Schwarz as in the paper, or damped Jacobi.
    schwarz_coarse : bool
        Whether the Schwarz preconditioner has a coarse space, the next level. Blocks and coarse matrix
        of this preconditioner are inherited whatever ``operators`` says, as in the paper's experiments.
    coarse_solver : "lu" or "dense"
        Sparse or dense direct solver.

    Notes
    -----
    The paper's smoother makes the cycle a nonlinear map: it does not serve as a preconditioner of
    conjugate gradients.
    """

    def __init__(
        self,
        degree: int = 1,
        smoothing_steps: int = 3,
        levels: int | None = None,
        tolerance: float = 1e-6,
        max_iterations: int = 2000,
        penalty: float = 10.0,
        scaled_basis: bool = False,
        operators: Literal["rediscretised", "inherited"] = "rediscretised",
        smoother: str = "schwarz",
        schwarz_coarse: bool = True,
        coarse_solver: str = "lu",
    ) -> None:
        _check_count("degree", degree, 1, 6)
        _check_count("smoothing_steps", smoothing_steps, 1)
        _check_count("max_iterations", max_iterations, 1)
        if levels is not None:
            _check_count("levels", levels, 2)
        if not 0.0 < tolerance < 1.0:
            raise OptionError(f"tolerance must lie between 0 and 1, given {tolerance!r}")
        if not (penalty > 0.0 and np.isfinite(penalty)):
            raise OptionError(f"penalty must be positive, given {penalty!r}")
        _check_name("operators", operators, ("rediscretised", "inherited"))
        _check_name("smoother", smoother, SMOOTHERS)
        _check_name("coarse_solver", coarse_solver, COARSE_SOLVERS)
        self.discretisation = Discretisation(degree, penalty, scaled_basis)
        self.smoothing_steps, self.levels = smoothing_steps, levels
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.inherited = operators == "inherited"
        self.smoother, self.schwarz_coarse, self.coarse_solver = smoother, schwarz_coarse, coarse_solver

    def solve(self, problem: Problem, hierarchy: Hierarchy) -> Solution:
        """Solve by V-cycles; ``converged`` and ``reason`` say how it ended.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, no level is coarser than the mesh, or data are not finite.
        """
        times = [time.perf_counter()]
        chain = self._chain(problem, hierarchy)
        times.append(time.perf_counter())
        try:
            step = self._cycle(chain)
        except np.linalg.LinAlgError as error:
            times.append(time.perf_counter())
            history = unsolved(chain.b, str(error))
        else:
            times.append(time.perf_counter())
            history = stationary(chain.finest, chain.b, step, self.tolerance, self.max_iterations)
        times.append(time.perf_counter())
        return Solution(
            x=history.x,
            A=chain.finest,
            b=chain.b,
            operators=list(zip(chain.A, [*chain.P, None], strict=True)),
            residuals=history.residuals,
            converged=history.converged,
            reason=history.reason,
            iterations=history.iterations,
            seconds=dict(zip(("assemble", "setup", "solve"), np.diff(times).tolist(), strict=True)),
        )

    def _chain(self, problem: Problem, hierarchy: Hierarchy) -> Chain:
        labels = chosen_levels(hierarchy, self.levels)
        if isinstance(problem, Linear):
            chain = linear_chain(problem, hierarchy, labels)
        elif isinstance(problem, Diffusion):
            chain = polydg_chain(problem, hierarchy, labels, self.discretisation, self.inherited)
        else:
            raise OptionError(f"a problem is a Diffusion or a Linear, given {type(problem).__name__}")
        if not (np.isfinite(chain.b).all() and np.isfinite(chain.finest.data).all()):
            raise OptionError("matrix or right-hand side hold values that are not finite")
        return chain

    def _cycle(self, chain: Chain) -> Step:
        """One V-cycle, ``(b, x)`` to a better x."""
        direct, smoother = COARSE_SOLVERS[self.coarse_solver], SMOOTHERS[self.smoother]
        schwarz = self.smoother == "schwarz"
        matrices = chain.inherited if schwarz else chain.A  # the paper preconditions by inherited ones
        levels = []
        for level, P in enumerate(chain.P):
            local = block_jacobi(matrices[level], chain.width)
            wanted = schwarz and self.schwarz_coarse
            coarse = correction(P, direct(matrices[level + 1])) if wanted else None
            A = chain.A[level]
            levels.append(Level(A, P, smoother(A, local, coarse, self.smoothing_steps)))
        coarsest = direct(chain.A[-1])
        return lambda b, x: v_cycle(levels, coarsest, b, x)


def _check_count(name: str, value: int, least: int, most: int | None = None) -> None:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        wanted = f"{least}..{most}" if most is not None else f"at least {least}"
        raise OptionError(f"{name} must be a whole number, {wanted}; given {value!r}")


def _check_name(option: str, value: str, known: Iterable[str]) -> None:
    if value not in known:
        raise OptionError(f"{option} must be one of {', '.join(known)}; given {value!r}")
