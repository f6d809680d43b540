"""A picture of a solution."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.draw.plot import save_figure
from agglo_core.draw.slices import Slice, middle_slice
from agglo_core.errors import OptionError
from agglo_core.problems.discretisation import Samples

_AXES = "xyz"


def draw_solution(path: Path, samples: Samples) -> None:
    """Draw a function in colours, with its jumps; in 3-D on three planes through the middle.

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
    low, high = (float(end(samples.values)) for end in (np.min, np.max))
    for axis, (title, shown) in zip(axes, slices.items(), strict=True):
        corners = Triangulation(shown.points[:, 0], shown.points[:, 1], shown.triangles)
        colours = axis.tripcolor(
            corners, shown.values, shading="gouraud", rasterized=True, vmin=low, vmax=high
        )
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
    figure.colorbar(colours, ax=axes, label="u")
    save_figure(figure, path)


def _slices(samples: Samples) -> dict[str, Slice]:
    """What is drawn, by title: the function itself, or in 3-D what it is on three planes."""
    if samples.points.shape[1] == 2:
        return {"": Slice(samples.points, samples.simplices, samples.values)}
    low, high = samples.points.min(axis=0), samples.points.max(axis=0)
    middle = (low + high) / 2
    return {f"{name} = {middle[k]:.4g}": middle_slice(samples, k) for k, name in enumerate(_AXES)}
