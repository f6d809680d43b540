"""The figure of the study: outcomes against metrics, a dot for each partition."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from agglo_core.authoring import PALETTE
from agglo_paper.figures import picture
from agglo_paper.study.ranks import Measured

__all__ = ["draw"]

_METRICS: Final = {"UF": "mean UF", "CR": "mean CR", "J": "mean J", "compactness": "energy of k-means"}


def draw(rows: Sequence[Measured], degree: int, path: Path) -> None:
    """Iterations (above) and L2 errors (below), over the best of each mesh; usual methods are filled."""
    outcomes = {
        "iterations, patches": f"patches κ = 1 p{degree}",
        "iterations, the paper's": f"paper κ = 1 p{degree}",
        f"L2 error, p = {degree}": f"L2 p{degree}",
    }
    with picture((2.6 * len(_METRICS), 2.4 * len(outcomes)), path) as figure:
        panels = figure.subplots(len(outcomes), len(_METRICS), squeeze=False, sharex="col", sharey="row")
        for line, (label, outcome) in zip(panels, outcomes.items(), strict=True):
            for axis, metric in zip(line, _METRICS, strict=True):
                _dots(axis, rows, metric, outcome)
            line[0].set_ylabel(f"{label}, over the best", fontsize=7)
        for axis, metric in zip(panels[-1], _METRICS, strict=True):
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
