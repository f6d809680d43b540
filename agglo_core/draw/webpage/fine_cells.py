"""The cells of the page: in which order they are there, a plane mesh as faces between them, tags."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.draw.colours import PALETTE
from agglo_core.draw.webpage.packing import bytes_apart, differences, integers, reals
from agglo_core.graph.ordering import curve_order
from agglo_core.mesh import Mesh

_FINEST: Final = 2.0**-30
_COARSEST: Final = 2.0**-16
"""Least and largest step of the grid, over the size of the mesh."""
_TINY: Final = 1.0
"""Percent of the faces that may fall short of so many steps:"""
_STEPS: Final = 16.0


def along_curve(mesh: Mesh) -> Int:
    """Cells ``(n_cells,)`` in the order of a space-filling curve.

    Labels are long runs of equal numbers in this order, and faces join cells of near numbers, whatever the
    numbers of the cells in the mesh.
    """
    return curve_order(mesh.local_centroids)


def plane_faces(mesh: Mesh, order: Int) -> dict[str, Any]:
    """Faces of a plane mesh from the first cell of ``order`` to the last, and its points on a grid.

    ``low`` is the cell on the left of each face, ``gap`` how much later the cell on its right is, 0 for the
    outside. ``ends`` are the points of each face, counted back from the first that no face before has met;
    ``x`` and ``y`` their places in ``step`` from the lower left corner.
    """
    place = np.empty(mesh.n_cells, np.int64)
    place[order] = np.arange(mesh.n_cells)
    left, right = np.where(mesh.face_cells < 0, -1, place[mesh.face_cells]).T
    ends = mesh.face_vertices.reshape(-1, 2)
    turned = (right >= 0) & (right < left)
    ends = np.where(turned[:, None], ends[:, ::-1], ends)
    left, right = np.where(turned, right, left), np.where(turned, left, right)
    sorted_faces = np.lexsort((right, left))
    left, right, ends = left[sorted_faces], right[sorted_faces], ends[sorted_faces]
    used, first, point = np.unique(ends, return_index=True, return_inverse=True)
    met = np.argsort(first)
    number = np.empty(len(used), np.int64)
    number[met] = np.arange(len(used))
    ends = number[point.ravel()]
    newest = np.maximum.accumulate(np.append(-1, ends[:-1])) + 1
    grid, step = _on_grid(mesh.local_points[used[met]], ends)
    return {
        "low": differences(left),
        "gap": bytes_apart(np.where(right < 0, 0, right - left)),
        "ends": bytes_apart(newest - ends),
        "x": differences(grid[:, 0]),
        "y": differences(grid[:, 1]),
        "step": step,
    }


def _on_grid(points: Float, ends: Int) -> tuple[Int, float]:
    """Points as whole numbers of a step: fine enough for all but the very shortest faces."""
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max())
    lengths = np.linalg.norm(np.diff(points[ends.reshape(-1, 2)], axis=1)[:, 0], axis=1)
    wanted = float(np.percentile(lengths, _TINY)) / _STEPS
    step = float(np.clip(wanted, _FINEST * extent, _COARSEST * extent))
    grid: Int = np.rint((points - low) / step).astype(np.int64)
    return grid, step


def tags(mesh: Mesh, order: Int) -> list[dict[str, Any]]:
    """Tags of the cells: those of few values as places in the list of these, the others as numbers."""
    made: list[dict[str, Any]] = []
    for name, values in mesh.cell_tags.items():
        known, places = np.unique(values[order], return_inverse=True)
        if len(known) <= len(PALETTE):
            made.append({"name": name, "known": [str(value) for value in known], "cells": integers(places)})
        else:
            made.append({"name": name, "cells": reals(values[order])})
    return made
