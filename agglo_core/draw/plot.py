"""Pictures: the fine mesh and the levels of one or more runs, side by side."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Int
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.measure.agglomerates import Level, measure_levels
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, part, phase

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.selection import Metric
    from agglo_core.registry import Registry

__all__ = ["PALETTE", "colouring", "draw", "save_figure", "short_name"]

PALETTE = (  # Paul Tol's "light" scheme, safe for colour-blind readers, and two more
    "#77AADD",
    "#EE8866",
    "#EEDD88",
    "#99DDFF",
    "#FFAABB",
    "#44BB99",
    "#C9A6DD",
    "#BBCC33",
    "#B5DBA4",
)
_INK, _FINE, _PAPER = "#222222", "#777777", "#F4F1EA"
_DPI = 160
_IN_TITLES = ("UF", "CR")
_DENSE = 20_000
"""Fine edges inside agglomerates are drawn up to this many cells."""


def draw(
    mesh: Mesh,
    hierarchies: Mapping[str, Hierarchy],
    path: str | os.PathLike[str],
    metrics: Iterable[Metric] | None = None,
    registry: Registry | None = None,
    progress: Listener | None = None,
) -> None:
    """Draw the fine mesh and every level, one row per run, and write the picture.

    Neighbouring agglomerates differ in colour; titles give the number of parts and the means of the
    metrics, UF and CR by default. Nothing is left behind if the picture cannot be written.

    Parameters
    ----------
    mesh : Mesh
        2-D.
    hierarchies : mapping of run name to Hierarchy
        At least one.
    path : path
        The suffix chooses the format: .png, .pdf, .svg, …
    metrics, registry, progress : optional
        As for :func:`agglo_core.measure.measure_levels`.

    Raises
    ------
    MeshError
        For a 3-D mesh.
    OptionError
        Without matplotlib, or with no run to draw.
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    if mesh.dim != 2:
        raise MeshError(f"pictures exist only for 2-D meshes; {mesh.name or 'this one'} is {mesh.dim}-D")
    if not hierarchies:
        raise OptionError("nothing to draw: no hierarchy is given")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error

    wanted = _IN_TITLES if metrics is None else list(metrics)
    columns = 1 + max(len(hierarchy.levels) for hierarchy in hierarchies.values())
    width = float(np.clip(24.0 / columns, 2.4, 3.6))
    extent = np.ptp(mesh.points[mesh.face_vertices], axis=0)
    height = width * float(np.clip(extent[1] / extent[0], 0.15, 2.0)) + 0.55
    figure = Figure(figsize=(columns * width, len(hierarchies) * height), dpi=_DPI)
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08)
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(hierarchies), columns, squeeze=False)
    with phase(progress, "drawing") as tell:
        for place, (row, (name, hierarchy)) in enumerate(zip(axes, hierarchies.items(), strict=True)):
            own = part(tell, place, 1 + len(hierarchies), name)
            _draw_fine(row[0], mesh, name)
            measured = measure_levels(mesh, hierarchy, registry, wanted)
            for number, (axis, level) in enumerate(zip(row[1:], measured, strict=False)):
                part(own, 1 + number, columns, f"level {number}")
                _draw_level(axis, mesh, level.labels, _title(level))
            for axis in row[1 + len(hierarchy.levels) :]:
                axis.set_axis_off()
        part(tell, len(hierarchies), 1 + len(hierarchies), Path(path).name)
        save_figure(figure, Path(path))


def colouring(mesh: Mesh, n_colours: int) -> Int:
    """Colour of each cell ``(n_cells,)``, different from its neighbours' wherever a colour is left.

    Rounds of greedy colouring (Jones and Plassmann): in each, the cells that precede all their
    uncoloured neighbours take a free colour. Cells of many neighbours come first.
    """
    graph = mesh.graph
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    shuffled = np.random.default_rng(0).permutation(graph.n)
    rank = np.empty(graph.n, np.int64)
    rank[np.lexsort((shuffled, np.diff(graph.indptr)))] = np.arange(graph.n)
    colours = np.full(graph.n, -1, np.int64)
    taken = np.zeros((graph.n, n_colours), bool)
    while (colours < 0).any():
        ready = colours < 0
        ready[rows[(colours[graph.indices] < 0) & (rank[graph.indices] > rank[rows])]] = False
        chosen = np.flatnonzero(ready)
        wish = (shuffled[chosen, None] + np.arange(n_colours)) % n_colours  # all colours in equal share
        pick = (~taken[chosen[:, None], wish]).argmax(axis=1)
        colours[chosen] = wish[np.arange(len(chosen)), pick]
        told = ready[graph.indices]
        taken[rows[told], colours[graph.indices[told]]] = True
    return colours


