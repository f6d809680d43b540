"""The one module plugin authors import from: all that a component, a command or a declaration needs.

Names are imported when first used, so that a declaration stays light::

    from agglo_core.authoring import Component, hookimpl

What stands here is kept from version to version; other modules of ``agglo_core`` may move. Our own
plugins import from nowhere else (a test holds them to it). docs/how-to/write-a-plugin.md shows the rest.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core import conformance, samples
    from agglo_core.agglomeration import Pipeline, agglomerate
    from agglo_core.arrays import (
        Float,
        Index,
        Int,
        Mask,
        UInt64,
        frozen,
        frozen_float,
        frozen_index,
        frozen_int,
    )
    from agglo_core.cli.arguments import COMPONENT, FILE, agglomeration_options, choice, load_mesh, parse_spec
    from agglo_core.draw.plot import PALETTE, colouring, save_figure
    from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
    from agglo_core.graph import Graph, functionals
    from agglo_core.graph.blocks import (
        TIE,
        block_extents,
        block_ranks,
        block_shares,
        block_sums,
        integer_shares,
        principal_frames,
        split_at_median,
    )
    from agglo_core.graph.ordering import curve_order
    from agglo_core.graph.sweep import sweep
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io import check_writable, read, read_hierarchy, write
    from agglo_core.io.atomic import staging
    from agglo_core.kernels import kernel
    from agglo_core.measure import quality
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Diffusion, Field, Linear, MultigridLevel, Problem, Solution
    from agglo_core.protocols import Bisector, LevelBisector, Partitioner, Target
    from agglo_core.registry import Command, Component, Record, Registry, default, describe, hookimpl

_HOME = MappingProxyType(
    {
        # declaring
        "registry": ("Command", "Component", "Record", "Registry", "default", "describe", "hookimpl"),
        "errors": ("AggloError", "FileError", "MeshError", "OptionError", "PluginError"),
        # data
        "arrays": (
            *("Float", "Index", "Int", "Mask", "UInt64"),
            *("frozen", "frozen_float", "frozen_index", "frozen_int"),
        ),
        "mesh": ("Mesh",),
        "graph": ("Graph", "functionals"),
        "hierarchy": ("Hierarchy",),
        "protocols": ("Bisector", "LevelBisector", "Partitioner", "Target"),
        "problems": ("Diffusion", "Field", "Linear", "MultigridLevel", "Problem", "Solution"),
        # tools on graphs, a level at once
        "graph.blocks": (
            *("TIE", "block_extents", "block_ranks", "block_shares", "block_sums"),
            *("integer_shares", "principal_frames", "split_at_median"),
        ),
        "graph.ordering": ("curve_order",),
        "graph.sweep": ("sweep",),
        "kernels": ("kernel",),
        # what the program does
        "agglomeration": ("Pipeline", "agglomerate"),
        "measure": ("quality",),
        "io": ("check_writable", "read", "read_hierarchy", "write"),
        "io.atomic": ("staging",),
        "draw.plot": ("PALETTE", "colouring", "save_figure"),
        # commands
        "cli.arguments": (
            *("COMPONENT", "FILE", "agglomeration_options"),
            *("choice", "load_mesh", "parse_spec"),
        ),
    }
)
_MODULES = ("conformance", "samples")

__all__ = [
    "COMPONENT",
    "FILE",
    "PALETTE",
    "TIE",
    "AggloError",
    "Bisector",
    "Command",
    "Component",
    "Diffusion",
    "Field",
    "FileError",
    "Float",
    "Graph",
    "Hierarchy",
    "Index",
    "Int",
    "LevelBisector",
    "Linear",
    "Mask",
    "Mesh",
    "MeshError",
    "MultigridLevel",
    "OptionError",
    "Partitioner",
    "Pipeline",
    "PluginError",
    "Problem",
    "Record",
    "Registry",
    "Solution",
    "Target",
    "UInt64",
    "agglomerate",
    "agglomeration_options",
    "block_extents",
    "block_ranks",
    "block_shares",
    "block_sums",
    "check_writable",
    "choice",
    "colouring",
    "conformance",
    "curve_order",
    "default",
    "describe",
    "frozen",
    "frozen_float",
    "frozen_index",
    "frozen_int",
    "functionals",
    "hookimpl",
    "integer_shares",
    "kernel",
    "load_mesh",
    "parse_spec",
    "principal_frames",
    "quality",
    "read",
    "read_hierarchy",
    "samples",
    "save_figure",
    "split_at_median",
    "staging",
    "sweep",
    "write",
]


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(f"{__package__}.{name}")
    for module, names in _HOME.items():
        if name in names:
            found: object = getattr(import_module(f"{__package__}.{module}"), name)
            return found
    raise AttributeError(
        f"module {__name__!r} has no attribute {name!r}; it has {', '.join(sorted(__all__))}"
    )


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
