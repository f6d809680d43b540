"""Recursion of preconditioned conjugate gradients, without stopping rule."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from agglo_core.arrays import Float
from agglo_core.multigrid.krylov.lanczos import Curvatures, RitzValue


@dataclass(eq=False)
class Recursion:
    """Conjugate gradients for A x = b with a preconditioner M, from an iterate ``x (n,)``.

    An iteration consists of :meth:`curve`, :meth:`move`, :meth:`precondition` and :meth:`turn`. The caller
    computes A p and z = M r, because products for several right-hand sides are computed together. Between
    ``move`` and ``precondition``, the caller may replace ``r`` by b − A x and call :meth:`restart` instead of
    ``turn``.

    Attributes
    ----------
    x, r, z, p : (n,) float
        Iterate, residual, preconditioned residual and direction.
    zr : float
        z·r.
    pp : float
        p·M⁻¹p by recursion, as z·p_before is 0.
    alpha, gain : float
        Length of the last step in units of p, and its reduction of ‖e‖_A² for the error e.
    ritz : RitzValue
        θ, the smallest Ritz value of M A.
    """

    x: Float
    r: Float
    z: Float = field(init=False)
    p: Float = field(init=False)
    zr: float = 0.0
    zr_before: float = 0.0
    pp: float = 0.0
    alpha: float = 0.0
    gain: float = 0.0
    curvature: float = 0.0
    ritz: RitzValue = field(default_factory=RitzValue)
    curvatures: Curvatures = field(default_factory=Curvatures)
    _r_before: Float | None = None
    _x_start: Float | None = None  # x at the last restart, None for 0
    _x_added: Float = field(init=False)

    def restart(self) -> None:
        """Begin anew with the direction p = z.

        Later steps are summed separately, so that x is rounded once.
        """
        self.p, self.pp = self.z, self.zr
        self._x_start, self._x_added = (self.x if self.x.any() else None), np.zeros(len(self.x))
        self.ritz.restart()

    def curve(self, Ap: Float) -> bool:
        """Compute the curvature p·A p, and return True if p may be a null vector of A."""
        self.curvature = float(self.p @ Ap)
        return self.curvatures.add(self.curvature, self.pp)

    def along(self) -> float:
        """Return p·r, equal to z·r for linear symmetric M."""
        return float(self.p @ self.r)

    def move(self, Ap: Float, along: float | None = None) -> None:
        """Step along p to the minimal error: x ← x + α p, r ← r − α A p.

        α is z·r / p·A p or, with the product :meth:`along`, p·r / p·A p, optimal for any M.
        """
        along = self.zr if along is None else along
        self.alpha = along / self.curvature
        self.gain = self.alpha * along
        self._x_added = self._x_added + self.alpha * self.p
        self.x = self._x_added if self._x_start is None else self._x_start + self._x_added
        self._r_before, self.r = self.r, self.r - self.alpha * Ap

    def precondition(self, z: Float) -> None:
        """Store z = M r."""
        self.z = z
        self.zr_before, self.zr = self.zr, float(z @ self.r)

    def cross(self) -> float:
        """Return z·r_before, with the previous residual r_before: 0 for linear symmetric M."""
        assert self._r_before is not None  # a step was made
        return float(self.z @ self._r_before)

    def turn(self, cross: float = 0.0) -> None:
        """Choose the next direction p ← z + β p, conjugate to the last one.

        β is z·r / (z·r)_before (Fletcher–Reeves) or, with the product :meth:`cross`, z·(r − r_before) /
        (z·r)_before (Polak–Ribière), for an M that changes a little.
        """
        self.ritz.add(self.alpha, max(self.zr, 0.0) / self.zr_before)
        beta = (self.zr - cross) / self.zr_before
        self.p, self.pp = self.z + beta * self.p, self.zr + beta**2 * self.pp

    def error_bound(self) -> float:
        """Return the bound z·r / (θ p·M⁻¹p)^½ of ‖e‖_A (Meurant, Tichý, Numer. Algorithms 82, 2019).

        The coefficients are those of the Lanczos process for M A, with a smallest Ritz value θ that decreases
        to the smallest eigenvalue, and ‖e‖_A² = r·A⁻¹r ≤ (z·r)² / (θ p·M⁻¹p).
        """
        if not self.zr:
            return 0.0
        theta = self.ritz.least
        return self.zr / float(np.sqrt(theta * self.pp)) if theta > 0.0 else np.inf
