"""The names authors of plugins import, all from here; what is not here may change without notice.

>>> from agglo_core.authoring import Component, Mesh, OptionError, hookimpl

Names are imported when first used, so that a module of declarations stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.arrays import Float, Index, Int, Mask, UInt64, frozen_float, frozen_int
    from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
    from agglo_core.graph import Graph
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.atomic import staging
    from agglo_core.measure import Run
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Diffusion, Linear, MultigridLevel, Problem, Solution
    from agglo_core.protocols import Target
    from agglo_core.registry import Command, Component, hookimpl

__all__ = [
    "AggloError",
    "Command",
    "Component",
    "Diffusion",
    "FileError",
    "Float",
    "Graph",
    "Hierarchy",
    "Index",
    "Int",
    "Linear",
    "Mask",
    "Mesh",
    "MeshError",
    "MultigridLevel",
    "OptionError",
    "PluginError",
    "Problem",
    "Run",
    "Solution",
    "Target",
    "UInt64",
    "frozen_float",
    "frozen_int",
    "hookimpl",
    "staging",
]

_HOME = {
    "arrays": ("Float", "Index", "Int", "Mask", "UInt64", "frozen_float", "frozen_int"),
    "errors": ("AggloError", "FileError", "MeshError", "OptionError", "PluginError"),
    "graph": ("Graph",),
    "hierarchy": ("Hierarchy",),
    "io.atomic": ("staging",),
    "measure": ("Run",),
    "mesh": ("Mesh",),
    "problems": ("Diffusion", "Linear", "MultigridLevel", "Problem", "Solution"),
    "protocols": ("Target",),
    "registry": ("Command", "Component", "hookimpl"),
}


def __getattr__(name: str) -> object:
    for module, names in _HOME.items():
        if name in names:
            return getattr(import_module(f"agglo_core.{module}"), name)
    raise AttributeError(f"module 'agglo_core.authoring' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
