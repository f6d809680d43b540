"""Names for authors of plugins, each with the module it comes from; imported when first used."""

from agglo_core import (
    __version__ as __version__,
)
from agglo_core import (
    conformance as conformance,
)
from agglo_core import (
    distributed as distributed,
)
from agglo_core import (
    multigrid as multigrid,
)
from agglo_core import (
    samples as samples,
)
from agglo_core.agglomeration import (
    Pipeline as Pipeline,
)
from agglo_core.agglomeration import (
    agglomerate as agglomerate,
)
from agglo_core.agglomeration.goals import SizeGoal as SizeGoal
from agglo_core.agglomeration.recursion import grow as grow
from agglo_core.agglomeration.run import Run as Run
from agglo_core.arrays import (
    Float as Float,
)
from agglo_core.arrays import (
    Index as Index,
)
from agglo_core.arrays import (
    Int as Int,
)
from agglo_core.arrays import (
    Mask as Mask,
)
from agglo_core.arrays import (
    UInt64 as UInt64,
)
from agglo_core.arrays import (
    frozen as frozen,
)
from agglo_core.arrays import (
    frozen_float as frozen_float,
)
from agglo_core.arrays import (
    frozen_index as frozen_index,
)
from agglo_core.arrays import (
    frozen_int as frozen_int,
)
from agglo_core.cli.arguments import (
    COMPONENT as COMPONENT,
)
from agglo_core.cli.arguments import (
    FILE as FILE,
)
from agglo_core.cli.arguments import (
    agglomeration_options as agglomeration_options,
)
from agglo_core.cli.arguments import (
    bisectors_option as bisectors_option,
)
from agglo_core.cli.arguments import (
    choice as choice,
)
from agglo_core.cli.arguments import (
    load_mesh as load_mesh,
)
from agglo_core.cli.arguments import (
    metrics_option as metrics_option,
)
from agglo_core.cli.arguments import (
    parse_spec as parse_spec,
)
from agglo_core.cli.number_types import Number as Number
from agglo_core.cli.tables import (
    print_lines as print_lines,
)
from agglo_core.cli.tables import (
    print_table as print_table,
)
from agglo_core.components.fixers import ConnectivityFixer as ConnectivityFixer
from agglo_core.components.geometric import InertialBisection as InertialBisection
from agglo_core.components.part_search import PartSearch as PartSearch
from agglo_core.components.piece_growth import PieceGrowth as PieceGrowth
from agglo_core.components.refiners import InterfaceRefiner as InterfaceRefiner
from agglo_core.components.straight_cuts import SweepBisection as SweepBisection
from agglo_core.draw.plot import (
    PALETTE as PALETTE,
)
from agglo_core.draw.plot import (
    colouring as colouring,
)
from agglo_core.draw.plot import (
    save_figure as save_figure,
)
from agglo_core.errors import (
    AggloError as AggloError,
)
from agglo_core.errors import (
    FileError as FileError,
)
from agglo_core.errors import (
    MeshError as MeshError,
)
from agglo_core.errors import (
    OptionError as OptionError,
)
from agglo_core.errors import (
    PluginError as PluginError,
)
from agglo_core.graph import (
    Graph as Graph,
)
from agglo_core.graph import (
    functionals as functionals,
)
from agglo_core.graph.blocks import (
    TIE as TIE,
)
from agglo_core.graph.blocks import (
    block_extents as block_extents,
)
from agglo_core.graph.blocks import (
    block_ranks as block_ranks,
)
from agglo_core.graph.blocks import (
    block_shares as block_shares,
)
from agglo_core.graph.blocks import (
    block_sums as block_sums,
)
from agglo_core.graph.blocks import (
    integer_shares as integer_shares,
)
from agglo_core.graph.blocks import (
    principal_frames as principal_frames,
)
from agglo_core.graph.blocks import (
    split_at_median as split_at_median,
)
from agglo_core.graph.objectives import (
    OBJECTIVES as OBJECTIVES,
)
from agglo_core.graph.objectives import (
    numbered_parts as numbered_parts,
)
from agglo_core.graph.ordering import curve_order as curve_order
from agglo_core.graph.sweep import (
    sweep as sweep,
)
from agglo_core.graph.sweep import (
    sweep_arrays as sweep_arrays,
)
from agglo_core.hierarchy import Hierarchy as Hierarchy
from agglo_core.io import (
    check_writable as check_writable,
)
from agglo_core.io import (
    read as read,
)
from agglo_core.io import (
    read_hierarchy as read_hierarchy,
)
from agglo_core.io import (
    write as write,
)
from agglo_core.io.atomic import staging as staging
from agglo_core.io.system_files import (
    read_system as read_system,
)
from agglo_core.io.system_files import (
    write_system as write_system,
)
from agglo_core.kernels import (
    helper as helper,
)
from agglo_core.kernels import (
    kernel as kernel,
)
from agglo_core.kernels import (
    piece_driver as piece_driver,
)
from agglo_core.kernels import (
    piece_frames as piece_frames,
)
from agglo_core.kernels import (
    piece_splits as piece_splits,
)
from agglo_core.kernels import (
    piece_sweeps as piece_sweeps,
)
from agglo_core.kernels.axes import (
    half_circle as half_circle,
)
from agglo_core.kernels.axes import (
    halvings as halvings,
)
from agglo_core.kernels.axes import (
    planar_frame as planar_frame,
)
from agglo_core.kernels.axes import (
    turned as turned,
)
from agglo_core.kernels.centring import centre_block as centre_block
from agglo_core.kernels.thresholds import (
    NO_CUT as NO_CUT,
)
from agglo_core.kernels.thresholds import (
    axes_block as axes_block,
)
from agglo_core.kernels.thresholds import (
    scan_thresholds as scan_thresholds,
)
from agglo_core.measure import (
    RunResult as RunResult,
)
from agglo_core.measure import (
    quality as quality,
)
from agglo_core.mesh import Mesh as Mesh
from agglo_core.multigrid.krylov import (
    pcg as pcg,
)
from agglo_core.multigrid.krylov import (
    pcg_columns as pcg_columns,
)
from agglo_core.multigrid.prolongation import tentative as tentative
from agglo_core.problems import (
    Diffusion as Diffusion,
)
from agglo_core.problems import (
    Discretisation as Discretisation,
)
from agglo_core.problems import (
    Field as Field,
)
from agglo_core.problems import (
    Lifting as Lifting,
)
from agglo_core.problems import (
    Linear as Linear,
)
from agglo_core.problems import (
    MultigridLevel as MultigridLevel,
)
from agglo_core.problems import (
    Patches as Patches,
)
from agglo_core.problems import (
    Problem as Problem,
)
from agglo_core.problems import (
    Samples as Samples,
)
from agglo_core.problems import (
    Solution as Solution,
)
from agglo_core.problems import (
    System as System,
)
from agglo_core.problems.backward_error import limit_told as limit_told
from agglo_core.problems.conjugate_gradients import (
    MET as MET,
)
from agglo_core.problems.conjugate_gradients import (
    TESTS as TESTS,
)
from agglo_core.problems.conjugate_gradients import (
    History as History,
)
from agglo_core.problems.conjugate_gradients import (
    conjugate_gradients as conjugate_gradients,
)
from agglo_core.problems.conjugate_gradients import (
    iterated as iterated,
)
from agglo_core.problems.deferred import Deferred as Deferred
from agglo_core.problems.real_system import symmetric_system as symmetric_system
from agglo_core.problems.sizes import (
    energy_of_solution as energy_of_solution,
)
from agglo_core.problems.sizes import (
    relative_size as relative_size,
)
from agglo_core.problems.sizes import (
    size_ratio as size_ratio,
)
from agglo_core.problems.sizes import (
    two_norm as two_norm,
)
from agglo_core.progress import (
    Listener as Listener,
)
from agglo_core.progress import (
    Progress as Progress,
)
from agglo_core.progress import (
    Tell as Tell,
)
from agglo_core.progress import (
    labelled as labelled,
)
from agglo_core.progress import (
    phase as phase,
)
from agglo_core.progress import (
    to_nobody as to_nobody,
)
from agglo_core.protocols import (
    Bisector as Bisector,
)
from agglo_core.protocols import (
    LevelBisector as LevelBisector,
)
from agglo_core.protocols import (
    Partitioner as Partitioner,
)
from agglo_core.protocols import (
    Smoother as Smoother,
)
from agglo_core.protocols import (
    Target as Target,
)
from agglo_core.registry import (
    Command as Command,
)
from agglo_core.registry import (
    Component as Component,
)
from agglo_core.registry import (
    Record as Record,
)
from agglo_core.registry import (
    Registry as Registry,
)
from agglo_core.registry import (
    default as default,
)
from agglo_core.registry import (
    describe as describe,
)
from agglo_core.registry import (
    hookimpl as hookimpl,
)
from agglo_core.registry.attribution import (
    Member as Member,
)
from agglo_core.registry.attribution import (
    attributed as attributed,
)
from agglo_core.registry.code_options import ImportPath as ImportPath
from agglo_core.threads import over_ranges as over_ranges
