"""Report section on the trade-offs between runs: a scatter plot as SVG without script."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Final

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.draw.label_places import label_places, stair_boxes, ties
from agglo_core.draw.pareto import BEST, FRONT, reach, sense, stairs
from agglo_core.draw.plot import short_name
from agglo_core.measure.comparison import RunResult
from agglo_core.measure.trade_offs import Axis, TradeOffs, trade_offs
from agglo_core.mesh import Mesh

_LEFT, _TOP, _WIDTH, _HEIGHT = 72.0, 14.0, 660.0, 400.0  # plot area in pixels
_LETTER, _LINE, _GAP = 6.4, 14.0, 6.0
"""Space per letter, per line (11 pixels, widest page font), and around dots."""
_COLOURS: Final = ((253, 231, 37), (93, 201, 99), (33, 145, 140), (59, 82, 139), (68, 1, 84))
"""Steps of matplotlib's viridis, from fast to slow."""
_SWATCHES: Final = 5  # colours in the legend


class ParetoSection:
    """Scatter plot of runs by roundness, evenness and computing time, with the Pareto front."""

    title = "Round, even, fast"

    def html(self, mesh: Mesh, runs: Sequence[RunResult]) -> str:
        """Return the scatter plot of all successful runs as HTML, or an empty text for a single run."""
        if len(runs) < 2 or not any(run.levels for run in runs):
            return ""
        tradeoffs = trade_offs(runs)
        missing = f" Not shown: {', '.join(tradeoffs.missing)}." if tradeoffs.missing else ""
        lines = f"Grey line, the front: {FRONT}. {_upper(BEST)}."
        words = f"The finest levels. Up and to the right is better. {lines}{missing}"
        return (
            f'<figure><div class="scroll">{_picture(tradeoffs)}</div>'
            f"<figcaption>{_legend(tradeoffs)}<br>{escape(words)}</figcaption></figure>"
        )


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def _picture(tradeoffs: TradeOffs) -> str:
    size = f'viewBox="0 0 {_LEFT + _WIDTH + 12:g} {_TOP + _HEIGHT + 50:g}"'
    label = "; ".join(
        f"{name}: {tradeoffs.roundness.label} {round_:.3f}, {tradeoffs.evenness.label} {even:.3f}, "
        f"{seconds:.2g} CPU s"
        for name, round_, even, seconds in zip(
            tradeoffs.labels,
            tradeoffs.roundness.values,
            tradeoffs.evenness.values,
            tradeoffs.seconds,
            strict=True,
        )
    )
    inside = "".join([*_axes(tradeoffs), *_dots(tradeoffs)])
    return f'<svg role="img" {size} aria-label="{escape(label)}">{inside}</svg>'


def _places(tradeoffs: TradeOffs, data: Float) -> Float:
    """Return picture coordinates ``(n, 2)`` for pairs of evenness and roundness, from the lower left."""
    shares = []
    for axis, values in zip((tradeoffs.evenness, tradeoffs.roundness), data.T, strict=True):
        worse, better = reach(axis)
        shares.append((values - worse) / (better - worse))
    return frozen_float(np.stack(shares, axis=1) * [_WIDTH, _HEIGHT])


def _axes(tradeoffs: TradeOffs) -> Iterator[str]:
    bottom = _TOP + _HEIGHT
    for value, share in _ticks(tradeoffs.evenness):
        x = _LEFT + share * _WIDTH
        yield _line(x, _TOP, x, bottom, "grid") + _text(x, bottom + 16, value, "middle")
    for value, share in _ticks(tradeoffs.roundness):
        y = bottom - share * _HEIGHT
        yield _line(_LEFT, y, _LEFT + _WIDTH, y, "grid") + _text(_LEFT - 6, y + 4, value, "end")
    yield _line(_LEFT, bottom, _LEFT + _WIDTH, bottom, "axis") + _line(_LEFT, _TOP, _LEFT, bottom, "axis")
    yield _text(_LEFT + _WIDTH / 2, bottom + 36, f"{sense(tradeoffs.evenness)} →", "middle")
    middle = f"{_TOP + _HEIGHT / 2:.1f}"
    turned = f'transform="rotate(-90 14 {middle})" text-anchor="middle"'
    yield f'<text x="14" y="{middle}" {turned}>{escape(sense(tradeoffs.roundness))} →</text>'
    corners = _places(tradeoffs, stairs(tradeoffs)) * [1, -1] + [_LEFT, bottom]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    yield f'<polyline points="{points}" class="front" stroke-width="1.5"/>'


