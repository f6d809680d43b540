"""Plain conjugate gradients: the baseline for multigrid methods (column CG in the paper's tables)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.hierarchy import Hierarchy
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
from agglo_core.problems import Problem, Solution
from agglo_core.progress import Listener, phase
from agglo_core.solvers.fine_system import fine_system
from agglo_core.solvers.option_checks import require_count, require_fraction, show_options
from agglo_core.solvers.stopwatch import Stopwatch


class PlainCG:
    """Conjugate gradients without preconditioner for the system on the mesh, starting from zero.

    The levels of the hierarchy are not used. If ``max_iterations`` do not suffice, the solution is the
    iterate with the smallest residual and ``iterations`` its number, as in the paper's tables. ``reason``
    then gives the total iteration count.

    Parameters
    ----------
    discretisation : object
        Discretisation for problems other than linear systems
        (:func:`~agglo_core.solvers.fine_system.fine_system`).
    tolerance : float
        Bound on the residual relative to the right-hand side (measured by
        :class:`~agglo_core.solvers.residual_measure.ResidualMeasure`) and on the energy error.
    max_iterations : int
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "elasticity", "linear")
    plain_cg: ClassVar[bool] = True
    reports_progress: ClassVar[bool] = True

    def __init__(self, discretisation: Any, tolerance: float = 1e-6, max_iterations: int = 10_000) -> None:
        require_fraction("tolerance", tolerance)
        require_count("max_iterations", max_iterations, 1)
        self.discretisation = discretisation
        self.tolerance, self.max_iterations = tolerance, max_iterations

    def __repr__(self) -> str:
        return show_options(self)

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve the problem. ``converged`` and ``reason`` describe the outcome, ``progress`` receives phases.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, or data are not finite.
        MeshError
            For a mesh with self-overlapping cells.
        """
        watch = Stopwatch()
        with watch("assemble"), phase(progress, "assembling"):
            fine = fine_system(problem, hierarchy, self.discretisation)
        how_long = (self.tolerance, self.max_iterations)
        with watch("solve"), phase(progress, "solving") as notify:
            history = conjugate_gradients(
                fine.A, fine.b, *how_long, fine.measure, fine.measure.energy, notify
            )
        return fine.solution(history, [(fine.A, None)], watch, self.tolerance)

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """Return the identity ``(n, n)``, because plain conjugate gradients have no preconditioner.

        Raises
        ------
        OptionError, MeshError
            As :meth:`solve`.
        """
        fine = fine_system(problem, hierarchy, self.discretisation)
        return LinearOperator(fine.A.shape, matvec=np.copy, rmatvec=np.copy, dtype=np.float64)
