"""agglo: agglomeration of polygonal and polyhedral meshes into nested hierarchies, composed from plugins.

>>> import agglo_core as agglo
>>> mesh = agglo.samples.voronoi(5000, seed=3)
>>> hierarchy = agglo.agglomerate(mesh, bisector="kmeans", h_factor=(2, 4, 8), seed=0)
>>> values = agglo.quality(mesh, hierarchy.levels[0], metrics=("UF", "CR", "CRc"))
>>> agglo.write("out.vtu", mesh, hierarchy)

Names are imported when first used: a plugin that declares components loads none of numpy and the rest.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from agglo_core.moved import watch_for_moved

if TYPE_CHECKING:
    from agglo_core import (
        conformance,
        distributed,
        errors,
        interchange,
        io,
        problems,
        progress,
        registry,
        samples,
    )
    from agglo_core import registry as plugins
    from agglo_core.agglomeration import Pipeline, agglomerate
    from agglo_core.draw import plot
    from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
    from agglo_core.graph import Graph, functionals
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io import read, read_hierarchy, write
    from agglo_core.measure import quality
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Diffusion, Linear, Solution
    from agglo_core.progress import Progress
    from agglo_core.protocols import Target
    from agglo_core.registry import Command, Component, Registry, hookimpl
    from agglo_core.threads import using_threads

    __version__: str

__all__ = [
    "AggloError",
    "Command",
    "Component",
    "Diffusion",
    "FileError",
    "Graph",
    "Hierarchy",
    "Linear",
    "Mesh",
    "MeshError",
    "OptionError",
    "Pipeline",
    "PluginError",
    "Progress",
    "Registry",
    "Solution",
    "Target",
    "__version__",
    "agglomerate",
    "conformance",
    "distributed",
    "errors",
    "functionals",
    "hookimpl",
    "interchange",
    "io",
    "plot",
    "plugins",
    "problems",
    "progress",
    "quality",
    "read",
    "read_hierarchy",
    "registry",
    "samples",
    "using_threads",
    "write",
]

_HOME = {
    "agglomeration": ("Pipeline", "agglomerate"),
    "errors": ("AggloError", "FileError", "MeshError", "OptionError", "PluginError"),
    "graph": ("Graph",),
    "hierarchy": ("Hierarchy",),
    "io": ("read", "read_hierarchy", "write"),
    "measure": ("quality",),
    "mesh": ("Mesh",),
    "problems": ("Diffusion", "Linear", "Solution"),
    "progress": ("Progress",),
    "protocols": ("Target",),
    "registry": ("Command", "Component", "Registry", "hookimpl"),
    "threads": ("using_threads",),
}
_MODULES = {
    "conformance": "conformance",
    "distributed": "distributed",
    "errors": "errors",
    "functionals": "graph.functionals",
    "interchange": "interchange",
    "io": "io",
    "plot": "draw.plot",
    "plugins": "registry",
    "problems": "problems",
    "progress": "progress",
    "registry": "registry",
    "samples": "samples",
}


def __getattr__(name: str) -> object:
    if name == "__version__":
        from agglo_core.registry.discovery import version_of

        return version_of("agglo")
    if name in _MODULES:
        return import_module(f"agglo_core.{_MODULES[name]}")
    for module, names in _HOME.items():
        if name in names:
            return getattr(import_module(f"agglo_core.{module}"), name)
    raise AttributeError(f"module 'agglo_core' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


watch_for_moved()
