"""Cycles through a stack of levels, as linear operators that precondition Krylov methods."""

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
"""The cycles of a visit to the next level, one after the other, each for what the ones before left."""


def cycle(stack: LevelStack, kind: Kind = "V") -> LinearOperator:
    """One cycle from zero: an approximate inverse of the finest matrix.

    Parameters
    ----------
    stack : LevelStack
    kind : "V", "W", "F" or "K"
        V and W are linear and, with mirrored smoothers, symmetric: for conjugate gradients. F visits the
        next level twice, the second time by V, and is linear but not symmetric; K takes two steps of
        flexible conjugate gradients on each level and is not linear: both need flexible methods outside
        (Notay, Vassilevski, Numer. Linear Algebra Appl. 15, 2008).

    Returns
    -------
    LinearOperator
        ``(n, n)``, in double precision whatever the stack computes with.

    Raises
    ------
    OptionError
        For another kind.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import Level, LevelStack, cycle
    >>> exact = LevelStack([Level(sparse.eye_array(2), [0, 1, 2])], lambda b: b)
    >>> cycle(exact) @ [1.0, 2.0]
    array([1., 2.])
    """
    if kind not in _NEXT:
        raise OptionError(f"a cycle is one of {', '.join(_NEXT)}; given {kind!r}")

    n = stack.levels[0].A.shape[0]
    applied: Callable[[Any], Any] = partial(_applied, stack, kind)
    if stack.scaling is not None:
        applied = partial(_between, _product(stack.scaling), _product(stack.scaling.T), applied)
    return LinearOperator((n, n), matvec=applied, rmatvec=applied, dtype=np.float64)


def _applied(stack: LevelStack, kind: Kind, r: Any) -> Any:
    """One cycle for a residual, scaled to a largest entry of 1: vectors of the stack may be in single."""
    residual = np.asarray(r, dtype=np.float64).ravel()
    size = max(float(residual.max(initial=0.0)), -float(residual.min(initial=0.0)))
    if not size > 0.0 or not np.isfinite(size):
        return residual
    b = np.empty(len(residual), stack.dtype)
    np.divide(residual, size, out=b, casting="same_kind")
    return np.multiply(_solved(stack, 0, b, kind), size, dtype=np.float64)


def _between(forth: Any, back: Any, applied: Callable[[Any], Any], r: Any) -> Any:
    """The cycle of a scaled matrix, for the matrix itself."""
    return back @ applied(forth @ np.asarray(r, dtype=np.float64).ravel())


def _product(T: Any) -> Any:
    """A matrix ready for many products, in small blocks if it has any."""
    ready = fast_product(T)
    return sparse.csr_array(T) if ready is T else ready


def _solved(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """An approximate solution of A x = b on a level."""
    level = stack.levels[at]
    if level.smoother is None:
        return stack.coarse(b)
    x, r = level.smoother.before(b)
    x = level.prolonged(x, _corrected(stack, at + 1, level.restricted(r), kind))
    return level.smoother.after(b, x)


def _corrected(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """Coarse-level correction: an approximate solution by one cycle for each visit of the level."""
    level = stack.levels[at]
    if level.smoother is None:
        return stack.coarse(b)
    solved = _two_steps if kind == "K" else _solved
    first, *rest = _NEXT[kind] * level.visits
    x = solved(stack, at, b, first)
    for again in rest:
        x = x + solved(stack, at, b - level.A @ x, again)
    return x


def _two_steps(stack: LevelStack, at: int, b: Real, kind: str) -> Real:
    """At most two steps of flexible conjugate gradients, preconditioned by the K-cycle."""
    A = stack.levels[at].A
    p = _solved(stack, at, b, kind)
    Ap = A @ p
    curvature, along = p @ Ap, p @ b
    if not curvature > 0.0:
        return p
    x: Real = (along / curvature) * p
    r = b - (along / curvature) * Ap
    if r @ r <= 0.0625 * (b @ b):  # a quarter of the residual is left: one step will do
        return x
    z = _solved(stack, at, r, kind)
    z = z - ((z @ Ap) / curvature) * p
    Az = A @ z
    bent = z @ Az
    better: Real = x + ((z @ r) / bent) * z if bent > 0.0 else x
    return better
