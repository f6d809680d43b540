"""The paper's figures as SVG: agglomerated grids, box plots, the brain mesh, and run times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from agglo_core.authoring import AggloError, FileError, Float, Hierarchy, Mesh, OptionError, staging
from agglo_core.draw.colours import PALETTE, colouring
from agglo_paper.small_svg import compress_svg
from agglo_paper.tables.record import Cell
from agglo_paper.tables.runtime import KINDS, curves
from agglo_paper.tables.shapes import repeats, unit
from agglo_paper.work.grids import load, targets
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results
from agglo_paper.work.strategies import Strategy

_INK, _FINE, _PAPER = "#222222", "#8a8a8a", "#F4F1EA"
_DENSE = 2000
_ALSO = ("gnn", "kmeans", "spectral", "metis k-way")


def _shown_strategies(plan: Plan) -> list[Strategy]:
    """Return the methods shown in figures: the paper's and a few of agglo's."""
    return [each for each in plan.usable if each in plan.printed or each.name in _ALSO]


def draw_grids(plan: Plan, sources: Sequence[str], convention: str, path: Path) -> None:
    """Draw each mesh in its own row: unchanged, then agglomerated by each shown method."""
    # 1. Panel layout: a row per mesh, or two rows for a single mesh
    strategies = _shown_strategies(plan)
    n_columns = len(strategies) + 1 if len(sources) > 1 else (len(strategies) + 2) // 2
    n_rows = len(sources) if len(sources) > 1 else 2
    with picture((2.2 * n_columns, 2.45 * n_rows), path) as figure:
        panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
        # 2. Each mesh, then its agglomerations
        place = 0
        for source in sources:
            mesh = load(source)
            _panel(panels[place], mesh, None, f"{mesh.name}, {mesh.n_cells:,} cells")
            for strategy in strategies:
                place += 1
                _draw_agglomeration(panels[place], mesh, strategy, source, convention)
            place += 1
        for axis in panels[place:]:
            axis.set_axis_off()


def _draw_agglomeration(axis: Any, mesh: Mesh, strategy: Strategy, source: str, convention: str) -> None:
    try:
        hierarchy = strategy.run(mesh, targets(mesh, source, convention))
    except AggloError as error:
        axis.set_title(f"{strategy.name}: {error!s:.30}…", fontsize=7)
        axis.set_axis_off()
        return
    _panel(axis, mesh, hierarchy, f"{strategy.name}, {hierarchy.parts[0]} parts")


def _panel(axis: Any, mesh: Mesh, hierarchy: Hierarchy | None, title: str) -> None:
    dense = mesh.n_cells > _DENSE  # drawn as a bitmap inside the SVG
    if hierarchy is None:
        _fill(axis, mesh.coarsen(np.zeros(mesh.n_cells, np.int64)), [_PAPER], dense)
        _edges(axis, mesh, _FINE, 0.12 if dense else 0.4, dense)
    else:
        coarse = mesh.coarsen(hierarchy.levels[0])
        _fill(axis, coarse, PALETTE, dense)
        _edges(axis, coarse, _INK, 0.6, dense)
    used = mesh.local_points[mesh.face_vertices]
    axis.set_xlim(used[:, 0].min(), used[:, 0].max())
    axis.set_ylim(used[:, 1].min(), used[:, 1].max())
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=7, color=_INK)
    axis.set_axis_off()


def _fill(axis: Any, mesh: Mesh, palette: Sequence[str], rasterized: bool) -> None:
    """Fill the cells of a mesh with colours, as one path per colour."""
    loops = mesh.boundary_loops
    colours = colouring(mesh, len(palette)) if len(palette) > 1 else np.zeros(mesh.n_cells, np.int64)
    owner = np.repeat(colours, np.diff(loops.cell_offsets))
    closed = [np.append(each, each[0]) for each in np.split(loops.vertices, loops.loop_offsets[1:-1])]
    for colour, tone in enumerate(palette):
        mine = [mesh.local_points[loop] for loop, own in zip(closed, owner, strict=True) if own == colour]
        if mine:
            _path(axis, mine, rasterized, facecolor=tone, edgecolor="none", linewidth=0)


def _edges(axis: Any, mesh: Mesh, colour: str, width: float, rasterized: bool) -> None:
    segments = mesh.local_points[mesh.face_pairs]
    _path(axis, segments, rasterized, facecolor="none", edgecolor=colour, linewidth=width, capstyle="round")


def _path(axis: Any, lines: Iterable[Float], rasterized: bool, **style: Any) -> None:
    """Draw polylines ``(k, 2)`` as one path, with closed loops filled by the even-odd rule."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    corners = list(lines)
    codes = [np.full(len(each), Outline.LINETO, np.uint8) for each in corners]
    for each in codes:
        each[0] = Outline.MOVETO
    outline = Outline(np.concatenate(corners), np.concatenate(codes))
    axis.add_patch(PathPatch(outline, rasterized=rasterized, **style))


