"""Smoothers of a level: the paper's and a linear one as components, and smoothers made from functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final

import numpy as np

from agglo_core.authoring import (
    AggloError,
    MultigridLevel,
    OptionError,
    PluginError,
    Registry,
    Smoother,
    attributed,
    default,
    describe,
    multigrid,
)
from agglo_polydg_mg.schwarz import Smooth, SmootherMaker, damped_jacobi, local_solve, schwarz

__all__ = ["BlockJacobi", "Schwarz", "set_up", "smoother_of", "smoother_title"]


class Schwarz:
    """The paper's smoother: conjugate gradients preconditioned by additive Schwarz, restarted in each call.

    Blocks of the parts and the correction of the next level belong to the inherited matrices, as in the
    paper's experiments. What the steps do depends on ``b`` and ``x``: the smoother is nonlinear.
    """

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return ``smooth(b, x)``; LinAlgError if a block is singular."""
        local = local_solve(level.inherited, level.block_offsets)
        return schwarz(level.A, local, level.coarse, level.steps)


class BlockJacobi:
    """Block Jacobi steps damped by 4/(3 λ_max): a linear, symmetric smoother without a coarse space."""

    uses_coarse: ClassVar[bool] = False

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return ``smooth(b, x)``; LinAlgError if a block is singular."""
        return damped_jacobi(level.A, local_solve(level.A, level.block_offsets), None, level.steps)


@dataclass(frozen=True)
class _Made:
    """The smoother a function makes from matrix, local solve, correction of the next level and steps."""

    maker: SmootherMaker

    def setup(self, level: MultigridLevel) -> Smooth:
        local = local_solve(level.inherited, level.block_offsets)
        return self.maker(level.A, local, level.coarse, level.steps)


_OWN: Final[Mapping[str, type[Smoother]]] = {"schwarz": Schwarz, "block_jacobi": BlockJacobi}
"""Our own smoothers; their names are reserved, so that no registry is needed."""


def smoother_of(given: Any, registry: Registry | None = None) -> Smoother:
    """A smoother, from the name of its component, the smoother itself, or the function that makes it.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
        A callable has the arguments of :func:`~agglo_polydg_mg.schwarz.schwarz`.
    registry : Registry, optional
        Where names are looked up; by default the installed plugins.

    Raises
    ------
    OptionError
        If it is none of these, or no smoother has the name.
    PluginError
        If the component cannot be used.
    """
    if isinstance(given, Smoother) and not isinstance(given, type):
        return given
    if given is damped_jacobi:
        return BlockJacobi()  # blocks are those of A itself
    if callable(given):
        return _Made(given)
    if isinstance(given, str) and given in _OWN:
        return _OWN[given]()
    registry = default() if registry is None else registry
    try:
        record = registry.record("smoother", str(given))
    except PluginError as error:
        others = {each.name for each in registry.list() if each.kind == "smoother" and each.state == "ok"}
        known = ", ".join([*_OWN, *sorted(others - set(_OWN))])
        failed = "; ".join(f"{describe(r)}: {r.reason}" for r in registry.list() if r.kind == "plugin")
        tail = f"; plugins that cannot be used: {failed}" if failed else ""
        raise OptionError(f"smoother must be one of {known}; given {given!r}{tail}") from error
    built: Smoother = registry.assemble(record, {})
    return built


def smoother_title(given: Any, registry: Registry | None = None) -> str:
    """How errors call what :func:`smoother_of` makes of the same arguments."""
    if isinstance(given, str) and given not in _OWN:
        return describe((default() if registry is None else registry).record("smoother", given))
    return f"smoother {given if isinstance(given, str) else getattr(given, '__name__', type(given).__name__)}"


def set_up(smoother: Smoother, title: str, level: MultigridLevel) -> multigrid.Adapted:
    """``smooth(b, x)`` of a level; what it returns is checked, and errors name the smoother.

    Raises
    ------
    PluginError
        For whatever it raises but AggloErrors and the LinAlgError of a singular block, and if it returns no
        function; so does the function, and if it returns no vector like ``b``.
    """
    spare = (AggloError, np.linalg.LinAlgError)
    return multigrid.adapted(smoother, level, title, partial(attributed, title, spare=spare))
