"""HTML display in notebooks: picture and table of a mesh, hierarchy, quality or solution."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.draw.colours import PALETTE
from agglo_core.draw.convergence import Curves, frame_curves, one_curve
from agglo_core.draw.plot import panels_of
from agglo_core.errors import AggloError
from agglo_core.mesh import Mesh
from agglo_core.problems import Solution

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_DPI = 125  # 100 pixels per inch on screen
_SHARES = (1.0, 0.8, 0.64, 0.5)
"""Scales to try until the picture file is small enough."""
_BYTES = 40_000  # maximum size of a picture file
_COLOURS = 64  # palette size of a picture


def inline_picture(
    draw: Sequence[Callable[[Any], None]], about: str, *, width: float, ratio: float
) -> tuple[str, str]:
    """Return an HTML image with panels side by side, or the reason why there is none.

    Parameters
    ----------
    draw : sequence of callables
        Functions that draw a panel on given axes. Without functions there is no picture.
    about : str
        Alternative text.
    width, ratio : float
        Panel width in inches, and ratio of height to width.

    Returns
    -------
    str, str
        The element, below 60 kB, and ``""``, or ``""`` and the reason (missing matplotlib).
    """
    if not draw:
        return "", ""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return "", 'pictures need matplotlib: pip install "agglo[plot]"'
    figure = Figure(figsize=(width * len(draw), width * ratio + 0.2), dpi=_DPI, layout="constrained")
    for place, each in enumerate(draw):
        each(figure.add_subplot(1, len(draw), 1 + place))
    picture = _png(figure)
    source = b64encode(picture).decode()
    shown = round(100 * width * len(draw))
    element = f'<img alt="{escape(about)}" width="{shown}" src="data:image/png;base64,{source}">'
    return element, ""


def _png(figure: Any) -> bytes:
    """Return a figure as a PNG file with few colours (a third of the size), reduced if still too large."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    for share in _SHARES:
        pixels = (
            image if share == 1.0 else image.resize((int(share * image.width), int(share * image.height)))
        )
        file = BytesIO()
        pixels.quantize(_COLOURS).save(file, "png", optimize=True)
        if file.tell() <= _BYTES:
            break
    return file.getvalue()


_MOST = 50_000
"""Maximum number of cells for a picture, as notebooks should not wait."""
_LISTED = 8
"""Maximum number of table rows for tags, repairs, levels and metrics."""
_PANELS = 3  # half the maximum number of histograms


def mesh_html(mesh: Mesh) -> str:
    """Return picture and table of a mesh as HTML."""
    low, high = (end(mesh.points[mesh.face_vertices], axis=0) for end in (np.min, np.max))
    rows = [
        ("cells", f"{mesh.n_cells:,}"),
        ("faces", f"{mesh.n_faces:,}"),
        ("points", f"{mesh.n_points:,}"),
        ("extent", " × ".join(f"{size:.4g}" for size in high - low)),
        *(_tag("cell tag", name, tags) for name, tags in _first(mesh.cell_tags)),
        *(_tag("face tag", name, tags) for name, tags in _first(mesh.face_tags)),
        *((what, f"{count:,}") for what, count in _first(mesh.repairs)),
    ]
    title = f"Mesh {mesh.name!r}" if mesh.name else "Mesh"
    table = _table(("", ""), rows)
    picture, note = _draw_picture(mesh, "mesh.plot()", [lambda axis, panels: panels.fine(axis)])
    return _page(f"{title}, {mesh.dim}-D", picture, table, note)


def hierarchy_html(hierarchy: Hierarchy) -> str:
    """Return picture and table of the levels of a hierarchy as HTML."""
    n, part_counts = hierarchy.graph.n, hierarchy.parts[:_LISTED]
    rows = [
        (str(level), f"{parts:,}", f"{n / parts:,.1f}", _target(hierarchy.targets[level]))
        for level, parts in enumerate(part_counts)
    ]
    nested = "nested" if hierarchy.nested else "not nested"
    title = f"Hierarchy of {n:,} cells, {nested}"
    table = _table(("level", "parts", "cells per part", "target"), rows)
    n_omitted = len(hierarchy.parts) - len(part_counts)
    remark = f"{n_omitted} more levels" if n_omitted else ""
    if hierarchy.fine is None:
        return _page(title, "", table, "; ".join(filter(None, (remark, "of a graph: nothing to draw"))))
    at = _spread(len(hierarchy.levels))
    picture, note = _draw_picture(
        hierarchy.fine, "hierarchy.plot(level)", [_panel(hierarchy, level) for level in at]
    )
    return _page(title, picture, table, "; ".join(filter(None, (remark, note))))


