"""Names for authors of plugins, each with the module it comes from; imported when first used."""

from agglo_core import (
    __version__ as __version__,
    conformance as conformance,
    distributed as distributed,
    multigrid as multigrid,
    samples as samples,
    solvers as solvers,
)
from agglo_core.agglomeration import (
    Pipeline as Pipeline,
    agglomerate as agglomerate,
)
from agglo_core.agglomeration.goals import SizeGoal as SizeGoal
from agglo_core.agglomeration.levels.recursion import grow as grow
from agglo_core.agglomeration.run import Run as Run
from agglo_core.anneal.part_search import PartSearch as PartSearch
from agglo_core.arrays import (
    Float as Float,
    Index as Index,
    Int as Int,
    Mask as Mask,
    UInt64 as UInt64,
    frozen as frozen,
    frozen_float as frozen_float,
    frozen_index as frozen_index,
    frozen_int as frozen_int,
)
from agglo_core.cli.options.agglomeration import FILE as FILE, agglomeration_options as agglomeration_options
from agglo_core.cli.options.numbers import Number as Number
from agglo_core.cli.options.shared import (
    COMPONENT as COMPONENT,
    bisectors_option as bisectors_option,
    metrics_option as metrics_option,
)
from agglo_core.cli.options.specs import choice as choice, load_mesh as load_mesh, parse_spec as parse_spec
from agglo_core.cli.output.tables import (
    print_lines as print_lines,
    print_table as print_table,
)
from agglo_core.compiled import (
    helper as helper,
    kernel as kernel,
)
from agglo_core.compiled.frames import (
    centre_block as centre_block,
    half_circle as half_circle,
    halvings as halvings,
    planar_frame as planar_frame,
    turned as turned,
)
from agglo_core.compiled.thresholds import (
    NO_CUT as NO_CUT,
    axes_block as axes_block,
    scan_thresholds as scan_thresholds,
)
from agglo_core.draw.colours import PALETTE as PALETTE, colouring as colouring
from agglo_core.draw.plot import save_figure as save_figure
from agglo_core.errors import (
    AggloError as AggloError,
    FileError as FileError,
    MeshError as MeshError,
    OptionError as OptionError,
    PluginError as PluginError,
)
from agglo_core.graph import (
    Graph as Graph,
    functionals as functionals,
)
from agglo_core.graph.blocks import (
    TIE as TIE,
    block_extents as block_extents,
    block_ranks as block_ranks,
    block_shares as block_shares,
    block_sums as block_sums,
    integer_shares as integer_shares,
    principal_frames as principal_frames,
    split_at_median as split_at_median,
)
from agglo_core.graph.frame import moving_frame as moving_frame
from agglo_core.graph.objectives import (
    OBJECTIVES as OBJECTIVES,
    numbered_parts as numbered_parts,
)
from agglo_core.graph.ordering import curve_order as curve_order
from agglo_core.graph.sweep import (
    sweep as sweep,
    sweep_arrays as sweep_arrays,
)
from agglo_core.hierarchy import Hierarchy as Hierarchy
from agglo_core.io import (
    check_writable as check_writable,
    read as read,
    read_hierarchy as read_hierarchy,
    write as write,
)
from agglo_core.io.atomic import staging as staging
from agglo_core.io.system_files import (
    read_system as read_system,
    write_system as write_system,
)
from agglo_core.measure import (
    RunResult as RunResult,
    quality as quality,
)
from agglo_core.mesh import Mesh as Mesh
from agglo_core.multigrid.coarsening.prolongation import tentative as tentative
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients as conjugate_gradients
from agglo_core.multigrid.krylov.pcg import (
    pcg as pcg,
    pcg_columns as pcg_columns,
)
from agglo_core.problems import (
    Diffusion as Diffusion,
    Discretisation as Discretisation,
    Field as Field,
    Lifting as Lifting,
    Linear as Linear,
    MultigridLevel as MultigridLevel,
    Patches as Patches,
    Problem as Problem,
    Samples as Samples,
    Solution as Solution,
    System as System,
)
from agglo_core.problems.iteration_history import (
    MET as MET,
    TESTS as TESTS,
    History as History,
    iterated as iterated,
)
from agglo_core.problems.linear import symmetric_system as symmetric_system
from agglo_core.problems.residuals.backward_error import limit_told as limit_told
from agglo_core.problems.residuals.sizes import (
    energy_of_solution as energy_of_solution,
    relative_size as relative_size,
    size_ratio as size_ratio,
    two_norm as two_norm,
)
from agglo_core.problems.solution import Deferred as Deferred
from agglo_core.progress import (
    Listener as Listener,
    Progress as Progress,
    Tell as Tell,
    labelled as labelled,
    phase as phase,
    to_nobody as to_nobody,
)
from agglo_core.protocols import (
    Bisector as Bisector,
    LevelBisector as LevelBisector,
    Partitioner as Partitioner,
    Smoother as Smoother,
    Target as Target,
)
from agglo_core.refine.compactness.refiner import CompactnessRefiner as CompactnessRefiner
from agglo_core.refine.connectivity import ConnectivityFixer as ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner as InterfaceRefiner
from agglo_core.registry import (
    Command as Command,
    Component as Component,
    Record as Record,
    Registry as Registry,
    default as default,
    describe as describe,
    hookimpl as hookimpl,
)
from agglo_core.registry.attribution import (
    Member as Member,
    attributed as attributed,
)
from agglo_core.registry.code_options import ImportPath as ImportPath
from agglo_core.split import (
    piece_driver as piece_driver,
    piece_frames as piece_frames,
    piece_splits as piece_splits,
    piece_sweeps as piece_sweeps,
)
from agglo_core.split.geometric import InertialBisection as InertialBisection
from agglo_core.split.piece_growth import PieceGrowth as PieceGrowth
from agglo_core.split.straight_cuts import SweepBisection as SweepBisection
from agglo_core.threads import (
    COSTLY as COSTLY,
    one_blas_thread as one_blas_thread,
    over_ranges as over_ranges,
)
