"""Registry of the built-in components, independent of installed plugins."""

from __future__ import annotations

from functools import cache

from agglo_core import builtin
from agglo_core.registry import Registry


@cache
def own_components() -> Registry:
    """Return a registry with only the built-in components."""
    registry = Registry()
    registry.register(builtin, "defaults", distribution="agglo")
    return registry
