"""The paper's smoother component: conjugate gradients preconditioned by additive Schwarz."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from agglo_core.authoring import Float, MultigridLevel, Registry, multigrid
from agglo_core.registry.attribution import Member

Solve = Callable[[Float], Float]
"""Map from a right-hand side or residual ``(n,)`` to a solution or correction ``(n,)``."""
Smooth = Callable[[Float, Float], Float]
"""Map from ``(b, x)`` to a better x."""


def pcg_steps(A: Any, b: Float, x: Float, precondition: Solve, steps: int) -> Float:
    """Take a few steps of preconditioned conjugate gradients from x, and return the iterate ``(n,)``.

    Raises
    ------
    LinAlgError
        If matrix or preconditioner prove not to be positive definite.
    """
    # 1. Residual and first direction
    r = b - A @ x if x.any() else b
    if not r.any():
        return x
    z = precondition(r)
    p, rho = z, float(r @ z)
    # 2. Steps: minimise along p, update residual and direction
    for step in range(steps):
        Ap = A @ p
        curvature = float(p @ Ap)
        if rho == 0.0:
            break
        if not (rho > 0.0 and curvature > 0.0):
            raise np.linalg.LinAlgError("the matrix or its preconditioner is not positive definite")
        alpha = rho / curvature
        x, r = x + alpha * p, r - alpha * Ap
        if step + 1 < steps:
            z = precondition(r)
            rho, before = float(r @ z), rho
            p = z + (rho / before) * p
    return x


class Schwarz:
    """Smooth by conjugate gradients with additive Schwarz, restarted in each call (the paper's smoother).

    Local blocks and the correction by the next level belong to the inherited matrices, as in the
    paper's experiments. The steps depend on ``b`` and ``x``: the smoother is nonlinear.
    """

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return the smoothing step ``smooth(b, x)`` on a multigrid level.

        Raises
        ------
        LinAlgError
            If a block is not positive definite.
        """
        local = multigrid.block_inverses(level.inherited, level.block_offsets)
        return partial(_steps, level.A, partial(_add_corrections, local, level.coarse), level.steps)


def _steps(A: Any, precondition: Solve, steps: int, b: Float, x: Float) -> Float:
    return pcg_steps(A, b, x, precondition, steps)


def _add_corrections(local: Any, coarse: Solve | None, r: Float) -> Float:
    """Return D⁻¹ r with the blocks D of the cells, and the correction by the next level if there is one."""
    return np.asarray(local @ r if coarse is None else local @ r + coarse(r))


_OWN = MappingProxyType({"schwarz": Schwarz, **multigrid.SMOOTHERS})
"""Smoothers found without a registry."""


def smoother_of(given: Any, registry: Registry | None = None) -> Member:
    """Return the smoother given by a component name, a smoother object, or a function in place of ``setup``.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
    registry : Registry, optional
        Registry for names; by default the installed plugins.

    Raises
    ------
    OptionError
        For any other value, or an unknown name.
    PluginError
        If the component cannot be used.
    """
    return multigrid.part("smoother", given, _OWN, registry)