def draw_boxes(plan: Plan, results: Results, sources: Mapping[str, str], convention: str, path: Path) -> None:
    """Draw box plots of uniformity factor (above) and centred circle ratio (below), one column per mesh."""
    strategies = _shown_strategies(plan)
    with picture((0.4 * len(strategies) * len(sources) + 1.5, 5.0), path) as figure:
        panels = figure.subplots(2, len(sources), squeeze=False, sharey=True)
        for column, (name, source) in enumerate(sources.items()):
            for axis, metric in zip(panels[:, column], ("UF", "CRc"), strict=True):
                data = {s.name: _values(plan, results, s, source, convention, metric) for s in strategies}
                _boxes(axis, {label: values for label, values in data.items() if values})
                axis.set_title(f"{name}: {metric}", fontsize=8)


def _values(
    plan: Plan, results: Results, strategy: Strategy, source: str, convention: str, metric: str
) -> list[float]:
    """Return a metric's values for all agglomerates of the first repetition."""
    first = repeats(plan, strategy)[0]
    values: list[float] = results[unit(source, convention, strategy, first).key].get(metric, [])
    return values


def _boxes(axis: Any, values: Mapping[str, Sequence[float]]) -> None:
    artists = axis.boxplot(
        list(values.values()),
        widths=0.6,
        patch_artist=True,
        medianprops={"color": _INK, "linewidth": 1.2},
        flierprops={"marker": ".", "markersize": 2, "markeredgecolor": _FINE},
    )
    for box, tone in zip(artists["boxes"], PALETTE, strict=False):
        box.set_facecolor(tone)
    axis.set_xticks(range(1, len(values) + 1), list(values), rotation=60, ha="right", fontsize=6)
    axis.set_ylim(-0.02, 1.02)
    axis.tick_params(axis="y", labelsize=6)
    axis.grid(axis="y", color="#dddddd", linewidth=0.5)
    axis.set_axisbelow(True)


def draw_runtime(plan: Plan, results: Results, path: Path) -> None:
    """Plot CPU milliseconds over the cell count, in log scales: one bisection, full recursion."""
    curves_by_kind = {kind: curves(plan, results, kind) for kind in KINDS}
    names = dict.fromkeys(name for lines in curves_by_kind.values() for name in lines if "whole" not in name)
    styles = {name: (f"C{k % 10}", ("-", "--")[k // 10 % 2]) for k, name in enumerate(names)}
    with picture((11, 4.8), path) as figure:
        for axis, (kind, lines) in zip(figure.subplots(1, 2), curves_by_kind.items(), strict=True):
            for name in filter(lines.__contains__, names):
                _curve(axis, name, lines[name], *styles[name])
            axis.set(xscale="log", yscale="log", title=kind, xlabel="cells", ylabel="CPU ms, one thread")
            axis.grid(color="#dddddd", linewidth=0.5)
            axis.legend(fontsize=6, ncols=2)


def _curve(axis: Any, name: str, line: Sequence[tuple[int, Cell]], colour: str, style: str) -> None:
    """Plot a method's median time over the cell count, with a band from least to largest time."""
    at = [cells for cells, _ in line]
    median, low, high = ([getattr(c, what) or np.nan for _, c in line] for what in ("ours", "low", "high"))
    axis.plot(at, median, label=name, linewidth=1.1, color=colour, linestyle=style)
    axis.fill_between(at, low, high, color=colour, alpha=0.12, linewidth=0)


@contextmanager
def picture(size: tuple[float, float], path: Path) -> Iterator[Any]:
    """Context with an empty figure, written to ``path`` as SVG at its end, reproducibly to the byte."""
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'figures need matplotlib: pip install "agglo[plot]" ({error})') from error
    with rc_context({"svg.hashsalt": "agglo", "svg.fonttype": "none"}):
        figure = Figure(figsize=size, dpi=200)
        figure.set_layout_engine("constrained")
        FigureCanvasAgg(figure)
        yield figure
        try:
            with staging(path) as stage:
                drawn = BytesIO()
                figure.savefig(drawn, format="svg", metadata={"Date": None})
                (stage / path.name).write_text(compress_svg(drawn.getvalue().decode()), encoding="utf-8")
        except OSError as error:
            raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
