"""Box plots of quality metrics for each run, as in the paper."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.draw.colours import FINE, GRID, INK, PALETTE
from agglo_core.draw.plot import save_figure
from agglo_core.errors import OptionError

_TITLES = {"UF": "uniformity factor UF", "CR": "circle ratio CR", "CRc": "circle ratio CRc, centred"}


def draw_boxes(
    runs: Mapping[str, Mapping[str, Float]],
    path: str | os.PathLike[str],
    metrics: Sequence[str] = ("UF", "CR"),
    title: str = "",
) -> None:
    """Draw box plots of metrics, one panel per metric with one box per run, to a file.

    Boxes span the quartiles, whiskers reach 1.5 box lengths further, lines are medians, diamonds means.

    Parameters
    ----------
    runs : mapping of run name to (mapping of metric to (k,) float)
        At least one.
    path : path
        The suffix chooses the format.
    metrics : sequence of str
        Metrics with values in [0, 1].
    title : str
        Title above the panels.

    Raises
    ------
    OptionError
        Without matplotlib, without runs, or for a run without values of a metric.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    if not runs:
        raise OptionError("nothing to draw: give at least one run")
    for name, values in runs.items():
        if missing := [metric for metric in metrics if metric not in values]:
            raise OptionError(
                f"run {name!r} has no values of {', '.join(missing)}; it has {', '.join(values)}"
            )
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error

    # One panel per metric.
    width = 1.4 + max(2.6, 0.75 * len(runs))
    figure = Figure(figsize=(len(metrics) * width, 4.2), dpi=160)
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.1)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=10)
    panels = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    for axis, metric in zip(panels, metrics, strict=True):
        _boxes(axis, {name: values[metric] for name, values in runs.items()})
        axis.set_title(_TITLES.get(metric, metric), fontsize=10)
    save_figure(figure, Path(path))


def _boxes(axis: Any, values: Mapping[str, Float]) -> None:
    artists = axis.boxplot(
        [v[v == v] for v in values.values()],  # NaN: undefined
        widths=0.6,
        patch_artist=True,
        showmeans=True,
        medianprops={"color": INK, "linewidth": 1.4},
        meanprops={"marker": "D", "markersize": 4, "markerfacecolor": "white", "markeredgecolor": INK},
        flierprops={"marker": ".", "markersize": 3, "markeredgecolor": FINE},
    )
    for place, box in enumerate(artists["boxes"]):
        box.set_facecolor(PALETTE[place % len(PALETTE)])
    steep = sum(map(len, values)) > 40
    axis.set_xticks(
        np.arange(1, len(values) + 1),
        list(values),
        rotation=30 if steep else 0,
        ha="right" if steep else "center",
        fontsize=9,
    )
    axis.set_ylim(-0.02, 1.02)
    axis.grid(axis="y", color=GRID, linewidth=0.6)
    axis.set_axisbelow(True)
