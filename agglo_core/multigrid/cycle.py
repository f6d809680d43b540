"""Multigrid cycles as linear operators for Krylov methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.errors import OptionError
from agglo_core.multigrid.matrices.block_product import fast_product
from agglo_core.multigrid.stack import LevelStack, Real

Kind = Literal["V", "W", "F", "K"]
_NEXT = {"V": ("V",), "W": ("W", "W"), "F": ("F", "V"), "K": ("K",)}
"""Cycles on the next level per visit, each applied to the residual of the previous."""


def cycle(stack: LevelStack, kind: Kind = "V") -> LinearOperator:
    """Return a multigrid cycle from the iterate 0 as an approximate inverse of the finest matrix.

    Parameters
    ----------
    stack : LevelStack
    kind : "V", "W", "F" or "K"
        V and W are linear and, with mirrored smoothers, symmetric: suitable for conjugate gradients. F
        visits the next level twice, the second time by V, and is linear but not symmetric. K takes two
        steps of flexible conjugate gradients on each level and is not linear. F and K need flexible outer
        methods (Notay, Vassilevski, Numer. Linear Algebra Appl. 15, 2008).

    Returns
    -------
    LinearOperator
        Operator ``(n, n)`` in double precision, whatever the precision of the stack.

    Raises
    ------
    OptionError
        For an unknown kind.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import Level, LevelStack, cycle
    >>> exact = LevelStack([Level(sparse.eye_array(2), [0, 1, 2])], lambda b: b)
    >>> cycle(exact) @ [1.0, 2.0]
    array([1., 2.])
    """
    if kind not in _NEXT:
        raise OptionError(f"cycle must be one of {', '.join(_NEXT)}; given {kind!r}")

    n = stack.levels[0].A.shape[0]
    apply: Callable[[Any], Any] = partial(_apply_cycle, stack, kind)
    if stack.scaling is not None:
        apply = partial(_apply_scaled, _product(stack.scaling), _product(stack.scaling.T), apply)
    return LinearOperator((n, n), matvec=apply, rmatvec=apply, dtype=np.float64)


def _apply_cycle(stack: LevelStack, kind: Kind, r: Any) -> Any:
    """Apply a cycle to a residual, scaled to maximum norm 1 for cycles in single precision."""
    residual = np.asarray(r, dtype=np.float64).ravel()
    size = max(float(residual.max(initial=0.0)), -float(residual.min(initial=0.0)))
    if not size > 0.0 or not np.isfinite(size):
        return residual
    b = np.empty(len(residual), stack.dtype)
    np.divide(residual, size, out=b, casting="same_kind")
    return np.multiply(_solve_level(stack, 0, b, kind), size, dtype=np.float64)


def _apply_scaled(forth: Any, back: Any, apply: Callable[[Any], Any], r: Any) -> Any:
    """Apply the cycle for a scaled matrix T A Tᵀ as a preconditioner of A."""
    return back @ apply(forth @ np.asarray(r, dtype=np.float64).ravel())


def _product(T: Any) -> Any:
    """Prepare a matrix for many products with vectors, by compiled kernels if it has small square blocks."""
    ready = fast_product(T)
    return sparse.csr_array(T) if ready is T else ready


def _solve_level(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """Solve A x = b approximately by a cycle that begins on the given multigrid level."""
    level = stack.levels[at]
    if level.smoother is None:
        return stack.coarse(b)
    x, r = level.smoother.before(b)
    x = level.prolonged(x, _coarse_correction(stack, at + 1, level.restricted(r), kind))
    return level.smoother.after(b, x)


def _coarse_correction(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """Compute the coarse correction, with one cycle for each visit of the coarser level."""
    level = stack.levels[at]
    if level.smoother is None:
        return stack.coarse(b)
    solve = _two_steps if kind == "K" else _solve_level
    first, *rest = _NEXT[kind] * level.visits
    x = solve(stack, at, b, first)
    for again in rest:
        x = x + solve(stack, at, np.asarray(b - level.A @ x, b.dtype), again)
    return x


def _two_steps(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """Take at most two steps of flexible conjugate gradients, preconditioned by the K-cycle."""
    A = stack.levels[at].A
    p = _solve_level(stack, at, b, kind)
    # First step along p.
    Ap = A @ p
    curvature, projection = p @ Ap, p @ b
    if not curvature > 0.0:
        return p
    x: Real = (projection / curvature) * p
    r = np.asarray(b - (projection / curvature) * Ap, b.dtype)
    if r @ r <= 0.0625 * (b @ b):  # residual below a quarter: one step suffices
        return np.asarray(x, b.dtype)
    z = _solve_level(stack, at, r, kind)
    # Second step along z, made conjugate to p.
    z = z - ((z @ Ap) / curvature) * p
    Az = A @ z
    curvature_z = z @ Az
    result: Real = x + ((z @ r) / curvature_z) * z if curvature_z > 0.0 else x
    return np.asarray(result, b.dtype)
