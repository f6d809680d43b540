"""Public names of the package, each with the module it comes from; imported when first used."""

from agglo_core import (
    conformance as conformance,
    distributed as distributed,
    errors as errors,
    interchange as interchange,
    io as io,
    problems as problems,
    progress as progress,
    registry as registry,
    samples as samples,
)
from agglo_core.adaptivity import (
    Adaptation as Adaptation,
    adapt as adapt,
)
from agglo_core.agglomeration import (
    Pipeline as Pipeline,
    agglomerate as agglomerate,
)
from agglo_core.draw import plot as plot
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
from agglo_core.hierarchy import Hierarchy as Hierarchy
from agglo_core.io import (
    read as read,
    read_hierarchy as read_hierarchy,
    write as write,
)
from agglo_core.measure import quality as quality
from agglo_core.mesh import Mesh as Mesh
from agglo_core.multigrid.system_levels import build_levels as build_levels
from agglo_core.problems import (
    Diffusion as Diffusion,
    Elasticity as Elasticity,
    Linear as Linear,
    Solution as Solution,
    evolve as evolve,
    newton as newton,
    solve as solve,
)
from agglo_core.progress import Progress as Progress
from agglo_core.protocols import Target as Target
from agglo_core.registry import (
    Command as Command,
    Component as Component,
    Registry as Registry,
    hookimpl as hookimpl,
)
from agglo_core.threads import using_threads as using_threads

plugins = registry

__version__: str
