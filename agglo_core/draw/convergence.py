"""Convergence pictures: residuals and energy errors against the iteration."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.draw.colours import GRID, INK, LINES
from agglo_core.draw.plot import save_figure
from agglo_core.errors import OptionError
from agglo_core.problems import Solution

MARKED = 40
"""Maximum number of iterations for markers on curves."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Convergence curves of a solver: residuals and energy errors for each iteration.

    Attributes
    ----------
    residuals : (iterations + 1,) float
        2-norms relative to the first, NaN where a logarithmic scale cannot show the value.
    errors : (iterations + 1,) float
        Estimates of the relative energy error. Some solvers report only the last, or none.
    contraction, tolerance : float, optional
    """

    residuals: Float
    errors: Float
    contraction: float | None
    tolerance: float | None

    @classmethod
    def of(cls, solution: Solution) -> Curves:
        """Return a solution's convergence curves."""
        return cls.made(
            solution.residuals,
            solution.energy_errors,
            solution.energy_error,
            solution.contraction,
            solution.tolerance,
        )

    @classmethod
    def made(
        cls,
        residuals: Any,
        errors: Any,
        last: float | None,
        contraction: float | None,
        tolerance: float | None,
    ) -> Curves:
        """Return convergence curves from report data, with ``last`` as the final energy error."""
        sizes, energy_errors = (
            np.asarray(values, dtype=np.float64).ravel() for values in (residuals, errors)
        )
        first = sizes[0] if len(sizes) and 0.0 < sizes[0] < np.inf else np.nan
        if len(energy_errors) != len(sizes):
            energy_errors = np.full(len(sizes), np.nan)
            energy_errors[-1:] = np.nan if last is None else last
        return cls(_positive(sizes / first), _positive(energy_errors), contraction, tolerance)


def _positive(values: Float) -> Float:
    return frozen_float(np.where((values > 0.0) & np.isfinite(values), values, np.nan))


def draw_convergence(
    solutions: Mapping[str, Solution], path: str | os.PathLike[str], title: str = ""
) -> None:
    """Draw residuals and energy errors by iteration on a logarithmic scale, and write the picture.

    Solid lines are ‖b − A x‖₂ relative to the first. Dashed lines are estimates of the relative energy error,
    if reported by the solver (direct and stationary solvers report only the final error). Dotted lines are
    the tolerance. The legend contains the mean contraction of the residual.

    Parameters
    ----------
    solutions : mapping of name to Solution
        At least one solution, by legend name.
    path : path
        File, with the format chosen by the suffix: .png, .pdf, .svg, …
    title : str
        Title above the picture.

    Raises
    ------
    OptionError
        Without matplotlib, or without solutions.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    if not solutions:
        raise OptionError("nothing to draw: give at least one solution")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error

    figure = Figure(figsize=(7.0, 4.4), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = figure.add_subplot()
    curves = {name: Curves.of(solution) for name, solution in solutions.items()}
    for place, (name, each) in enumerate(curves.items()):
        one_curve(axis, name, each, LINES[place % len(LINES)])
    frame_curves(axis, list(curves.values()))
    figure.legend(fontsize=8, frameon=False, loc="outside lower center", ncols=2)
    if title:
        axis.set_title(title, fontsize=10, color=INK)
    save_figure(figure, Path(path))


def frame_curves(axis: Any, curves: Sequence[Curves]) -> None:
    """Set scales, labels and grid of a convergence picture, with a dotted line for each tolerance."""
    from matplotlib.ticker import MaxNLocator

    axis.set_yscale("log")
    for tolerance in sorted({each.tolerance for each in curves if each.tolerance}):
        axis.axhline(tolerance, color=INK, linewidth=1.0, linestyle=":")
        axis.annotate(
            f"tolerance {tolerance:g}",
            (0.0, tolerance),
            xycoords=("axes fraction", "data"),
            xytext=(4, 3),
            textcoords="offset points",
            fontsize=8,
            color=INK,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        )
    axis.set_xlim(left=0)  # points on the frame are not clipped
    axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axis.set_xlabel("iteration")
    axis.set_ylabel("relative size")
    axis.grid(color=GRID, linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def one_curve(axis: Any, name: str, curves: Curves, colour: str = LINES[0]) -> None:
    """Draw residuals and energy errors of one solver, with ``name`` in the legend."""
    name = f"{name}: " if name else ""
    # Solid line: residuals.
    steps = np.arange(len(curves.residuals))
    size = 3.5 if len(steps) <= MARKED + 1 else 0.0
    fall = "" if curves.contraction is None else f", contraction {curves.contraction:.3g}"
    axis.plot(
        steps,
        curves.residuals,
        "o-",
        color=colour,
        markersize=size,
        linewidth=1.6,
        clip_on=False,
        label=f"{name}residual{fall}",
    )
    # Dashed line or single mark: energy errors.
    known = np.isfinite(curves.errors)
    if known.any():
        alone = known.sum() == 1
        axis.plot(
            steps,
            curves.errors,
            "s" if alone else "s--",
            color=colour,
            markersize=5.0 if alone else size,
            markerfacecolor="white",
            linewidth=1.3,
            clip_on=False,
            label=f"{name}energy error{' at the end' if alone else ''}, estimated",
        )
