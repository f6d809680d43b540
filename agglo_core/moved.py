"""Module names of version 0.1: importing one gives the module of today with a DeprecationWarning.

``from agglo_core.plot import draw`` goes on working; the warning says where ``draw`` is now.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import MappingProxyType, ModuleType

__all__ = ["MOVED", "watch_for_moved"]

MOVED = MappingProxyType(
    {
        "arguments": "cli.arguments",
        "blocks": "graph.blocks",
        "boxplot": "draw.boxplot",
        "comparison": "measure.comparison",
        "defaults": "components",
        "defaults.shapes": "components.shape_metrics",
        "defaults.sweep": "components.straight_cuts",
        "elements": "mesh.elements",
        "functionals": "graph.functionals",
        "ordering": "graph.ordering",
        "pipeline": "agglomeration",
        "plot": "draw.plot",
        "interchange.grids": "interchange.pyvista_grids",
        "interchange.networks": "interchange.networkx_graphs",
        "interchange.polygons": "interchange.shapely_out",
        "interchange.rings": "interchange.shapely_in",
        "plugins": "registry",
        "plugins.registry": "registry.catalogue",
        "problem": "problems",
        "report": "measure.agglomerates",
        "samples.grids": "samples.regular",
        "sweep": "graph.sweep",
        "webpage": "draw.webpage",
    }
)
"""Old name to new name, both within ``agglo_core``."""

_PACKAGE = __package__ + "."


class _Moved(Loader):
    """Loads the module of the new name under the old one."""

    def __init__(self, new: str) -> None:
        self._module = import_module(new)
        self._spec = self._module.__spec__

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return self._module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # importing under the old name has replaced it


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        new = _new_name(fullname.removeprefix(_PACKAGE)) if fullname.startswith(_PACKAGE) else None
        if new is None:
            return None
        message = f"{fullname} is now {_PACKAGE}{new}"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return ModuleSpec(fullname, _Moved(_PACKAGE + new), is_package=True)


def _new_name(old: str) -> str | None:
    """Today's name of a module; modules of a folder that moved as a whole keep their own."""
    folder, _, module = old.partition(".")
    if old in MOVED or not module or folder not in MOVED:
        return MOVED.get(old)
    return f"{MOVED[folder]}.{module}"


def watch_for_moved() -> None:
    """Let imports of old names find what they mean, once per process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())  # first, or a module of a moved folder would be loaded twice
