"""Protocols of multigrid components, and their choice by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, Protocol, runtime_checkable

from agglo_core.errors import OptionError, PluginError
from agglo_core.multigrid.stack import Solve
from agglo_core.problems import Coarsening
from agglo_core.registry import KINDS, Registry, default, describe
from agglo_core.registry.attribution import Member
from agglo_core.registry.options import is_named, name_and_options


@runtime_checkable
class Transfer(Protocol):
    """Component that computes the prolongation from a coarse level to the next finer level.

    Restriction is the transpose.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import Transfer
    >>> class Constants:
    ...     def prolongation(self, step):
    ...         n = len(step.parents)
    ...         return sparse.csr_array((np.ones(n), (np.arange(n), step.parents)))
    >>> isinstance(Constants(), Transfer)
    True
    """

    def prolongation(self, step: Coarsening) -> Any:
        """Return a sparse prolongation P ``(n, m)`` with coarse unknowns part by part, or a CoarseSpace."""


@runtime_checkable
class CoarseOperator(Protocol):
    """Component that computes a coarse-level matrix.

    Examples
    --------
    >>> from agglo_core.multigrid import CoarseOperator
    >>> class Product:
    ...     def coarse_matrix(self, step, P):
    ...         return P.T @ step.A @ P
    >>> isinstance(Product(), CoarseOperator)
    True
    """

    def coarse_matrix(self, step: Coarsening, P: Any) -> Any:
        """Return a sparse symmetric positive definite matrix ``(m, m)``, for a prolongation P ``(n, m)``."""


@runtime_checkable
class CoarseSolver(Protocol):
    """Solver for the coarsest level, and for coarse corrections inside smoothers.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import CoarseSolver
    >>> class Dense:
    ...     def solver_for(self, A):
    ...         inverse = np.linalg.inv(A.toarray())
    ...         return lambda b: inverse @ b
    >>> isinstance(Dense(), CoarseSolver), Dense().solver_for(sparse.diags_array([2.0, 4.0]))(np.ones(2))
    (True, array([0.5 , 0.25]))
    """

    def solver_for(self, A: Any) -> Solve:
        """Return a function from b ``(n,)`` to x with A x = b, or raise LinAlgError if A is unsuitable."""


def part(kind: str, given: Any, own: Mapping[str, Callable[[], Any]], registry: Registry | None) -> Member:
    """Return the component for a name, object or function, with its title for error messages.

    Parameters
    ----------
    kind : str
        ``transfer``, ``coarse_operator``, ``smoother`` or ``coarse_solver``.
    given : str, (str, dict), object or callable
        A name, a name with options, an object with the method of the kind, or a function that replaces
        the method.
    own : mapping
        Built-in components by name. The names are reserved, so that no registry is needed.
    registry : Registry, optional
        Registry of other names. Default: the installed plugins.

    Raises
    ------
    OptionError
        For any other object, or an unknown name.
    PluginError
        For an unusable component.
    """
    method = KINDS[kind].methods[0]
    if isinstance(given, Member):
        return given
    if isinstance(given, str) and given in own:
        return Member(own[given](), f"{kind} {given}")
    if is_named(given):
        return _assemble_by_name(kind, given, own, default() if registry is None else registry)
    if not isinstance(given, type):
        if callable(getattr(given, method, None)):
            return Member(given, f"{kind} {type(given).__name__}")
        if callable(given):
            title = getattr(given, "__name__", type(given).__name__)
            return Member(SimpleNamespace(**{method: given}), f"{kind} {title}")
    raise OptionError(
        f"{kind} must be a name, an object with the method {method}, or a function to call as {method}; "
        f"given {given!r:.60}"
    )


def _assemble_by_name(
    kind: str, choice: str | tuple[Any, ...], builtin: Mapping[str, Callable[[], Any]], registry: Registry
) -> Member:
    name, options = name_and_options(kind, choice)
    try:
        record = registry.record(kind, name)
    except PluginError as error:
        names = {entry.name for entry in registry.list() if entry.kind == kind and entry.state == "ok"}
        failures = "; ".join(f"{describe(r)}: {r.reason}" for r in registry.list() if r.kind == "plugin")
        tail = f"; plugins that cannot be used: {failures}" if failures else ""
        choices = ", ".join([*builtin, *sorted(names - set(builtin))])
        raise OptionError(f"{kind} must be one of {choices}; given {choice!r}{tail}") from error
    return Member(registry.assemble(record, options), describe(record))
