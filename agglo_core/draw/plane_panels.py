"""Drawing of 2-D meshes on axes: cells filled by agglomerate, outlines, cell edges."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.arrays import Int
from agglo_core.draw.colours import FINE, INK, Paint, blank, by_neighbours
from agglo_core.mesh import Mesh

_SEEN = 3.0
"""Minimum cell size, in points, for fine edges inside agglomerates. Smaller cells would be speckle."""
_AT_ONCE = 1000  # edges per path


class PlanePanels:
    """Drawing of a 2-D mesh and its levels on matplotlib axes.

    Parameters
    ----------
    mesh : Mesh
        2-D mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        extent = np.ptp(mesh.points[mesh.face_vertices], axis=0)
        self.ratio = float(extent[1] / extent[0])
        """Ratio of height to width."""

    def fine(self, axis: Any, paint: Paint | None = None) -> None:
        """Draw the fine mesh, coloured by ``paint`` if given."""
        whole = self.mesh.coarsen(np.zeros(self.mesh.n_cells, np.int64))
        if paint is None:
            _fill(axis, whole, blank(1))
        else:
            _fill(axis, self.mesh, paint)
        _edges(axis, self.mesh, FINE, _line_width(axis, self.mesh.n_cells, 0.6))
        _edges(axis, whole, INK, 0.9)
        self._frame(axis)

    def level(self, axis: Any, labels: Int, paint: Paint | None = None) -> None:
        """Draw the agglomerates of a level, coloured by ``paint`` or so that neighbours differ."""
        coarse = self.mesh.coarsen(labels)
        _fill(axis, coarse, by_neighbours(coarse) if paint is None else paint)
        fine_edges(axis, self.mesh)
        _edges(axis, coarse, INK, _line_width(axis, coarse.n_cells, 1.1))
        self._frame(axis)

    def _frame(self, axis: Any) -> None:
        used = self.mesh.points[self.mesh.face_vertices]
        low, high = used.min(axis=0), used.max(axis=0)
        margin = 0.01 * float((high - low).max())
        axis.set_xlim(low[0] - margin, high[0] + margin)
        axis.set_ylim(low[1] - margin, high[1] + margin)
        axis.set_aspect("equal")


def fine_edges(axis: Any, mesh: Mesh) -> None:
    """Draw faint cell edges over filled agglomerates, unless the cells are too small to be seen."""
    if _cell_size(axis, mesh.n_cells) >= _SEEN:
        _edges(axis, mesh, FINE, 0.5 * _line_width(axis, mesh.n_cells, 0.6), alpha=0.35)


def _fill(axis: Any, mesh: Mesh, paint: Paint) -> None:
    """Fill all cells, with a single matplotlib path for each colour.

    Holes stay open.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    loops = mesh.boundary_loops
    # Close each loop by repeating its first vertex.
    starts, stops = loops.loop_offsets[:-1], loops.loop_offsets[1:]
    vertices = np.insert(loops.vertices, stops, loops.vertices[starts])
    number = np.arange(len(starts))
    codes = np.full(len(vertices), Outline.LINETO, np.uint8)
    codes[starts + number] = Outline.MOVETO
    codes[stops + number] = Outline.CLOSEPOLY
    colour = np.repeat(np.repeat(paint.colours, np.diff(loops.cell_offsets)), stops - starts + 1)
    # One path per colour.
    for k, tone in enumerate(paint.palette):
        mine = colour == k
        if mine.any():
            outline = Outline(mesh.points[vertices[mine]], codes[mine])
            # not add_patch, which walks every edge in Python to find limits
            axis.add_artist(PathPatch(outline, facecolor=tone, edgecolor="none", linewidth=0))


def _edges(axis: Any, mesh: Mesh, colour: str, width: float, alpha: float = 1.0) -> None:
    """Draw the mesh edges, a thousand per matplotlib path, because each path is a costly object."""
    from matplotlib.collections import PathCollection
    from matplotlib.path import Path as Outline

    if width > 0:
        ends = mesh.points[mesh.face_pairs].reshape(-1, 2)
        codes = np.tile(np.array([Outline.MOVETO, Outline.LINETO], np.uint8), _AT_ONCE)
        starts = range(0, len(ends), 2 * _AT_ONCE)
        pieces = [ends[start : start + 2 * _AT_ONCE] for start in starts]
        paths = [Outline(piece, codes[: len(piece)]) for piece in pieces]
        look: dict[str, Any] = {
            "facecolors": "none",
            "edgecolors": colour,
            "linewidths": width,
            "alpha": alpha,
        }
        axis.add_collection(PathCollection(paths, capstyle="round", **look), autolim=False)


def _line_width(axis: Any, n_cells: int, most: float) -> float:
    """Return a line width in points that leaves the cells visible, 0 for tiny cells."""
    cell = _cell_size(axis, n_cells)
    return 0.0 if cell < 0.7 else float(min(most, 0.08 * cell + 0.05))


def _cell_size(axis: Any, n_cells: int) -> float:
    """Return the approximate cell size in points on axes that show this many cells."""
    return float(72.0 * width_in_inches(axis) / np.sqrt(n_cells))


def width_in_inches(axis: Any) -> float:
    """Return the width of axes in inches, before legends or colour bars are added."""
    grid, whole = axis.get_gridspec(), axis.figure.bbox.width / axis.figure.dpi
    return float(whole * axis.get_position().width if grid is None else whole / grid.ncols)
