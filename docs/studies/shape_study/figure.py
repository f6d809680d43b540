"""The figure of a study: outcomes against metrics, a dot for each partition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from agglo_core.draw.colours import PALETTE
from agglo_paper.figures import picture
from shape_study.ranks import Measured

_METRICS: Final = {
    "UF": "mean UF",
    "CR": "mean CR",
    "isoperimetric": "mean isoperimetric quotient",
    "J": "mean J",
    "compactness": "energy of k-means",
}
_COLUMNS: Final = 4


def draw(rows: Sequence[Measured], outcomes: Mapping[str, str], path: Path) -> None:
    """Outcomes by their labels, over the best of each mesh, in a row each; usual methods are filled."""
    known = rows[0].result["metrics"]
    metrics = [name for name in _METRICS if name in known and (name != "isoperimetric" or "CR" not in known)]
    metrics = metrics[:_COLUMNS]
    with picture((2.6 * len(metrics), 2.4 * len(outcomes)), path) as figure:
        panels = figure.subplots(len(outcomes), len(metrics), squeeze=False, sharex="col", sharey="row")
        for line, (label, outcome) in zip(panels, outcomes.items(), strict=True):
            for axis, metric in zip(line, metrics, strict=True):
                _dots(axis, rows, metric, outcome)
            line[0].set_ylabel(f"{label}, over the best", fontsize=7)
        for axis, metric in zip(panels[-1], metrics, strict=True):
            axis.set_xlabel(_METRICS[metric], fontsize=7)
        panels[0, 0].legend(fontsize=5)


def _dots(axis: Any, rows: Sequence[Measured], metric: str, outcome: str) -> None:
    for place, source in enumerate(dict.fromkeys(row.source for row in rows)):
        own = [row for row in rows if row.source == source]
        x = np.array([row.result["metrics"][metric] for row in own])
        y = np.array([row.outcome(outcome) for row in own])
        usual = np.array([row.usual for row in own])
        colour = PALETTE[place % len(PALETTE)]
        for chosen, face, label in ((usual, colour, source), (~usual, "none", None)):
            axis.scatter(
                x[chosen],
                y[chosen] / y.min(),
                s=14,
                facecolor=face,
                edgecolor=colour,
                linewidth=0.8,
                label=label,
            )
    axis.set_yscale("log")
    axis.tick_params(labelsize=6, which="both")
    axis.grid(color="#dddddd", linewidth=0.5)
    axis.set_axisbelow(True)
