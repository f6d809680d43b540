"""Components of the core that complete the runs of the suite, whatever else is registered."""

from __future__ import annotations

from functools import cache

from agglo_core import builtin
from agglo_core.registry import Registry


@cache
def own_components() -> Registry:
    """A registry of the core's own components and nothing else."""
    registry = Registry()
    registry.register(builtin, "defaults", distribution="agglo")
    return registry
