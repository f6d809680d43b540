"""Which modules are public: their names have a page on the site, and their examples are run by the tests."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from typing import Any

MODULES = (
    "agglo_core",
    "agglo_core.mesh",
    "agglo_core.graph",
    "agglo_core.graph.functionals",
    "agglo_core.hierarchy",
    "agglo_core.distributed",
    "agglo_core.agglomeration",
    "agglo_core.io",
    "agglo_core.interchange",
    "agglo_core.measure",
    "agglo_core.samples",
    "agglo_core.problems",
    "agglo_core.multigrid",
    "agglo_core.registry",
    "agglo_core.protocols",
    "agglo_core.conformance",
    "agglo_core.progress",
    "agglo_core.threads",
    "agglo_core.draw.plot",
    "agglo_core.errors",
    "agglo_core.authoring",
)


def callables(module: str) -> Iterator[tuple[str, Any]]:
    """Classes and functions among the public names of a module."""
    found = import_module(module)
    for name in found.__all__:
        value = getattr(found, name)
        if inspect.isclass(value) or inspect.isroutine(value):
            yield name, value
