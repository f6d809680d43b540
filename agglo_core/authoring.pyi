"""Names for authors of plugins, each with the module it comes from; imported when first used."""

from agglo_core import (
    __version__ as __version__,
    conformance as conformance,
    distributed as distributed,
    fields as fields,
    multigrid as multigrid,
    samples as samples,
    solvers as solvers,
)
from agglo_core.agglomeration import (
    Pipeline as Pipeline,
    agglomerate as agglomerate,
)
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
from agglo_core.cli.options.agglomeration import (
    agglomeration_options as agglomeration_options,
)
from agglo_core.cli.options.numbers import Number as Number
from agglo_core.cli.options.specs import (
    choice as choice,
    load_mesh as load_mesh,
)
from agglo_core.cli.output.tables import (
    print_lines as print_lines,
    print_table as print_table,
)
from agglo_core.compiled import (
    helper as helper,
    kernel as kernel,
)
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
    split_at_median as split_at_median,
)
from agglo_core.graph.objectives import (
    OBJECTIVES as OBJECTIVES,
)
from agglo_core.hierarchy import Hierarchy as Hierarchy
from agglo_core.io import (
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
from agglo_core.multigrid.krylov.pcg import (
    pcg as pcg,
)
from agglo_core.problems import (
    CoarseSpace as CoarseSpace,
    Diffusion as Diffusion,
    Discretisation as Discretisation,
    Elasticity as Elasticity,
    Field as Field,
    Lifting as Lifting,
    Linear as Linear,
    MultigridLevel as MultigridLevel,
    Patches as Patches,
    Problem as Problem,
    Quadrature as Quadrature,
    Samples as Samples,
    Solution as Solution,
    System as System,
    VectorField as VectorField,
)
from agglo_core.problems.iteration_history import (
    History as History,
)
from agglo_core.progress import (
    Listener as Listener,
    Notify as Notify,
    Progress as Progress,
    phase as phase,
)
from agglo_core.protocols import (
    Bisector as Bisector,
    Estimator as Estimator,
    LevelBisector as LevelBisector,
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
from agglo_core.registry.code_options import ImportPath as ImportPath
from agglo_core.split.geometric import InertialBisection as InertialBisection
from agglo_core.split.straight_cuts import SweepBisection as SweepBisection
