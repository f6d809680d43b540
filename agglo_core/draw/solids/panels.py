"""Drawing of 3-D meshes on axes: visible faces of agglomerates, which may be moved apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.draw.colours import Paint, blank, by_neighbours
from agglo_core.draw.plane_panels import width_in_inches
from agglo_core.draw.solids.shading import shade_faces
from agglo_core.draw.solids.surfaces import (
    Surface,
    check_explode,
    mark_cells_beyond,
    outer_faces,
    project_surface,
)
from agglo_core.mesh import Mesh

_FINE = 2
"""Oversampling factor for smooth lines."""


class SolidPanels:
    """Drawing of a 3-D mesh and its levels on matplotlib axes.

    Parameters
    ----------
    mesh : Mesh
        3-D mesh.
    explode : float
        Agglomerates are moved by this factor times the vector from the mesh centre to their centre.
    section : (3,) float, optional
        Cells beyond the plane with this normal through the centre are left out.

    Raises
    ------
    OptionError
        If ``explode`` is not a number from 0 to 10, or ``section`` is not a direction.
    """

    def __init__(self, mesh: Mesh, explode: float, section: Sequence[float] | None = None) -> None:
        self.mesh, self.explode = mesh, check_explode(explode)
        self.kept = None if section is None else ~mark_cells_beyond(mesh, section)
        self.whole = outer_faces(mesh, np.zeros(mesh.n_cells, np.int64), kept=self.kept)
        height, width = project_surface(self.whole, pixels=200).faces.shape
        self.ratio = height / width
        """Ratio of height to width."""

    def fine(self, axis: Any, paint: Paint | None = None) -> None:
        """Draw the surface of the mesh, coloured by ``paint`` if given."""
        rows = (blank(self.mesh.n_cells) if paint is None else paint).rows
        self._show(axis, self.whole, rows[self.whole.cells])

    def level(self, axis: Any, labels: Int, paint: Paint | None = None) -> None:
        """Draw the agglomerates of a level apart, coloured by ``paint`` or so that neighbours differ."""
        surface = outer_faces(self.mesh, labels, self.explode, self.kept)
        rows = (by_neighbours(self.mesh.coarsen(labels)) if paint is None else paint).rows
        self._show(axis, surface, rows[surface.parts])

    def _show(self, axis: Any, surface: Surface, colours: Float) -> None:
        pixels = _FINE * width_in_inches(axis) * axis.figure.dpi * max(1.0, self.ratio)
        axis.imshow(shade_faces(surface, project_surface(surface, pixels=int(pixels)), colours, _FINE))
