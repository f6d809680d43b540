"""The one module plugin authors import from: everything a component, a command or a declaration needs.

Names are imported when first used, and kept from version to version. Our own plugins import nothing else.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core import __version__, conformance, distributed, multigrid, samples
    from agglo_core.agglomeration import Pipeline, agglomerate
    from agglo_core.agglomeration.goals import SizeGoal
    from agglo_core.agglomeration.recursion import grow
    from agglo_core.agglomeration.run import Run
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
    from agglo_core.cli.arguments import (
        COMPONENT,
        FILE,
        agglomeration_options,
        bisectors_option,
        choice,
        load_mesh,
        metrics_option,
        parse_spec,
    )
    from agglo_core.cli.number_types import Number
    from agglo_core.cli.tables import print_lines, print_table
    from agglo_core.components.fixers import ConnectivityFixer
    from agglo_core.components.geometric import InertialBisection
    from agglo_core.components.part_search import PartSearch
    from agglo_core.components.piece_growth import PieceGrowth
    from agglo_core.components.refiners import InterfaceRefiner
    from agglo_core.components.straight_cuts import SweepBisection
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
    from agglo_core.graph.objectives import OBJECTIVES, numbered_parts
    from agglo_core.graph.ordering import curve_order
    from agglo_core.graph.sweep import sweep, sweep_arrays
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io import check_writable, read, read_hierarchy, write
    from agglo_core.io.atomic import staging
    from agglo_core.io.system_files import read_system, write_system
    from agglo_core.kernels import helper, kernel, piece_driver, piece_frames, piece_splits, piece_sweeps
    from agglo_core.kernels.axes import half_circle, halvings, planar_frame, turned
    from agglo_core.kernels.centring import centre_block
    from agglo_core.kernels.thresholds import NO_CUT, axes_block, scan_thresholds
    from agglo_core.measure import RunResult, quality
    from agglo_core.mesh import Mesh
    from agglo_core.multigrid.krylov import pcg, pcg_columns
    from agglo_core.multigrid.prolongation import tentative
    from agglo_core.problems import (
        Diffusion,
        Discretisation,
        Field,
        Lifting,
        Linear,
        MultigridLevel,
        Patches,
        Problem,
        Samples,
        Solution,
        System,
    )
    from agglo_core.problems.backward_error import limit_told
    from agglo_core.problems.conjugate_gradients import MET, TESTS, History, conjugate_gradients, iterated
    from agglo_core.problems.deferred import Deferred
    from agglo_core.problems.real_system import symmetric_system
    from agglo_core.problems.sizes import energy_of_solution, relative_size, size_ratio, two_norm
    from agglo_core.progress import Listener, Progress, Tell, labelled, phase, to_nobody
    from agglo_core.protocols import Bisector, LevelBisector, Partitioner, Smoother, Target
    from agglo_core.registry import Command, Component, Record, Registry, default, describe, hookimpl
    from agglo_core.registry.attribution import Member, attributed
    from agglo_core.registry.code_options import ImportPath
    from agglo_core.threads import over_ranges

_TABLE = """
registry: Command Component Record Registry default describe hookimpl
errors: AggloError FileError MeshError OptionError PluginError
arrays: Float Index Int Mask UInt64 frozen frozen_float frozen_index frozen_int
mesh: Mesh
graph: Graph functionals
hierarchy: Hierarchy
protocols: Bisector LevelBisector Partitioner Smoother Target
problems: Diffusion Discretisation Field Lifting Linear MultigridLevel Patches Problem Samples Solution System
graph.blocks: TIE block_extents block_ranks block_shares block_sums integer_shares principal_frames
graph.blocks: split_at_median
graph.ordering: curve_order
graph.sweep: sweep sweep_arrays
graph.objectives: OBJECTIVES numbered_parts
components.fixers: ConnectivityFixer
components.geometric: InertialBisection
components.part_search: PartSearch
components.piece_growth: PieceGrowth
components.refiners: InterfaceRefiner
components.straight_cuts: SweepBisection
agglomeration.goals: SizeGoal
agglomeration.recursion: grow
agglomeration.run: Run
registry.attribution: Member attributed
registry.code_options: ImportPath
problems.backward_error: limit_told
problems.conjugate_gradients: MET TESTS History conjugate_gradients iterated
problems.deferred: Deferred
problems.sizes: energy_of_solution relative_size size_ratio two_norm
problems.real_system: symmetric_system
progress: Listener Progress Tell labelled phase to_nobody
kernels: helper kernel
kernels.axes: half_circle halvings planar_frame turned
kernels.centring: centre_block
kernels.thresholds: NO_CUT axes_block scan_thresholds
agglomeration: Pipeline agglomerate
measure: RunResult quality
io: check_writable read read_hierarchy write
io.atomic: staging
io.system_files: read_system write_system
multigrid.krylov: pcg pcg_columns
multigrid.prolongation: tentative
draw.plot: PALETTE colouring save_figure
cli.arguments: COMPONENT FILE agglomeration_options bisectors_option choice load_mesh metrics_option
cli.arguments: parse_spec
cli.number_types: Number
cli.tables: print_lines print_table
threads: over_ranges
"""
_LINES = (line.partition(":") for line in _TABLE.strip().splitlines())
_HOME = MappingProxyType({name: module for module, _, names in _LINES for name in names.split()})
_PIECES = dict.fromkeys(("piece_driver", "piece_frames", "piece_splits", "piece_sweeps"), "kernels.")
_MODULES = MappingProxyType({"conformance": "", "distributed": "", "multigrid": "", "samples": ""} | _PIECES)

__all__ = [
    "COMPONENT",
    "FILE",
    "MET",
    "NO_CUT",
    "OBJECTIVES",
    "PALETTE",
    "TESTS",
    "TIE",
    "AggloError",
    "Bisector",
    "Command",
    "Component",
    "ConnectivityFixer",
    "Deferred",
    "Diffusion",
    "Discretisation",
    "Field",
    "FileError",
    "Float",
    "Graph",
    "Hierarchy",
    "History",
    "ImportPath",
    "Index",
    "InertialBisection",
    "Int",
    "InterfaceRefiner",
    "LevelBisector",
    "Lifting",
    "Linear",
    "Listener",
    "Mask",
    "Member",
    "Mesh",
    "MeshError",
    "MultigridLevel",
    "Number",
    "OptionError",
    "PartSearch",
    "Partitioner",
    "Patches",
    "PieceGrowth",
    "Pipeline",
    "PluginError",
    "Problem",
    "Progress",
    "Record",
    "Registry",
    "Run",
    "RunResult",
    "Samples",
    "SizeGoal",
    "Smoother",
    "Solution",
    "SweepBisection",
    "System",
    "Target",
    "Tell",
    "UInt64",
    "__version__",
    "agglomerate",
    "agglomeration_options",
    "attributed",
    "axes_block",
    "bisectors_option",
    "block_extents",
    "block_ranks",
    "block_shares",
    "block_sums",
    "centre_block",
    "check_writable",
    "choice",
    "colouring",
    "conformance",
    "conjugate_gradients",
    "curve_order",
    "default",
    "describe",
    "distributed",
    "energy_of_solution",
    "frozen",
    "frozen_float",
    "frozen_index",
    "frozen_int",
    "functionals",
    "grow",
    "half_circle",
    "halvings",
    "helper",
    "hookimpl",
    "integer_shares",
    "iterated",
    "kernel",
    "labelled",
    "limit_told",
    "load_mesh",
    "metrics_option",
    "multigrid",
    "numbered_parts",
    "over_ranges",
    "parse_spec",
    "pcg",
    "pcg_columns",
    "phase",
    "piece_driver",
    "piece_frames",
    "piece_splits",
    "piece_sweeps",
    "planar_frame",
    "principal_frames",
    "print_lines",
    "print_table",
    "quality",
    "read",
    "read_hierarchy",
    "read_system",
    "relative_size",
    "samples",
    "save_figure",
    "scan_thresholds",
    "size_ratio",
    "split_at_median",
    "staging",
    "sweep",
    "sweep_arrays",
    "symmetric_system",
    "tentative",
    "to_nobody",
    "turned",
    "two_norm",
    "write",
    "write_system",
]


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(f"{__package__}.{_MODULES[name]}{name}")
    if name not in _HOME and name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = f"{__package__}.{_HOME[name]}" if name in _HOME else str(__package__)
    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
