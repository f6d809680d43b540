"""Adapter that makes smoother components, including plugins, usable in multigrid cycles."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from agglo_core.errors import PluginError
from agglo_core.multigrid.stack import Real
from agglo_core.problems import MultigridLevel

Guard = Callable[[], AbstractContextManager[None]]
"""Makes a context manager around each call, for example to name the owner of errors."""


class _Component(Protocol):
    def setup(self, level: MultigridLevel) -> Any: ...


@dataclass(frozen=True, eq=False)
class Adapted:
    """Smoother component in a cycle, before and after a coarse correction, checked at each call.

    If the result has methods ``before`` and ``after`` besides being callable, these are used. Otherwise
    ``smooth(b, x)`` runs from zero before, and again after the correction, and the cycle is symmetric if
    smooth is. Vectors are passed and returned in double precision, even if those of the cycle are in single
    precision.

    Attributes
    ----------
    smooth : callable
    A : (n, n) sparse
        Level matrix.
    title : str
        Smoother title in errors.
    guard : Guard

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import Adapted
    >>> A = np.diag([2.0, 4.0])
    >>> smoother = Adapted(lambda b, x: x + 0.25 * (b - A @ x), A)
    >>> smoother.before(np.ones(2))  # x from 0, and what is left of b
    (array([0.25, 0.25]), array([0.5, 0. ]))
    """

    smooth: Any
    A: Any
    title: str = "smoother"
    guard: Guard = nullcontext

    def __call__(self, b: Real, x: Real) -> Real:
        """Return ``smooth(b, x)``, or raise PluginError unless it is a vector like b."""
        return self._checked("smooth(b, x)", b, self.smooth, b, x)

    def before(self, b: Real) -> tuple[Real, Real]:
        double = np.asarray(b, np.float64)
        if self._two_sided:
            with self.guard():
                pair = self.smooth.before(double)
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise PluginError(f"{self.title}: before(b) returned {pair!r:.60}, expected (x, b - A x)")
            x, r = (self._vector("before(b)", each, b) for each in pair)
        else:
            x = self(double, np.zeros_like(double))
            r = double - self.A @ x
        return x.astype(b.dtype), r.astype(b.dtype)

    def after(self, b: Real, x: Real) -> Real:
        vectors = np.asarray(b, np.float64), np.asarray(x, np.float64)
        if self._two_sided:
            return self._checked("after(b, x)", b, self.smooth.after, *vectors).astype(b.dtype)
        return self(*vectors).astype(b.dtype)

    @property
    def _two_sided(self) -> bool:
        return all(callable(getattr(self.smooth, name, None)) for name in ("before", "after"))

    def _checked(self, call: str, b: Real, method: Callable[..., Any], *given: Real) -> Real:
        with self.guard():
            better = method(*given)
        return self._vector(call, better, b)

    def _vector(self, call: str, given: Any, b: Real) -> Real:
        with self.guard():
            values: Real = np.asarray(given)
        if values.shape != b.shape or values.dtype.kind != "f":
            raise PluginError(
                f"{self.title}: {call} returned shape {values.shape} of {values.dtype}, "
                f"expected {b.shape} of float64"
            )
        return values


def adapted(
    smoother: _Component, level: MultigridLevel, title: str = "smoother", guard: Guard = nullcontext
) -> Adapted:
    """Set up a component of kind ``smoother`` on a multigrid level, for use in cycles.

    Parameters
    ----------
    smoother : object with ``setup``
        Component, see :class:`agglo_core.protocols.Smoother`.
    level : MultigridLevel
        Level with its matrix in double precision.
    title : str
        Smoother title in errors.
    guard : Guard, optional

    Raises
    ------
    PluginError
        If setup does not return a function.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import adapted
    >>> from agglo_core.problems import MultigridLevel
    >>> class Jacobi:
    ...     def setup(self, level):
    ...         return lambda b, x: x + (b - level.A @ x) / level.A.diagonal()
    >>> A = np.diag([2.0, 4.0])
    >>> level = MultigridLevel(A, A, np.arange(3), np.arange(2), P=None, coarse=None, steps=1)
    >>> adapted(Jacobi(), level).after(np.ones(2), np.zeros(2))
    array([0.5 , 0.25])
    """
    with guard():
        smooth = smoother.setup(level)
    if not callable(smooth):
        raise PluginError(f"{title}: setup returned {smooth!r:.60}, expected a function smooth(b, x)")
    return Adapted(smooth, level.A, title, guard)
