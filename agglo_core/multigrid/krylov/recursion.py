"""The recursion of preconditioned conjugate gradients, without a rule for when to stop."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from agglo_core.arrays import Float
from agglo_core.multigrid.krylov.lanczos import Curvatures, RitzValue


@dataclass(eq=False)
class Recursion:
    """Conjugate gradients for A x = b with a preconditioner M, from an iterate ``x (n,)``.

    One iteration is :meth:`curve`, :meth:`move`, :meth:`precondition` and :meth:`turn`. The caller computes
    A p and z = M r, since the products of several right-hand sides are computed together. Between ``move``
    and ``precondition`` it may replace ``r`` by b − A x, and call :meth:`restart` instead of ``turn``.

    Attributes
    ----------
    x, r, z, p : (n,) float
        Iterate, residual, preconditioned residual and direction.
    zr : float
        z·r.
    pp : float
        p·M⁻¹p by recursion, as z·p_before is 0.
    alpha, gain : float
        Length of the last step in units of p, and by how much it lowered ‖e‖_A², e being the error.
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
        """Let p = z. The steps from here on are summed apart, so that x is rounded once."""
        self.p, self.pp = self.z, self.zr
        self._x_start, self._x_added = (self.x if self.x.any() else None), np.zeros(len(self.x))
        self.ritz.restart()

    def curve(self, Ap: Float) -> bool:
        """Compute the curvature p·A p; return whether it is so small that p may be a null vector of A."""
        self.curvature = float(self.p @ Ap)
        return self.curvatures.add(self.curvature, self.pp)

    def along(self) -> float:
        """Compute p·r, which is z·r if M is linear and symmetric."""
        return float(self.p @ self.r)

    def move(self, Ap: Float, along: float | None = None) -> None:
        """Step along p to the least error: x ← x + α p, r ← r − α A p.

        α is z·r / p·A p or, given the product :meth:`along`, p·r / p·A p, the best step for any M.
        """
        along = self.zr if along is None else along
        self.alpha = along / self.curvature
        self.gain = self.alpha * along
        self._x_added = self._x_added + self.alpha * self.p
        self.x = self._x_added if self._x_start is None else self._x_start + self._x_added
        self._r_before, self.r = self.r, self.r - self.alpha * Ap

    def precondition(self, z: Float) -> None:
        """Take z = M r."""
        self.z = z
        self.zr_before, self.zr = self.zr, float(z @ self.r)

    def cross(self) -> float:
        """Compute z·r_before, which is 0 if M is linear and symmetric."""
        assert self._r_before is not None  # a step was made
        return float(self.z @ self._r_before)

    def turn(self, cross: float = 0.0) -> None:
        """Choose the next direction p ← z + β p, conjugate to the last one.

        β is z·r / (z·r)_before (Fletcher–Reeves) or, given the product :meth:`cross`, z·(r − r_before) /
        (z·r)_before (Polak–Ribière), which tolerates an M that changes a little.
        """
        self.ritz.add(self.alpha, max(self.zr, 0.0) / self.zr_before)
        beta = (self.zr - cross) / self.zr_before
        self.p, self.pp = self.z + beta * self.p, self.zr + beta**2 * self.pp

    def error_bound(self) -> float:
        """Bound ‖e‖_A by z·r / (θ p·M⁻¹p)^½ (Meurant, Tichý, Numer. Algorithms 82, 2019).

        The coefficients are those of the Lanczos process of M A, whose smallest Ritz value θ falls to the
        smallest eigenvalue, and ‖e‖_A² = r·A⁻¹r ≤ (z·r)² / (θ p·M⁻¹p).
        """
        if not self.zr:
            return 0.0
        theta = self.ritz.least
        return self.zr / float(np.sqrt(theta * self.pp)) if theta > 0.0 else np.inf
