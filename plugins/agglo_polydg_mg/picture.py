"""A picture of a solution."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from agglo_core.arrays import Float
from agglo_core.draw.plot import save_figure
from agglo_core.errors import FileError, OptionError
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.output import sampled

__all__ = ["check_picture", "draw_solution"]

_SUFFIXES = (".png", ".pdf", ".svg")
_LACKING = "drawing needs matplotlib: pip install 'agglo[plot]'"


def check_picture(path: Path) -> None:
    """Raise FileError unless a picture can be written there, as far as can be seen.

    Without matplotlib, OptionError.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise FileError(f"{path}: pictures end in {', '.join(_SUFFIXES)}, not {path.suffix!r}")
    if path.is_dir():
        raise FileError(f"{path}: is a folder, expected a file name")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")
    if find_spec("matplotlib") is None:
        raise OptionError(_LACKING)


def draw_solution(path: Path, basis: Basis, x: Float) -> None:
    """Draw the function with coefficients ``x (n,)`` in colours, with its jumps.

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
        raise OptionError(f"{_LACKING} ({error})") from error
    cells, points, triangles = sampled(basis)
    figure = Figure(figsize=(6.0, 5.0), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.add_subplot(aspect="equal")
    values = basis.evaluate(x, cells, points)
    corners = Triangulation(points[:, 0], points[:, 1], triangles)
    colours = axis.tripcolor(corners, values, shading="gouraud", rasterized=True)
    figure.colorbar(colours, ax=axis, label="u")
    axis.set_axis_off()
    save_figure(figure, path)
