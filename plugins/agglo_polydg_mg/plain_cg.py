"""Solve PolyDG systems by plain conjugate gradients, the paper's baseline (column CG)."""

from __future__ import annotations

from agglo_core.authoring import solvers
from agglo_polydg_mg.forms.penalty import PAPER, Penalty
from agglo_polydg_mg.polydg import PolyDG


class PlainCG(solvers.PlainCG):
    """Solve PolyDG systems by conjugate gradients from zero, without a preconditioner.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    tolerance : float
        Limit for the residual relative to the right-hand side, measured by
        :class:`~agglo_core.solvers.residual_measure.ResidualMeasure`, and for the energy error.
    max_iterations : int
        If these do not suffice, the solution is the iterate with the smallest residual, and
        ``iterations`` is its number, as in the paper's tables; ``reason`` gives the number of
        iterations done.
    penalty : float, "paper" or "sharp"
        Jump penalty: the constant C, ``paper`` for C = 10, or ``sharp``, see
        :class:`~agglo_polydg_mg.polydg.PolyDG`.
    scaled_basis : bool
        Scale the basis by each cell's bounding box size. The paper does not.
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
