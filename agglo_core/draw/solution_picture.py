"""A picture of a solution."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from agglo_core.draw.plot import save_figure
from agglo_core.errors import MeshError, OptionError
from agglo_core.problems.discretisation import Samples

__all__ = ["draw_solution"]


def draw_solution(path: Path, samples: Samples) -> None:
    """Draw a function of the plane in colours, with its jumps.

    Raises
    ------
    MeshError
        For a function in 3-D.
    OptionError
        Without matplotlib.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    if samples.points.shape[1] != 2:
        raise MeshError("pictures of solutions exist only in 2-D")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.tri import Triangulation
    except ImportError as error:
        raise OptionError(f"drawing needs matplotlib: pip install 'agglo[plot]' ({error})") from error
    figure = Figure(figsize=(6.0, 5.0), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.add_subplot(aspect="equal")
    corners = Triangulation(samples.points[:, 0], samples.points[:, 1], samples.simplices)
    colours = axis.tripcolor(corners, samples.values, shading="gouraud", rasterized=True)
    figure.colorbar(colours, ax=axis, label="u")
    axis.set_axis_off()
    save_figure(figure, path)
