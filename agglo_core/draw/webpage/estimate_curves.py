"""Report section on an adaptation: estimated errors against unknowns, as SVG in percent of the width."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import pairwise
from typing import Final

import numpy as np

from agglo_core.draw.colours import LINES

_HEIGHT, _TOP, _BOTTOM = 300, 10, 40  # height and margins in pixels
_LEFT, _RIGHT = 12.0, 98.0  # percent of the width
_CAPTION: Final = (
    "Estimated error against the number of unknowns. The adapted mesh below has the colour estimate."
)

Curve = Sequence[tuple[int, float]]
"""Numbers of unknowns with estimates."""


def estimate_section(curves: Mapping[str, Curve]) -> str:
    """Return the report section with estimates against unknowns by name, or an empty text for none."""
    points = [point for curve in curves.values() for point in curve if point[1] > 0.0]
    if not points:
        return ""
    frame = _Frame(points)
    inside, legend = list(frame.axes()), ""
    for colour, (name, curve) in zip(LINES, curves.items(), strict=False):
        inside += frame.curve([point for point in curve if point[1] > 0.0], colour)
        legend += f'<span><i style="color:{colour}">●</i> {escape(name)}</span>'
    label = escape("; ".join(f"{name}: {curve[-1][1]:.2e} at the end" for name, curve in curves.items()))
    picture = f'<svg role="img" height="{_HEIGHT}" aria-label="{label}">{"".join(inside)}</svg>'
    figure = f"<figure>{picture}<figcaption>{legend}<br>{_CAPTION}</figcaption></figure>"
    title = '<h2 id="estimate-title">Estimates</h2>'
    return f'<section class="solve" aria-labelledby="estimate-title">\n{title}\n{figure}\n</section>\n'


class _Frame:
    """Axes of a plot with logarithmic scales."""

    def __init__(self, points: Curve) -> None:
        logs = np.log10(np.array(points, float))
        self.low, self.high = logs.min(axis=0) - 0.05, logs.max(axis=0) + 0.05

    def place(self, unknowns: float, estimate: float) -> tuple[float, float]:
        """Return the coordinates of a point: in percent of the width, and in pixels from the top."""
        shares = (np.log10([unknowns, estimate]) - self.low) / (self.high - self.low)
        x, y = _LEFT + (_RIGHT - _LEFT) * shares[0], _TOP + (1.0 - shares[1]) * (_HEIGHT - _TOP - _BOTTOM)
        return float(x), float(y)

    def axes(self) -> Iterator[str]:
        """Yield SVG elements for grid, ticks and labels."""
        bottom = _HEIGHT - _BOTTOM
        for tick in self.ticks(0):
            x, _ = self.place(tick, 1.0)
            yield f'<text x="{x:.2f}%" y="{bottom + 16}" text-anchor="middle">{tick:,.0f}</text>'
            yield _line(x, _TOP, x, bottom, 'class="grid"')
        for tick in self.ticks(1):
            _, y = self.place(1.0, tick)
            yield f'<text x="{_LEFT - 1:.2f}%" y="{y + 4:.1f}" text-anchor="end">{tick:.3g}</text>'
            yield _line(_LEFT, y, _RIGHT, y, 'class="grid"')
        middle = (_LEFT + _RIGHT) / 2
        yield f'<text x="{middle}%" y="{bottom + 33}" text-anchor="middle">unknowns</text>'
        look = 'class="axis"'
        yield _line(_LEFT, bottom, _RIGHT, bottom, look) + _line(_LEFT, _TOP, _LEFT, bottom, look)

    def ticks(self, axis: int) -> list[float]:
        """Return the numbers 1, 2, 5, 10, 20, … on an axis, or powers of ten on a long one."""
        low, high = self.low[axis], self.high[axis]
        steps = (1.0, 2.0, 5.0) if high - low < 3.0 else (1.0,)
        powers = range(int(np.floor(low)), int(np.ceil(high)) + 1)
        return [s * 10.0**p for p in powers for s in steps if low <= np.log10(s) + p <= high]

    def curve(self, points: Curve, colour: str) -> list[str]:
        """Return the SVG elements for a curve with a mark at each point."""
        places = [self.place(*point) for point in points]
        look = f'class="curve" stroke="{colour}" stroke-width="2"'
        marks = (f'<circle cx="{x:.2f}%" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in places)
        return [*(_line(*start, *end, look) for start, end in pairwise(places)), *marks]


def _line(x1: float, y1: float, x2: float, y2: float, look: str) -> str:
    return f'<line x1="{x1:.2f}%" y1="{y1:.1f}" x2="{x2:.2f}%" y2="{y2:.1f}" {look}/>'
