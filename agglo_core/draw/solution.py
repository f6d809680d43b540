"""Pictures of solutions, in 3-D on three planes through the middle of the domain."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.draw.plot import save_figure
from agglo_core.errors import MeshError, OptionError
from agglo_core.mesh.checks import name_cells
from agglo_core.problems.discretisation import Samples

_TRIANGLE = ((0, 1), (0, 2), (0, 3))
_QUADRILATERAL = (((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2)))
"""Cut edges of a tetrahedron with corners sorted by height over the plane."""


class Slice(NamedTuple):
    """Piecewise linear function on triangles in a plane, which may jump between triangles."""

    points: Float  # (3 t, 2)
    triangles: Int  # (t, 3)
    values: Float  # (3 t,)


def middle_slice(samples: Samples, axis: int) -> Slice:
    """Restrict a function on tetrahedra to the plane across ``axis`` through the middle of the domain.

    Parameters
    ----------
    samples : Samples
        3-D samples.
    axis : int
        Axis 0, 1 or 2. The other two axes are the coordinates of the slice, in order.

    Raises
    ------
    MeshError
        For cells without tetrahedra.
    """
    whole = np.setdiff1d(samples.cells, samples.cells[samples.simplices])
    if len(whole):
        raise MeshError(
            f"{name_cells(whole)}: not star-shaped from the centroid, so not divided into tetrahedra for a "
            "picture; write the solution as .vtu instead"
        )
    coordinates = samples.points[:, axis]
    # Select the tetrahedra cut by the plane, with corners sorted by height.
    height = coordinates - (coordinates.min() + coordinates.max()) / 2
    lower = (height < 0.0)[samples.simplices].sum(axis=1)
    cut = (lower > 0) & (lower < 4)
    corners, lower = samples.simplices[cut], lower[cut]
    corners = np.take_along_axis(corners, np.argsort(height[corners], axis=1, kind="stable"), axis=1)
    edges = [corners[lower == 1][:, _TRIANGLE], corners[lower == 3][:, ::-1][:, _TRIANGLE]]
    # Cut edges: one triangle if one corner is apart, two triangles otherwise.
    edges += [corners[lower == 2][:, half] for half in _QUADRILATERAL]
    tail, head = np.concatenate(edges).reshape(-1, 2).T
    # Interpolate points and values on the cut edges.
    share = height[tail] / (height[tail] - height[head])
    points = samples.points[tail] + share[:, None] * (samples.points[head] - samples.points[tail])
    values = samples.sizes[tail] + share * (samples.sizes[head] - samples.sizes[tail])
    return Slice(np.delete(points, axis, axis=1), np.arange(len(values)).reshape(-1, 3), values)


_AXES = "xyz"


def draw_solution(path: Path, samples: Samples) -> None:
    """Draw a discontinuous function in colours, in 3-D on three planes through the middle of the domain.

    Raises
    ------
    OptionError
        Without matplotlib.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.tri import Triangulation
    except ImportError as error:
        raise OptionError(f"drawing needs matplotlib: pip install 'agglo[plot]' ({error})") from error
    slices = _slices(samples)
    figure = Figure(figsize=(1.0 + 5.0 * len(slices), 5.0), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(1, len(slices), squeeze=False, subplot_kw={"aspect": "equal"})[0]
    low, high = (float(end(samples.sizes)) for end in (np.min, np.max))
    for axis, (title, section) in zip(axes, slices.items(), strict=True):
        corners = Triangulation(section.points[:, 0], section.points[:, 1], section.triangles)
        colours = axis.tripcolor(
            corners, section.values, shading="gouraud", rasterized=True, vmin=low, vmax=high
        )
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
    figure.colorbar(colours, ax=axes).set_label("u", rotation=0)  # turned, it looks like an n
    save_figure(figure, path)


def _slices(samples: Samples) -> dict[str, Slice]:
    """Return plane pictures by title: the function itself in 2-D, or three slices in 3-D."""
    if samples.points.shape[1] == 2:
        return {"": Slice(samples.points, samples.simplices, samples.sizes)}
    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    middle = (low + high) / 2
    return {f"{name} = {middle[k]:.4g}": middle_slice(samples, k) for k, name in enumerate(_AXES)}