def quality_html(values: Mapping[str, Float]) -> str:
    """Return means, extrema and histograms of metrics on agglomerates as HTML."""
    count = len(next(iter(values.values()), ()))
    rows, finite_values = [], {}
    for name, column in _first(values):
        finite = column[np.isfinite(column)]
        numbers = [f"{float(end(finite)):.4g}" if len(finite) else "–" for end in (np.mean, np.min, np.max)]
        rows.append((name, *numbers, f"{len(column) - len(finite):,}" if len(finite) < len(column) else ""))
        if len(finite):
            finite_values[name] = finite
    head = ("metric", "mean", "least", "largest", "undefined")
    stop = None if any(row[-1] for row in rows) else -1
    table = _table(head[:stop], [row[:stop] for row in rows])
    remark = f"{len(values) - len(rows)} more metrics" if len(values) > len(rows) else ""
    bars = [_histogram(name, finite) for name, finite in list(finite_values.items())[: 2 * _PANELS]]
    picture, missing = inline_picture(bars, "histograms of the values", width=1.5, ratio=0.8)
    return _page(f"Quality of {count:,} agglomerates", picture, table, remark or missing)


def solution_html(solution: Solution) -> str:
    """Return the outcome, cost and residuals of a solver as HTML."""
    first, last = solution.residuals[[0, -1]] if len(solution.residuals) else (np.nan, np.nan)
    cpu = solution.cpu_seconds
    clock, spent_by_phase = ("CPU seconds", cpu) if cpu else ("seconds", solution.seconds)
    entries: Mapping[str, Any] = {
        "unknowns": f"{solution.x.shape[0]:,}",
        "iterations": f"{solution.iterations:,}",
        "residual over the first": f"{last / first:.2e}" if first > 0.0 else "",
        "contraction": _number(solution.contraction),
        "energy error, estimated": _number(solution.energy_error),
        "operator complexity": _number(solution.operator_complexity),
        **{f"{clock}: {phase}": f"{spent:.3g}" for phase, spent in _first(spent_by_phase)},
    }
    table = _table(("", ""), [(name, text) for name, text in entries.items() if text])

    def convergence(axis: Any) -> None:
        curves = Curves.of(solution)
        one_curve(axis, "", curves)
        frame_curves(axis, [curves])
        axis.tick_params(labelsize=7)
        axis.legend(fontsize=6, frameon=False)

    has_history = len(solution.residuals) > 1
    picture, missing = inline_picture([convergence] if has_history else [], "residuals", width=3.4, ratio=0.7)
    notes = filter(None, (solution.choice, solution.advice, missing))
    return _page(f"Solution, {solution.outcome}: {solution.reason}", picture, table, "; ".join(notes))


def _draw_picture(mesh: Mesh, instead: str, draw: Sequence[Callable[[Any, Any], None]]) -> tuple[str, str]:
    """Return a picture of a mesh or its levels as HTML, or the reason why there is none."""
    if mesh.n_cells > _MOST:
        return "", f"{mesh.n_cells:,} cells: no automatic picture above {_MOST:,}; {instead} draws one"
    if not draw:
        return "", ""
    panels = panels_of(mesh)
    ratio = float(np.clip(panels.ratio, 0.15, 2.0))

    def without_frame(draw_panel: Callable[[Any, Any], None]) -> Callable[[Any], None]:
        def draw_on(axis: Any) -> None:
            draw_panel(axis, panels)
            axis.set_axis_off()

        return draw_on

    width = 2.6 if len(draw) == 1 else 2.0
    try:
        return inline_picture(
            [without_frame(draw_panel) for draw_panel in draw], repr(mesh), width=width, ratio=ratio
        )
    except AggloError as error:  # automatic display must not raise
        return "", f"no picture: {error}"


def _panel(hierarchy: Hierarchy, level: int) -> Callable[[Any, Any], None]:
    def on(axis: Any, panels: Any) -> None:
        panels.level(axis, hierarchy.levels[level])
        axis.set_title(f"level {level}", fontsize=8)

    return on


def _histogram(name: str, values: Float) -> Callable[[Any], None]:
    def on(axis: Any) -> None:
        axis.hist(values, bins=20, color=PALETTE[0])
        axis.set_title(name, fontsize=8, parse_math=False)
        axis.set_yticks([])
        axis.tick_params(labelsize=6)
        axis.spines[["top", "right", "left"]].set_visible(False)

    return on


def _spread(count: int) -> list[int]:
    """Return the indices of at most three of ``count`` levels: first, middle, last."""
    return sorted({0, count // 2, count - 1}) if count else []


def _first(items: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return list(items.items())[:_LISTED]


def _tag(what: str, name: str, tags: Any) -> tuple[str, str]:
    count = len(np.unique(tags))
    return f"{what} {name!r}", f"{count:,} value{'s' if count != 1 else ''}"


def _target(target: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} = {value:.4g}" if isinstance(value, float) else f"{name} = {value}"
        for name, value in target.items()
        if value is not None
    )


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["<table>"]
    if any(head):
        lines.append(f"<thead><tr>{''.join(f'<th>{escape(each)}</th>' for each in head)}</tr></thead>")
    lines += [f"<tr>{''.join(f'<td>{escape(each)}</td>' for each in row)}</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])


def _page(title: str, picture: str, table: str, note: str = "") -> str:
    below = f"<small>{escape(note)}</small>" if note else ""
    return (
        f'<div><b>{escape(title)}</b><div style="display: flex; flex-wrap: wrap; gap: 1em; '
        f'align-items: flex-start">{picture}{table}</div>{below}</div>'
    )
