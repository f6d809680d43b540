"""Pictures of the fine mesh and the levels of one or more runs, side by side."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.draw.colours import INK, PALETTE, colouring
from agglo_core.draw.plane_panels import PlanePanels, width_in_inches
from agglo_core.draw.solids.panels import SolidPanels
from agglo_core.errors import FileError, OptionError
from agglo_core.measure.agglomerates import Level, measure_levels
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, part, phase

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.selection import Metric
    from agglo_core.registry import Registry

__all__ = ["PALETTE", "colouring", "draw", "draw_mesh", "panels_of", "save_figure", "short_name"]

_DPI = 160  # pixels per inch
_POINTS = 1.15
"""Font size in points per inch of the picture's width: 11 pixels on a page that shows it 700 pixels wide."""
_LARGEST = 17.0  # points
_LINE, _GAP, _LETTER = 1.2, 1.0, 0.56
"""Height of a line, space below titles, and mean width of a letter, relative to the font size."""
_IN_TITLES = ("UF", "CR")
_EXPLODE = 0.35  # default explosion of agglomerates


def draw(
    mesh: Mesh,
    hierarchies: Mapping[str, Hierarchy],
    path: str | os.PathLike[str],
    metrics: Iterable[Metric] | None = None,
    registry: Registry | None = None,
    progress: Listener | None = None,
    *,
    explode: float | None = None,
    section: Sequence[float] | None = None,
    fine: bool = True,
    levels: Mapping[str, Sequence[Level]] | None = None,
) -> None:
    """Draw the fine mesh once and every level, one row per run, and write the picture.

    Neighbouring agglomerates differ in colour. Titles give the part count, the target diameter and the
    metric means, by default UF and CR. Solids are seen from above and a side, with agglomerates moved apart.
    If the picture cannot be written, no file is left behind.

    Parameters
    ----------
    mesh : Mesh
    hierarchies : mapping of run name to Hierarchy
        At least one.
    path : path
        File, with the format chosen by the suffix: .png, .pdf, .svg, …
    metrics, registry, progress : optional
        As for :func:`agglo_core.measure.measure_levels`.
    explode : float, optional
        In 3-D, agglomerates are moved by this factor times the vector from the mesh centre to their
        centre, from 0 (in place) to 10. Default: 0.35.
    section : (3,) float, optional
        In 3-D, cells beyond the plane with this normal through the mesh centre are left out. The eye is
        at (0.43, −0.75, 0.5), so (0, −1, 0) opens the mesh in front.
    fine : bool
        Begin the first row with the fine mesh. :func:`draw_mesh` draws the mesh alone.
    levels : mapping of run name to sequence of Level, optional
        Levels already measured by ``measure_levels`` with the given ``metrics``, to avoid measuring again.

    Raises
    ------
    OptionError
        Without matplotlib, without runs, or for invalid ``explode`` or ``section``.
    FileError
        If the file cannot be written, or its suffix is unknown.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.draw.plot import draw
    >>> mesh = agglo.samples.voronoi(200, seed=1)
    >>> draw(mesh, {"kmeans": agglo.agglomerate(mesh, cells_per_part=(8, 32))}, "levels.png")
    """
    if not hierarchies:
        raise OptionError("nothing to draw: give at least one hierarchy")
    title_metrics = _IN_TITLES if metrics is None else list(metrics)
    panels = panels_of(mesh, explode, section)
    # Set up the panels.
    columns = fine + max(len(hierarchy.levels) for hierarchy in hierarchies.values())
    width = float(np.clip(24.0 / columns, 2.4, 3.6))
    figure, axes = _panels(panels, len(hierarchies), columns, width)
    with phase(progress, "drawing") as notify:
        # Draw the mesh and the levels of each run in a row.
        for place, (row, (name, hierarchy)) in enumerate(zip(axes, hierarchies.items(), strict=True)):
            run_progress = part(notify, place, 1 + len(hierarchies), name)
            above = f"{short_name(name)}\n"
            if fine and place == 0:
                panels.fine(row[0])
                _entitle(row[0], _describe_mesh(mesh))
            elif fine:
                row[0].set_axis_off()
            measured = (levels or {}).get(name) or measure_levels(mesh, hierarchy, registry, title_metrics)
            for number, (axis, level) in enumerate(zip(row[int(fine) :], measured, strict=False)):
                part(run_progress, fine + number, columns, f"level {number}")
                panels.level(axis, level.labels)
                _entitle(axis, ("" if number else above) + _title(level, usual=metrics is None))
            for axis in row[fine + len(hierarchy.levels) :]:
                axis.set_axis_off()
        part(notify, len(hierarchies), 1 + len(hierarchies), Path(path).name)
        _make_room_for_titles(figure)
        save_figure(figure, Path(path), palette=True)


def draw_mesh(mesh: Mesh, path: str | os.PathLike[str], section: Sequence[float] | None = None) -> None:
    """Draw the fine mesh and write the picture.

    Parameters
    ----------
    mesh : Mesh
    path : path
        File, with the format chosen by the suffix: .png, .pdf, .svg, …
    section : (3,) float, optional
        As in :func:`draw`.

    Raises
    ------
    OptionError
        Without matplotlib, or for an invalid ``section``.
    FileError
        If the file cannot be written, or its suffix is unknown.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.draw.plot import draw_mesh
    >>> draw_mesh(agglo.samples.voronoi(200, seed=1), "mesh.png")
    """
    panels = panels_of(mesh, section=section)
    figure, axes = _panels(panels, 1, 1, 8.0)
    panels.fine(axes[0, 0])
    _entitle(axes[0, 0], _describe_mesh(mesh))
    _make_room_for_titles(figure)
    save_figure(figure, Path(path), palette=True)


