"""Pictures of a function that changes in time: a table of states, and a film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agglo_core.draw.plot import save_figure
from agglo_core.errors import FileError, OptionError
from agglo_core.io.atomic import staging
from agglo_core.problems.discretisation import Samples

_CMAP = "inferno"
_FRAMES_PER_SECOND = 8


def draw_states(
    path: Path, rows: Mapping[str, Sequence[Samples]], titles: Sequence[str], ends: tuple[float, float]
) -> None:
    """Draw a row of 2-D states for each name, all in the colours of the values from ``ends``.

    Raises
    ------
    OptionError
        Without matplotlib.
    FileError
        If the file cannot be written.
    """
    figure = _figure(2.6 * len(titles), 1.0 + 2.2 * len(rows))
    axes: Any = figure.subplots(len(rows), len(titles), squeeze=False)
    for line, (name, states) in zip(axes, rows.items(), strict=True):
        for axis, title, state in zip(line, titles, states, strict=True):
            colours = _paint(axis, state, ends)
            axis.set_title(f"{name}, {title}", fontsize=8)
    figure.colorbar(colours, ax=axes, shrink=0.5).set_label("u", rotation=0)
    save_figure(figure, path)


def draw_film(path: Path, frames: Mapping[str, Samples], ends: tuple[float, float]) -> None:
    """Write an animated picture (GIF) of 2-D states by title.

    Raises
    ------
    OptionError
        Without matplotlib.
    FileError
        If the file cannot be written.
    """
    figure = _figure(5.0, 4.0)
    from matplotlib.animation import PillowWriter

    axis: Any = figure.add_subplot()
    colours = _paint(axis, next(iter(frames.values())), ends)
    figure.colorbar(colours, ax=axis).set_label("u", rotation=0)
    film = PillowWriter(fps=_FRAMES_PER_SECOND)
    try:
        with staging(path) as folder, film.saving(figure, folder / path.name, dpi=100):
            for title, state in frames.items():
                colours.set_array(state.values)
                axis.set_title(title, fontsize=10)
                film.grab_frame()
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error


def _figure(width: float, height: float) -> Any:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error
    figure = Figure(figsize=(width, height), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _paint(axis: Any, state: Samples, ends: tuple[float, float]) -> Any:
    """Draw one state without frame, and return its colours."""
    from matplotlib.tri import Triangulation

    corners = Triangulation(state.points[:, 0], state.points[:, 1], state.simplices)
    axis.set_aspect("equal")
    axis.set_axis_off()
    low, high = ends
    return axis.tripcolor(corners, state.values, shading="gouraud", cmap=_CMAP, vmin=low, vmax=high)
