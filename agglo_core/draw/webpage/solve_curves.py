"""Convergence curves in the report, as SVG with x in percent of the width.

So texts keep their size on a page of any width.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from itertools import pairwise
from typing import Any, Final

import numpy as np

from agglo_core.arrays import Float
from agglo_core.draw.colours import LINES
from agglo_core.draw.convergence import MARKED, Curves

_HEIGHT, _TOP, _BOTTOM = 300, 10, 40  # height and margins in pixels
_LEFT, _RIGHT = 12.0, 98.0  # percent of the width
_MOST = 300  # maximum number of points per curve
_GRID, _AXIS = 'class="grid"', 'class="axis"'
"""CSS classes of lines, with colours in page.css."""
_CAPTION: Final = (
    "Values by iteration: ‖b − A x‖₂ relative to the first (solid), estimated relative "
    "error in the energy norm where available (dashed), tolerance (dotted)."
)


def history_picture(solves: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a plot of residuals and energy errors against the iteration, with legend, as SVG.

    Parameters
    ----------
    solves : mapping of str to mapping
        Data of :func:`agglo_core.solvers.solution_report.report`, at least one.
    """
    curves = {name: _curves(data) for name, data in solves.items()}
    frame = _Frame(list(curves.values()))
    inside = list(frame.axes())
    for place, curve in enumerate(curves.values()):
        colour = LINES[place % len(LINES)]
        inside += [*frame.curve(curve.errors, colour, dashed=True), *frame.curve(curve.residuals, colour)]
    label = "; ".join(f"{name}: {_describe_run(data)}" for name, data in solves.items())
    legend = "".join(
        f'<span><i style="color:{LINES[place % len(LINES)]}">●</i> '
        f"{escape(name + _contraction(curve))}</span>"
        for place, (name, curve) in enumerate(curves.items())
    )
    picture = f'<svg role="img" height="{_HEIGHT}" aria-label="{escape(label)}">{"".join(inside)}</svg>'
    return f"<figure>{picture}<figcaption>{legend}<br>{_CAPTION}</figcaption></figure>"


def _curves(data: Mapping[str, Any]) -> Curves:
    keys = ("residuals", "energy_errors", "energy_error", "contraction", "tolerance")
    return Curves.made(*(data[key] for key in keys))


def _describe_run(data: Mapping[str, Any]) -> str:
    return f"{data['iterations']} iterations to a relative residual of {data['relative_residual']:.1e}"


def _contraction(curves: Curves) -> str:
    return "" if curves.contraction is None else f", contraction {curves.contraction:.3g}"


class _Frame:
    """Axes of a convergence plot: iterations from left to right, powers of ten from top to bottom."""

    def __init__(self, curves: list[Curves]) -> None:
        sizes = np.concatenate([[1.0], *(np.append(curve.residuals, curve.errors) for curve in curves)])
        self.tolerances = sorted({curve.tolerance for curve in curves if curve.tolerance})
        powers = np.log10(np.append(sizes[np.isfinite(sizes)], self.tolerances))
        self.low, self.high = int(np.floor(powers.min() - 0.1)), max(int(np.ceil(powers.max())), 0)
        self.low = min(self.low, self.high - 1)
        self.last = max(1, *(len(curve.residuals) - 1 for curve in curves))

    def x(self, step: float) -> float:
        """Return the horizontal coordinate of an iteration, in percent of the width."""
        return _LEFT + (_RIGHT - _LEFT) * step / self.last

    def y(self, size: float) -> float:
        """Return the vertical coordinate of a residual or error, in pixels from the top."""
        share = (self.high - float(np.log10(size))) / (self.high - self.low)
        return _TOP + share * (_HEIGHT - _TOP - _BOTTOM)

    def axes(self) -> Iterator[str]:
        """Yield SVG elements for grid, ticks and tolerances."""
        for power in range(self.low, self.high + 1):
            y = self.y(10.0**power)
            yield _line(_LEFT, y, _RIGHT, y, _GRID)
            if (self.high - power) % (1 + (self.high - self.low) // 10) == 0:
                text = "1" if not power else f"1e{power}"
                yield f'<text x="{_LEFT - 1:.2f}%" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
        bottom = _HEIGHT - _BOTTOM
        step = next(each for each in _steps() if self.last <= 8 * each)
        for tick in range(0, self.last + 1, step):
            x = self.x(tick)
            yield f'<text x="{x:.2f}%" y="{bottom + 16}" text-anchor="middle">{tick}</text>'
            yield _line(x, bottom, x, bottom + 4, _AXIS)
        middle = (_LEFT + _RIGHT) / 2
        yield f'<text x="{middle}%" y="{bottom + 33}" text-anchor="middle">iteration</text>'
        yield _line(_LEFT, bottom, _RIGHT, bottom, _AXIS) + _line(_LEFT, _TOP, _LEFT, bottom, _AXIS)
        for tolerance in self.tolerances:
            y = self.y(tolerance)
            yield _line(_LEFT, y, _RIGHT, y, 'class="ink" stroke-dasharray="1 3"')
            yield f'<text x="{_LEFT + 1:.2f}%" y="{y - 4:.1f}">tolerance {tolerance:g}</text>'

    def curve(self, sizes: Float, colour: str, dashed: bool = False) -> Iterator[str]:
        """Yield the SVG elements for a curve through its finite values, with marks if there are few."""
        steps = np.flatnonzero(np.isfinite(sizes))
        if len(steps) > _MOST:
            steps = steps[np.unique(np.linspace(0, len(steps) - 1, _MOST).astype(int))]
        places = [(self.x(float(step)), self.y(float(sizes[step]))) for step in steps]
        style = f'class="curve" stroke="{colour}" stroke-width="{1.5 if dashed else 2}"'
        style += ' stroke-dasharray="5 4"' if dashed else ""
        for start, end in pairwise(places):
            yield _line(*start, *end, style)
        fill = "#fff" if dashed else colour
        for x, y in places if self.last <= MARKED else ():
            yield f'<circle cx="{x:.2f}%" cy="{y:.1f}" r="3" class="curve" fill="{fill}" stroke="{colour}"/>'


def _steps() -> Iterator[int]:
    """Yield the possible distances between ticks: 1, 2, 5, 10, 20, 50, …"""
    power = 1
    while True:
        yield from (power, 2 * power, 5 * power)
        power *= 10


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return f'<line x1="{x1:.2f}%" y1="{y1:.1f}" x2="{x2:.2f}%" y2="{y2:.1f}" {look}/>'