def _panels(panels: PlanePanels | SolidPanels, rows: int, columns: int, width: float) -> tuple[Any, Any]:
    """Return a figure with axes ``(rows, columns)`` of this width in inches, without room for titles."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError(f'drawing needs matplotlib: pip install "agglo[plot]" ({error})') from error

    height = width * float(np.clip(panels.ratio, 0.15, 2.0))
    figure = Figure(figsize=(columns * width, rows * height), dpi=_DPI)
    figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def panels_of(
    mesh: Mesh, explode: float | None = None, section: Sequence[float] | None = None
) -> PlanePanels | SolidPanels:
    """Return an object that draws a mesh on axes, or raise OptionError for 3-D options in 2-D.

    Examples
    --------
    >>> from agglo_core.draw.plot import panels_of
    >>> type(panels_of(agglo.samples.squares(2))).__name__
    'PlanePanels'
    >>> type(panels_of(agglo.samples.boxes(2))).__name__
    'SolidPanels'
    """
    if mesh.dim == 3:
        return SolidPanels(mesh, _EXPLODE if explode is None else explode, section)
    for name, given in (("explode", explode), ("section", section)):
        if given is not None:
            raise OptionError(f"{name} applies to 3-D meshes; {mesh.name or 'this mesh'} is 2-D")
    return PlanePanels(mesh)


def _describe_mesh(mesh: Mesh) -> str:
    return f"{short_name(mesh.name or 'mesh', 40)}, {mesh.n_cells:,} cells"


def _entitle(axis: Any, title: str) -> None:
    size = _font(axis.figure.get_figwidth())
    letters = max(int(72.0 * width_in_inches(axis) / (_LETTER * size)), 12)
    lines = [textwrap.fill(line, letters, break_long_words=False) for line in title.split("\n")]
    axis.set_title("\n".join(lines), fontsize=size, color=INK)
    axis.set_axis_off()


def _make_room_for_titles(figure: Any) -> None:
    """Make a figure higher, so that the longest title fits above each of its rows."""
    lines = max(axis.get_title().count("\n") + 1 for axis in figure.axes)
    rows = figure.axes[0].get_gridspec().nrows
    for axis in figure.axes:
        axis.set_anchor("S")
    height = (lines * _LINE + _GAP) * _font(figure.get_figwidth()) / 72.0
    figure.set_figheight(figure.get_figheight() + rows * height)


def _font(width: float) -> float:
    """Return the font size in points for a picture of this width in inches."""
    return min(_POINTS * width, _LARGEST)


def short_name(text: str, most: int = 34) -> str:
    """Shorten a text to ``most`` characters by omitting the middle, so that titles do not collide.

    Examples
    --------
    >>> from agglo_core.draw.plot import short_name
    >>> short_name("agglomerates.vtu", most=9)
    'aggl…vtu'
    """
    return text if len(text) <= most else f"{text[: most // 2]}…{text[-(most // 2 - 1) :]}"


def _title(level: Level, usual: bool) -> str:
    """Return the title of a level: target, part count, metric means (``usual``: default ones)."""
    line = level.line
    parts = f"{line['parts']:,} part{'s' if line['parts'] != 1 else ''}"
    target = line["target"]
    if "h_star" in target:
        # not broken inside: the spaces are those that stay in a line
        factor = f" =\xa0{target['h_factor']:.3g}\xa0×\xa0largest\xa0cell" if target.get("h_factor") else ""
        parts += f"\ndiameter ≤ {target['h_star']:.3g}{factor}"
    names = [name for name in level.metrics if name in _IN_TITLES or not usual]
    means = {name: line[name] for name in names} | ({} if usual else dict(level.objectives))
    missing = level.undefined
    entries = [
        f"{name} {_number(value)}" + (f" ({missing[name]} undefined)" if name in missing else "")
        for name, value in means.items()
    ]
    rows = ["   ".join(entries[start : start + 3]) for start in range(0, len(entries), 3)]
    return "\n".join([parts, *rows])


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}" if 0.0 <= value < 10.0 else f"{value:.3g}"


def save_figure(figure: Any, path: Path, *, palette: bool = False) -> None:
    """Write a figure completely or not at all, in the format chosen by the suffix.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : Path
    palette : bool
        Reduce a .png to its best 256 colours, for a third of the size. Suitable for agglomerates, not for
        smooth scales.

    Raises
    ------
    FileError
        If the file cannot be written, or its suffix is unknown.

    Examples
    --------
    >>> from pathlib import Path
    >>> from matplotlib.figure import Figure
    >>> from agglo_core.draw.plot import save_figure
    >>> save_figure(Figure(), Path("empty.png"))
    """
    from agglo_core.io.atomic import staging

    kind, kinds = path.suffix[1:].lower(), figure.canvas.get_supported_filetypes()
    if kind not in kinds:
        raise FileError(
            f"{path}: unknown picture format {path.suffix!r}; accepted: {', '.join(sorted(kinds))}"
        )
    try:
        with staging(path) as folder:
            if palette and kind == "png":
                _save_palette(figure, folder / path.name)
            else:
                figure.savefig(folder / path.name, format=kind, dpi=_DPI)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error


def _save_palette(figure: Any, file: Path) -> None:
    from PIL import Image

    figure.canvas.draw()
    picture = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    few = picture.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(file, format="png", dpi=(_DPI, _DPI))
