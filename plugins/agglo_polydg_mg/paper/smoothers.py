"""Smoothers of a level: the paper's as a component, and smoothers made from functions."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from agglo_core.authoring import Member, MultigridLevel, Registry, Smoother, multigrid
from agglo_polydg_mg.paper.schwarz import Smooth, SmootherMaker, local_solve, schwarz


class Schwarz:
    """The paper's smoother: conjugate gradients preconditioned by additive Schwarz, restarted in each call.

    Blocks of the parts and the correction of the next level belong to the inherited matrices, as in the
    paper's experiments. What the steps do depends on ``b`` and ``x``: the smoother is nonlinear.
    """

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return ``smooth(b, x)``; LinAlgError if a block is singular."""
        return _Made(schwarz).setup(level)


@dataclass(frozen=True)
class _Made:
    """The smoother a function makes from matrix, local solve, correction of the next level and steps."""

    maker: SmootherMaker

    def setup(self, level: MultigridLevel) -> Smooth:
        local = local_solve(level.inherited, level.block_offsets)
        return self.maker(level.A, local, level.coarse, level.steps)


_OWN = MappingProxyType({"schwarz": Schwarz, **multigrid.SMOOTHERS})
"""Names that need no registry."""


def smoother_of(given: Any, registry: Registry | None = None) -> Member:
    """A smoother, from the name of its component, the smoother itself, or the function that makes it.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
        A callable has the arguments of :func:`~agglo_polydg_mg.paper.schwarz.schwarz`.
    registry : Registry, optional
        Where names are looked up; by default the installed plugins.

    Raises
    ------
    OptionError
        If it is none of these, or no smoother has the name.
    PluginError
        If the component cannot be used.
    """
    if callable(given) and not isinstance(given, Smoother | type):
        return Member(_Made(given), f"smoother {getattr(given, '__name__', type(given).__name__)}")
    return multigrid.part("smoother", given, _OWN, registry)
