"""Drawing of meshes, levels, functions and convergence on matplotlib axes, for the ``plot`` methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import exact_cast, is_masked_array, plain_array
from agglo_core.draw.colours import Paint, by_number, by_tag, explain
from agglo_core.draw.convergence import Curves, frame_curves, one_curve
from agglo_core.draw.plane_panels import fine_edges
from agglo_core.draw.plot import panels_of
from agglo_core.draw.solution import Slice, middle_slice
from agglo_core.errors import MeshError, OptionError
from agglo_core.measure import quality
from agglo_core.mesh import Mesh
from agglo_core.problems import Samples, Solution

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.registry import Registry

_AXES = "xyz"


def plot_mesh(
    mesh: Mesh,
    ax: Any = None,
    *,
    values: str | ArrayLike | None = None,
    cmap: str = "viridis",
    section: Sequence[float] | None = None,
) -> Any:
    """Draw a mesh on axes, with the parameters of :meth:`agglo_core.Mesh.plot`."""
    check_axes(ax)
    panels, paint = panels_of(mesh, section=section), None
    if isinstance(values, str):
        if values not in mesh.cell_tags:
            raise OptionError(f"no cell tag {values!r}; {mesh!r} has {', '.join(mesh.cell_tags) or 'none'}")
        paint = by_tag(mesh.cell_tags[values], values, cmap)
    elif values is not None:
        paint = by_number(_check_values(values, mesh.n_cells, "cell"), "", cmap)
    ax = new_axes() if ax is None else ax
    panels.fine(ax, paint)
    return _finish_axes(ax, mesh, paint)


def plot_level(
    hierarchy: Hierarchy,
    level: int = 0,
    ax: Any = None,
    *,
    values: str | ArrayLike | None = None,
    cmap: str = "viridis",
    explode: float | None = None,
    section: Sequence[float] | None = None,
    registry: Registry | None = None,
) -> Any:
    """Draw a level on axes, with the parameters of :meth:`agglo_core.Hierarchy.plot`."""
    check_axes(ax)
    mesh = hierarchy.fine
    if mesh is None:
        raise MeshError("this hierarchy belongs to a graph: there is nothing to plot")
    labels = hierarchy[level]
    panels, paint = panels_of(mesh, explode, section), None
    if isinstance(values, str):
        paint = by_number(quality(mesh, labels, (values,), registry)[values], values, cmap)
    elif values is not None:
        paint = by_number(_check_values(values, hierarchy.parts[level], "agglomerate"), "", cmap)
    ax = new_axes() if ax is None else ax
    panels.level(ax, labels, paint)
    return _finish_axes(ax, mesh, paint)


def plot_samples(samples: Samples, ax: Any = None, *, across: str = "z", cmap: str = "viridis") -> Any:
    """Draw a function on axes, with the parameters of :meth:`agglo_core.problems.Samples.plot`."""
    check_axes(ax)
    if across not in ("x", "y", "z"):
        raise OptionError(f"across must be 'x', 'y' or 'z', given {across!r:.60}")
    from matplotlib.tri import Triangulation

    by_number([], cmap=cmap)  # refuses unknown names
    section = Slice(samples.points, samples.simplices, samples.sizes)
    names = "xy"
    if samples.points.shape[1] == 3:
        section, names = middle_slice(samples, _AXES.index(across)), _AXES.replace(across, "")
    ax = new_axes() if ax is None else ax
    corners = Triangulation(section.points[:, 0], section.points[:, 1], section.triangles)
    ends = {"vmin": samples.sizes.min(), "vmax": samples.sizes.max()}
    colours = ax.tripcolor(corners, section.values, shading="gouraud", rasterized=True, cmap=cmap, **ends)
    ax.set(aspect="equal", xlabel=names[0], ylabel=names[1])
    ax.get_figure().colorbar(colours, ax=ax).set_label("u", rotation=0)  # turned, it looks like an n
    return ax


def plot_solution(solution: Solution, ax: Any = None, *, across: str = "z", cmap: str = "viridis") -> Any:
    """Draw a solution with its cells on axes, as :meth:`agglo_core.problems.Solution.plot`."""
    check_axes(ax)
    samples = solution.samples()
    ax = plot_samples(samples, ax, across=across, cmap=cmap)
    if solution.mesh is not None and solution.mesh.dim == 2:
        fine_edges(ax, solution.mesh)
    return ax


def plot_convergence(solution: Solution, ax: Any = None) -> Any:
    """Draw residuals and energy errors on axes, as :meth:`agglo_core.problems.Solution.plot`."""
    check_axes(ax)
    curves = Curves.of(solution)
    ax = new_axes() if ax is None else ax
    one_curve(ax, "", curves)
    frame_curves(ax, [curves])
    ax.legend(fontsize=8, frameon=False)
    return ax


def check_axes(ax: Any) -> None:
    """Raise OptionError without matplotlib, or if ``ax`` is neither 2-D axes nor None."""
    try:
        from matplotlib.axes import Axes
    except ImportError as error:
        raise OptionError(f'plotting needs matplotlib: pip install "agglo[plot]" ({error})') from error
    if ax is not None and not isinstance(ax, Axes):
        raise OptionError(
            f"ax must be matplotlib axes, as returned by plt.subplots()[1], given {type(ax).__name__}"
        )
    if ax is not None and ax.name != "rectilinear":
        raise OptionError(
            f"ax must be 2-D axes (3-D meshes are drawn as pictures), given projection {ax.name!r}"
        )


def new_axes() -> Any:
    """Return the axes of a new pyplot figure, which notebooks and ``plt.show()`` display."""
    from matplotlib import pyplot

    return pyplot.figure(layout="constrained").add_subplot()


def _check_values(values: ArrayLike, count: int, entity: str) -> Any:
    """Return values as floats ``(count,)``, with NaN for masked ones. A wrong shape raises OptionError."""
    if is_masked_array(values):
        values = np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan)  # drawn in grey, like NaN
    name = f"values (a name or numbers, one for each {entity})"
    numbers = exact_cast(plain_array(values, name, OptionError), np.float64, name, OptionError)
    if numbers.shape != (count,):
        raise OptionError(f"values must have shape ({count},), one per {entity}, given {numbers.shape}")
    return numbers


def _finish_axes(ax: Any, mesh: Mesh, paint: Paint | None) -> Any:
    if mesh.dim == 3:  # solids are images, and pixel coordinates have no meaning
        ax.set_axis_off()
    if paint is not None:
        explain(ax, paint)
    return ax
