"""Public names of the package, each with the module it comes from; imported when first used."""

from agglo_core import (
    conformance as conformance,
)
from agglo_core import (
    distributed as distributed,
)
from agglo_core import (
    errors as errors,
)
from agglo_core import (
    interchange as interchange,
)
from agglo_core import (
    io as io,
)
from agglo_core import (
    problems as problems,
)
from agglo_core import (
    progress as progress,
)
from agglo_core import (
    registry as registry,
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
from agglo_core.draw import plot as plot
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
from agglo_core.hierarchy import Hierarchy as Hierarchy
from agglo_core.io import (
    read as read,
)
from agglo_core.io import (
    read_hierarchy as read_hierarchy,
)
from agglo_core.io import (
    write as write,
)
from agglo_core.measure import quality as quality
from agglo_core.mesh import Mesh as Mesh
from agglo_core.problems import (
    Diffusion as Diffusion,
)
from agglo_core.problems import (
    Linear as Linear,
)
from agglo_core.problems import (
    Solution as Solution,
)
from agglo_core.progress import Progress as Progress
from agglo_core.protocols import Target as Target
from agglo_core.registry import (
    Command as Command,
)
from agglo_core.registry import (
    Component as Component,
)
from agglo_core.registry import (
    Registry as Registry,
)
from agglo_core.registry import (
    hookimpl as hookimpl,
)
from agglo_core.threads import using_threads as using_threads

plugins = registry

__version__: str
