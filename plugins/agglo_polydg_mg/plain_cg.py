"""PolyDG by plain conjugate gradients: the baseline of multigrid methods (paper, column CG)."""

from __future__ import annotations

from agglo_core.authoring import solvers
from agglo_polydg_mg.forms.penalty import PAPER, Penalty
from agglo_polydg_mg.polydg import PolyDG


class PlainCG(solvers.PlainCG):
    """Conjugate gradients from zero on the system of the mesh, without a preconditioner.

    Parameters
    ----------
    degree : int
        Of the polynomials, 1..6.
    tolerance : float
        Of the residual relative to the right-hand side, by
        :class:`~agglo_core.solvers.residual_measure.ResidualMeasure`, and of the energy error.
    max_iterations : int
        If these are not enough, the solution is the iterate of smallest residual, and ``iterations`` its
        number, as in the paper's tables; ``reason`` says how many were done.
    penalty : float, "paper" or "sharp"
        Of jumps: the constant C, ``paper`` for C = 10, or ``sharp``, see
        :class:`~agglo_polydg_mg.polydg.PolyDG`.
    scaled_basis : bool
        Scale the basis by the size of each cell's bounding box. The paper does not.
    """

    def __init__(
        self,
        degree: int = 1,
        tolerance: float = 1e-6,
        max_iterations: int = 10_000,
        penalty: Penalty = PAPER,
        scaled_basis: bool = False,
    ) -> None:
        super().__init__(PolyDG(degree, penalty, scaled_basis), tolerance, max_iterations)
