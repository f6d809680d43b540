"""Scatter plots of runs by roundness, evenness and computing time, with the Pareto front."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.draw.colours import FINE, INK
from agglo_core.draw.label_places import label_places, stair_boxes, ties
from agglo_core.draw.plot import save_figure, short_name
from agglo_core.errors import OptionError
from agglo_core.measure.comparison import RunResult
from agglo_core.measure.trade_offs import Axis, TradeOffs, trade_offs

FRONT: Final = "no other run is rounder and more even"
BEST: Final = "thick ring: no other run is rounder, more even and faster at once"
_GAP: Final = 5.0  # points
_MARGIN: Final = 0.16  # margin of an axis, relative to its range of values


def draw_pareto(runs: Sequence[RunResult], path: str | os.PathLike[str], title: str = "") -> None:
    """Draw runs by roundness and evenness of their finest level, coloured by time, and write the picture.

    Up and to the right is better: axes where less is better are reversed. The axes are defined by
    :func:`~agglo_core.measure.trade_offs.trade_offs`.

    Parameters
    ----------
    runs : sequence of RunResult
        At least one successful run. Failed runs are named below the picture.
    path : path
        File, with the format chosen by the suffix: .png, .pdf, .svg, …
    title : str
        Title above the picture.

    Raises
    ------
    OptionError
        Without matplotlib, or without runs.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    tradeoffs = trade_offs(runs)
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error

    crowd = max(0, len(tradeoffs.names) - 8)
    figure = Figure(figsize=(8.2 + 0.12 * crowd, 5.6 + 0.12 * crowd), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.add_subplot()
    axis.plot(*stairs(tradeoffs).T, color="#888888", linewidth=1.2, zorder=1)
    _dots(figure, axis, tradeoffs)
    _axes(axis, tradeoffs)
    below = f"; not shown: {', '.join(map(short_name, tradeoffs.missing))}" if tradeoffs.missing else ""
    figure.supxlabel(f"grey line, the front: {FRONT}; {BEST}{below}", fontsize=7, color="#555555", wrap=True)
    if title:
        axis.set_title(title, fontsize=10, color=INK)
    _labels(figure, axis, tradeoffs)
    save_figure(figure, Path(path))


def reach(axis: Axis) -> tuple[float, float]:
    """Return the limits of an axis around its values, the worse end first."""
    low, high = float(axis.values.min()), float(axis.values.max())
    room = _MARGIN * (high - low) if high - low > 1e-6 * abs(high) else 0.05 * abs(high) or 0.05
    ends = low - room, high + room
    return ends if axis.high else ends[::-1]


def sense(axis: Axis) -> str:
    """Return the label of an axis, with a remark if lower values are better."""
    return axis.label if axis.high else f"{axis.label} (lower is better)"


def stairs(found: TradeOffs) -> Float:
    """Return the vertices ``(n, 2)`` of the Pareto front, drawn as a staircase."""
    front = found.front
    x, y = found.evenness.values[front], found.roundness.values[front]
    far, low = reach(found.evenness)[0], reach(found.roundness)[0]
    across, down = np.repeat(np.append(far, x), 2)[1:], np.repeat(np.append(y, low), 2)[:-1]
    return frozen_float(np.stack([across, down], axis=1))


def _dots(figure: Any, axis: Any, tradeoffs: TradeOffs) -> None:
    from matplotlib.colors import LogNorm

    low, high = float(tradeoffs.seconds.min()), float(tradeoffs.seconds.max())
    low, high = (low, high) if high > 1.5 * low else (low / 1.5, high * 1.5)
    dots = axis.scatter(
        tradeoffs.evenness.values,
        tradeoffs.roundness.values,
        c=tradeoffs.seconds,
        cmap="viridis_r",
        norm=LogNorm(low, high),
        s=52,
        edgecolor=INK,
        linewidth=np.where(tradeoffs.best, 2.0, 0.5),
        zorder=3,
    )
    bar = figure.colorbar(dots, ax=axis, fraction=0.05, pad=0.02)
    bar.set_label("CPU seconds", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    ticks = np.geomspace(low, high, 5)
    bar.set_ticks(ticks, labels=[f"{tick:.2g}" for tick in ticks])
    bar.minorticks_off()


def _axes(axis: Any, tradeoffs: TradeOffs) -> None:
    axis.set_xlim(*reach(tradeoffs.evenness))
    axis.set_ylim(*reach(tradeoffs.roundness))
    axis.set_xlabel(f"more even →\n{sense(tradeoffs.evenness)}", fontsize=9)
    axis.set_ylabel(f"{sense(tradeoffs.roundness)}\nbetter →", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(color="#e4e4e4", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def _labels(figure: Any, axis: Any, tradeoffs: TradeOffs) -> None:
    """Place the names of the runs beside their dots, with thin lines to distant dots."""
    style = {"fontsize": 8, "color": INK, "zorder": 4}
    texts = [
        axis.text(0.5, 0.5, short_name(name), transform=axis.transAxes, **style) for name in tradeoffs.labels
    ]
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # freeze the layout for measuring
    corner, pixels = np.array([axis.bbox.x0, axis.bbox.y0]), figure.dpi / 72.0
    boxes = [text.get_window_extent() for text in texts]
    sizes = np.array([(box.width, box.height) for box in boxes])

    def pixels_of(data: Float) -> Float:
        return frozen_float(axis.transData.transform(data) - corner)

    dots = pixels_of(np.stack([tradeoffs.evenness.values, tradeoffs.roundness.values], axis=1))
    frame, gap = np.array([axis.bbox.width, axis.bbox.height]), _GAP * pixels
    places = label_places(dots, sizes, frame, gap, stair_boxes(pixels_of(stairs(tradeoffs)), 2.0))
    for text, place in zip(texts, places, strict=True):
        text.set(position=place / frame, verticalalignment="bottom", in_layout=False)
    for label, end in ties(dots, sizes, places, gap).items():
        (x, y), thin = np.stack([dots[label], end], axis=1) / frame[:, None], {"linewidth": 0.7, "zorder": 2}
        axis.plot(x, y, transform=axis.transAxes, color=FINE, **thin)