def _draw_fine(axis: Any, mesh: Mesh, name: str) -> None:
    whole = mesh.coarsen(np.zeros(mesh.n_cells, np.int64))
    _fill(axis, whole, np.zeros(1, np.int64), (_PAPER,))
    _edges(axis, mesh, _FINE, _line_width(axis, mesh.n_cells, 0.6))
    _edges(axis, whole, _INK, 0.9)
    _frame(axis, mesh, f"{short_name(name)}\n{short_name(mesh.name or 'mesh', 40)}, {mesh.n_cells:,} cells")


def _draw_level(axis: Any, mesh: Mesh, labels: Int, title: str) -> None:
    coarse = mesh.coarsen(labels)
    _fill(axis, coarse, colouring(coarse, len(PALETTE)), PALETTE)
    if mesh.n_cells <= _DENSE:
        _edges(axis, mesh, _FINE, 0.5 * _line_width(axis, mesh.n_cells, 0.6), alpha=0.35)
    _edges(axis, coarse, _INK, _line_width(axis, coarse.n_cells, 1.1))
    _frame(axis, mesh, title)


def _fill(axis: Any, mesh: Mesh, colours: Int, palette: tuple[str, ...]) -> None:
    """Fill the cells: one path for all cells of a colour, whatever their number; holes stay open."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    loops = mesh.boundary_loops
    starts, stops = loops.loop_offsets[:-1], loops.loop_offsets[1:]
    vertices = np.insert(loops.vertices, stops, loops.vertices[starts])
    number = np.arange(len(starts))
    codes = np.full(len(vertices), Outline.LINETO, np.uint8)
    codes[starts + number] = Outline.MOVETO
    codes[stops + number] = Outline.CLOSEPOLY
    colour = np.repeat(np.repeat(colours, np.diff(loops.cell_offsets)), stops - starts + 1)
    for k, tone in enumerate(palette):
        mine = colour == k
        if mine.any():
            outline = Outline(mesh.local_points[vertices[mine]], codes[mine])
            # not add_patch: it walks every edge in Python to find limits, which _frame sets
            axis.add_artist(PathPatch(outline, facecolor=tone, edgecolor="none", linewidth=0))


def _edges(axis: Any, mesh: Mesh, colour: str, width: float, alpha: float = 1.0) -> None:
    from matplotlib.collections import LineCollection

    if width > 0:
        segments: Any = mesh.local_points[mesh.face_pairs]
        lines = LineCollection(segments, colors=colour, linewidths=width, alpha=alpha, capstyle="round")
        axis.add_collection(lines, autolim=False)


def _line_width(axis: Any, n_cells: int, most: float) -> float:
    """Width in points that leaves cells visible; 0 where they are hardly larger than a dot."""
    inches = axis.figure.get_figwidth() / axis.get_gridspec().ncols
    cell = 72.0 * inches / np.sqrt(n_cells)
    return 0.0 if cell < 0.7 else float(min(most, 0.08 * cell + 0.05))


def _frame(axis: Any, mesh: Mesh, title: str) -> None:
    used = mesh.local_points[mesh.face_vertices]
    low, high = used.min(axis=0), used.max(axis=0)
    margin = 0.01 * float((high - low).max())
    axis.set_xlim(low[0] - margin, high[0] + margin)
    axis.set_ylim(low[1] - margin, high[1] + margin)
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=8, color=_INK)
    axis.set_axis_off()


def short_name(text: str, most: int = 34) -> str:
    """Return at most ``most`` characters, the middle left out: titles must not run into each other."""
    return text if len(text) <= most else f"{text[: most // 2]}…{text[-(most // 2 - 1) :]}"


def _title(level: Level) -> str:
    line = level.line
    parts = f"{line['parts']:,} part{'s' if line['parts'] != 1 else ''}"
    target = line["target"]
    if "h_star" in target:
        factor = f" ({target['h_factor']:.3g} h0)" if target.get("h_factor") else ""
        parts = f"h* = {target['h_star']:.3g}{factor}: {parts}"
    means = {name: line[name] for name in level.metrics} | dict(level.objectives)
    missing = level.undefined
    shown = [
        f"{name} {_number(value)}" + (f" ({missing[name]} undefined)" if name in missing else "")
        for name, value in means.items()
    ]
    rows = ["   ".join(shown[start : start + 3]) for start in range(0, len(shown), 3)]
    return "\n".join([parts, *rows])


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}" if 0.0 <= value < 10.0 else f"{value:.3g}"


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure whole or not at all; the suffix chooses the format.

    Raises
    ------
    FileError
        If the file cannot be written, or its suffix is unknown.
    """
    from agglo_core.io.atomic import staging

    kind, kinds = path.suffix[1:].lower(), figure.canvas.get_supported_filetypes()
    if kind not in kinds:
        raise FileError(f"{path}: no picture format {path.suffix!r}; there are {', '.join(sorted(kinds))}")
    try:
        with staging(path) as folder:
            figure.savefig(folder / path.name, format=kind, dpi=_DPI)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
