"""Data of the fine mesh in the report: cell order, 2-D mesh faces, tags."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.draw.colours import PALETTE
from agglo_core.draw.webpage.packing import differences, integers, reals, separate_bytes
from agglo_core.graph.ordering import curve_order
from agglo_core.mesh import Mesh

_FINEST: Final = 2.0**-30
_COARSEST: Final = 2.0**-16
"""Minimum and maximum step of the grid, relative to the mesh size."""
_TINY: Final = 1.0
"""Percentage of faces that may be shorter than ``_STEPS`` steps."""
_STEPS: Final = 16.0  # grid steps per face length


def order_along_curve(mesh: Mesh) -> Int:
    """Return the cells ``(n_cells,)`` in the order of a space-filling curve.

    In this order, labels form long runs of equal numbers and faces join cells with near numbers, whatever the
    numbering of the mesh.
    """
    return curve_order(mesh.local_centroids)


def plane_faces(mesh: Mesh, order: Int) -> dict[str, Any]:
    """Return the faces of a 2-D mesh in compact form, for cells sorted by ``order``.

    ``low`` is the position of each face's left cell. ``gap`` is the distance in the order to the
    cell on its right, 0 for the outside. ``ends`` are each face's points, counted back from the next new
    point. ``x`` and ``y`` are point coordinates in units of ``step`` from the lower left corner.
    """
    # Orient the faces from the earlier to the later cell, and sort them.
    place = np.empty(mesh.n_cells, np.int64)
    place[order] = np.arange(mesh.n_cells)
    left, right = np.where(mesh.face_cells < 0, -1, place[mesh.face_cells]).T
    ends = mesh.face_vertices.reshape(-1, 2)
    turned = (right >= 0) & (right < left)
    ends = np.where(turned[:, None], ends[:, ::-1], ends)
    left, right = np.where(turned, right, left), np.where(turned, left, right)
    sorted_faces = np.lexsort((right, left))
    left, right, ends = left[sorted_faces], right[sorted_faces], ends[sorted_faces]
    # Number the points in order of first use.
    used_points, first, point = np.unique(ends, return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    number = np.empty(len(used_points), np.int64)
    number[by_use] = np.arange(len(used_points))
    ends = number[point.ravel()]
    newest = np.maximum.accumulate(np.append(-1, ends[:-1])) + 1
    grid, step = _round_to_grid(mesh.local_points[used_points[by_use]], ends)
    return {
        "low": differences(left),
        "gap": separate_bytes(np.where(right < 0, 0, right - left)),
        "ends": separate_bytes(newest - ends),
        "x": differences(grid[:, 0]),
        "y": differences(grid[:, 1]),
        "step": step,
    }


def _round_to_grid(points: Float, ends: Int) -> tuple[Int, float]:
    """Round points to an integer grid, fine enough for all but the very shortest faces."""
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max())
    lengths = np.linalg.norm(np.diff(points[ends.reshape(-1, 2)], axis=1)[:, 0], axis=1)
    wanted = float(np.percentile(lengths, _TINY)) / _STEPS
    step = float(np.clip(wanted, _FINEST * extent, _COARSEST * extent))
    grid: Int = np.rint((points - low) / step).astype(np.int64)
    return grid, step


def tags(mesh: Mesh, order: Int) -> list[dict[str, Any]]:
    """Return the cell tags in compact form: as indices if they have few values, else as numbers."""
    entries: list[dict[str, Any]] = []
    for name, values in mesh.cell_tags.items():
        distinct, places = np.unique(values[order], return_inverse=True)
        if len(distinct) <= len(PALETTE):
            entries.append(
                {"name": name, "known": [str(value) for value in distinct], "cells": integers(places)}
            )
        else:
            entries.append({"name": name, "cells": reals(values[order])})
    return entries