def _ticks(axis: Axis) -> Iterator[tuple[str, float]]:
    """Yield the round numbers within the limits of an axis, with their relative coordinates."""
    worse, better = reach(axis)
    span = abs(better - worse)
    power = 10.0 ** np.floor(np.log10(span / 4))
    step = next(power * each for each in (1, 2, 5, 10) if span / (power * each) <= 7)
    digits = max(0, -int(np.floor(np.log10(step))))
    for number in range(int(np.ceil(min(worse, better) / step)), int(max(worse, better) / step) + 1):
        yield f"{number * step:.{digits}f}", (number * step - worse) / (better - worse)


def _dots(tradeoffs: TradeOffs) -> Iterator[str]:
    bottom, names = _TOP + _HEIGHT, [short_name(run) for run in tradeoffs.labels]
    dots = _places(tradeoffs, np.stack([tradeoffs.evenness.values, tradeoffs.roundness.values], axis=1))
    sizes = np.array([(_LETTER * len(name), _LINE) for name in names])
    avoided = stair_boxes(_places(tradeoffs, stairs(tradeoffs)), 2.0)
    places = label_places(dots, sizes, np.array([_WIDTH, _HEIGHT]), _GAP, avoided)
    for label, (x, y) in ties(dots, sizes, places, _GAP).items():
        yield _line(_LEFT + dots[label, 0], bottom - dots[label, 1], _LEFT + x, bottom - y, "axis")
    for (x, y), fill, best in zip(dots, _fills(tradeoffs.seconds), tradeoffs.best, strict=True):
        ring = f'class="ink" stroke-width="{2.5 if best else 0.7}"'
        yield f'<circle cx="{_LEFT + x:.1f}" cy="{bottom - y:.1f}" r="5" fill="{fill}" {ring}/>'
    for (x, y), (width, _), dot, name in zip(places, sizes, dots, names, strict=True):
        left = x + width / 2 < dot[0]  # the end near the dot is fixed, whatever the letter width
        x, anchor = (x + width, "end") if left else (x, "start")
        yield _text(_LEFT + x, bottom - y - 3, name, anchor, 'class="name"')


def _fills(seconds: Float) -> list[str]:
    """Return a colour for each time, on a logarithmic scale from shortest to longest."""
    logs = np.log(seconds)
    shares = (logs - logs.min()) / (np.ptp(logs) or 1.0) * (len(_COLOURS) - 1)
    steps = np.arange(len(_COLOURS))
    mixed = [np.interp(shares, steps, channel) for channel in np.array(_COLOURS, dtype=float).T]
    return [f"#{round(r):02x}{round(g):02x}{round(b):02x}" for r, g, b in zip(*mixed, strict=True)]


def _legend(tradeoffs: TradeOffs) -> str:
    low, high = float(tradeoffs.seconds.min()), float(tradeoffs.seconds.max())
    times = np.geomspace(low, high, _SWATCHES if high > 1.5 * low else 1)
    pairs = zip(_fills(times), times, strict=True)
    return "".join(f'<span><i style="color:{fill}">●</i> {time:.2g} CPU s</span>' for fill, time in pairs)


def _text(x: float, y: float, text: str, anchor: str, more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {more}>{escape(text)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" class="{kind}"/>'
