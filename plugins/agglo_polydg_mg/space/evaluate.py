"""Values of a solution at points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Float, Int, Mesh, OptionError, frozen_int
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.locate_solids import cells_that_hold

_NEAR = 1e-9  # of the mesh's size: points on a face may miss both of its cells by rounding


def evaluate(basis: Basis, x: Float, points: ArrayLike) -> Float:
    """Values ``(q,)`` of the function with coefficients ``x (n,)`` at ``points (q, d)``; NaN outside.

    On a face, where the function has two values, that of the cell with the lower number.

    Raises
    ------
    OptionError
        For points of another shape.
    """
    points = np.asarray(points, dtype=float)
    cells = locate(basis.mesh, points)
    found = cells >= 0
    values = np.full(len(points), np.nan)
    values[found] = basis.evaluate(x, cells[found], points[found])
    return values


def locate(mesh: Mesh, points: ArrayLike) -> Int:
    """Cell of each point ``(q,)``: the lowest of those that hold it, −1 outside the mesh.

    Raises
    ------
    OptionError
        For points of another shape than ``(q, d)``.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != mesh.dim:
        raise OptionError(f"points must have shape (q, {mesh.dim}); given {points.shape}")
    if mesh.dim == 3:
        return cells_that_hold(mesh, np.asarray(points - mesh.origin))
    import shapely

    tree = shapely.STRtree(mesh.to_shapely())
    cells = np.full(len(points), mesh.n_cells)
    np.minimum.at(cells, *tree.query(shapely.points(points), predicate="intersects"))
    missed = np.flatnonzero((cells == mesh.n_cells) & np.isfinite(points).all(axis=1))
    reach = _NEAR * float(np.ptp(mesh.local_points, axis=0).max())
    at, near = tree.query_nearest(shapely.points(points[missed]), max_distance=reach)
    np.minimum.at(cells, missed[at], near)
    return frozen_int(np.where(cells < mesh.n_cells, cells, -1))
