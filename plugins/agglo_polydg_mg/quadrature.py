"""Integrals over polygons of any shape: exactly over their boundary, or with points inside.

A polynomial is integrated by the divergence theorem, for which corners and holes make no difference. Anything
else must be sampled inside the cell: cells are cut into triangles (a fan where it fits, constrained
Delaunay triangles otherwise), which carry Gauss points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import (
    AggloError,
    Field,
    Float,
    Int,
    Mesh,
    MeshError,
    OptionError,
    frozen_float,
    frozen_int,
    over_ranges,
)

__all__ = [
    "Batch",
    "face_points",
    "gauss",
    "inside",
    "moments",
    "per_cell",
    "sample",
    "triangulate",
    "weighted_moments",
]

_FEW = 4_000  # cells one thread integrates over in some milliseconds
_POINTS = 200_000  # in a batch: it stays in the cache of a processor


class Batch(NamedTuple):
    """Quadrature points of the cells ``first … first + n``.

    ``offsets (n + 1,)`` into the points; ``points (q, 2)`` relative to the mesh's origin; ``weights
    (q,)`` sum to the areas.
    """

    first: int
    offsets: Int
    points: Float
    weights: Float

    @property
    def cells(self) -> Int:
        """Cell of each point ``(q,)``."""
        sizes = np.diff(self.offsets)
        return frozen_int(self.first + np.repeat(np.arange(len(sizes)), sizes))


@cache
def gauss(n: int) -> tuple[Float, Float]:
    """Nodes and weights ``(n,)`` on [−1, 1], exact up to degree 2n − 1."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return frozen_float(nodes), frozen_float(weights)


def moments(mesh: Mesh, boxes: Float, degree: int) -> Float:
    """Integrals ``(n, m)`` of the polynomials up to a degree, each on its cell: exact for any shape."""
    from agglo_polydg_mg.legendre_kernels import boundary_moments

    rule = gauss((degree + 3) // 2)  # the antiderivative has one degree more
    points, (offsets, faces), boxes = mesh.local_points, mesh.cell_faces, frozen_float(boxes)
    sides = mesh.face_pairs, mesh.face_cells

    def integrals(start: int, stop: int) -> Float:
        own = offsets[start : stop + 1]
        found: Float = boundary_moments(points, own, faces, *sides, start, boxes[start:stop], *rule, degree)
        return found

    return np.concatenate(over_ranges(integrals, mesh.n_cells, few=_FEW))


def weighted_moments(mesh: Mesh, field: Field, boxes: Float, degree: int, name: str) -> Float:
    """Integrals ``(n, m)`` of a field times the polynomials up to a degree.

    A number or one value per cell is integrated exactly; a callable is sampled inside the cells, at
    points exact for degree + 5.

    Raises
    ------
    OptionError
        Naming the field: wrong shape, not finite.
    """
    if not callable(field):
        values = per_cell(field, mesh.n_cells, name)
        return moments(mesh, boxes, degree) * values[:, None] if values.any() else _zeros(mesh, degree)
    from agglo_polydg_mg.legendre_kernels import point_moments

    boxes = frozen_float(boxes)
    result = _zeros(mesh, degree)
    for batch in inside(mesh, degree + 5):
        values = frozen_float(sample(field, batch.points + mesh.origin, name) * batch.weights)
        part = slice(batch.first, batch.first + len(batch.offsets) - 1)
        own, offsets, points = boxes[part], batch.offsets, batch.points

        def integrals(start: int, stop: int) -> Float:
            ends = offsets[start : stop + 1]  # noqa: B023
            found: Float = point_moments(points, values, ends, own[start:stop], degree)  # noqa: B023
            return found

        result[part] = np.concatenate(over_ranges(integrals, len(own), few=_FEW))
    return result


def _zeros(mesh: Mesh, degree: int) -> Float:
    return np.zeros((mesh.n_cells, (degree + 1) * (degree + 2) // 2))


def per_cell(field: float | Float, n: int, name: str) -> Float:
    """A number or ``(n,)`` values as ``(n,)`` values; OptionError, naming the field, for anything else."""
    try:
        values = np.asarray(field, dtype=float)
    except (TypeError, ValueError):
        raise OptionError(
            f"{name} must be a number, ({n},) values or a callable; given {field!r:.60}"
        ) from None
    if values.shape not in ((), (n,)):
        raise OptionError(f"{name} has shape {values.shape}: expected a number, ({n},) values or a callable")
    _require_finite(values, name)
    return np.broadcast_to(values, (n,))


def sample(field: Callable[[Float], Float], points: Float, name: str) -> Float:
    """Values ``(q,)`` of a callable at ``points (q, 2)`` in user coordinates.

    Raises
    ------
    OptionError
        If the callable fails, or its values are not numbers, have another shape, or are not finite.
    """
    try:
        values = np.asarray(field(points), dtype=float)
    except AggloError:
        raise
    except Exception as error:  # whatever a user's callable raises
        raise OptionError(
            f"{name} failed for {len(points)} points of shape {points.shape}: {type(error).__name__}: {error}"
        ) from error
    if values.shape not in ((), (len(points),)):
        raise OptionError(f"{name} returned the shape {values.shape} for {len(points)} points")
    _require_finite(values, name)
    return np.broadcast_to(values, (len(points),))


def _require_finite(values: Float, name: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise OptionError(f"{name} is {values.flat[bad[0]]} (value {bad[0]} of {values.size}), not finite")


def face_points(mesh: Mesh, faces: Int, n: int) -> Float:
    """Gauss points ``(f, n, 2)`` of some faces, relative to the origin, from first vertex to second."""
    start, end = (mesh.local_points[mesh.face_pairs[faces, k]][:, None] for k in range(2))
    along = 0.5 * (1 + gauss(n)[0])[:, None]
    return np.asarray(start + along * (end - start))


def inside(mesh: Mesh, degree: int) -> Iterator[Batch]:
    """Quadrature points inside the cells, exact up to a degree, a batch of cells at a time.

    Raises
    ------
    MeshError
        As :func:`triangulate`.
    """
    offsets, corners = triangulate(mesh)
    reference, weights = _triangle_rule(degree // 2 + 1)
    ends = offsets * len(weights)
    first = 0
    while first < mesh.n_cells:
        stop = max(first + 1, int(np.searchsorted(ends, ends[first] + _POINTS, "right")) - 1)
        chosen = corners[offsets[first] : offsets[stop]]
        u, v = chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0]
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        points = chosen[:, None, 0] + reference[:, :1] * u[:, None] + reference[:, 1:] * v[:, None]
        yield Batch(
            first,
            frozen_int(ends[first : stop + 1] - ends[first]),
            frozen_float(points.reshape(-1, 2)),
            frozen_float((twice[:, None] * weights).ravel()),
        )
        first = stop


def _triangle_rule(n: int) -> tuple[Float, Float]:
    """Points ``(n², 2)`` and weights on the triangle (0,0) (1,0) (0,1): a square folded onto it."""
    from scipy.special import roots_jacobi

    x, wx = gauss(n)
    y, wy = roots_jacobi(n, 1.0, 0.0)
    s, t = (0.5 * (1 + each).ravel() for each in np.meshgrid(x, y))
    return np.stack((s * (1 - t), t), axis=1), 0.125 * np.outer(wy, wx).ravel()


def triangulate(mesh: Mesh) -> tuple[Int, Float]:
    """Triangles inside each cell: offsets ``(n + 1,)`` and corners ``(t, 3, 2)`` relative to the origin.

    Raises
    ------
    MeshError
        Naming cells whose triangles do not add up to their area.
    """
    cells, corners, fanned = _fans(mesh)
    rest = np.flatnonzero(~fanned)
    if len(rest):
        more, others = _delaunay(mesh, rest)
        cells, corners = np.concatenate((cells, more)), np.concatenate((corners, others))
        order = np.argsort(cells, kind="stable")
        cells, corners = cells[order], corners[order]
    areas = np.bincount(cells, _areas(corners), mesh.n_cells)
    wrong = np.flatnonzero(np.abs(areas - mesh.cell_measures) > 1e-8 * mesh.cell_measures)
    if len(wrong):
        raise MeshError(f"cells {wrong[:5].tolist()} cannot be cut into triangles: they overlap themselves")
    return frozen_int(np.searchsorted(cells, np.arange(mesh.n_cells + 1))), frozen_float(corners)


def _fans(mesh: Mesh) -> tuple[Int, Float, np.ndarray]:
    """Fans from the first vertex of each cell: cells, corners, and which cells they fit ``(n,)``."""
    cell_loops, loop_offsets, vertices = mesh.boundary_loops
    simple = np.diff(cell_loops) == 1
    loop = cell_loops[:-1][simple]
    start, count = loop_offsets[loop], np.diff(loop_offsets)[loop] - 2
    cells = np.repeat(np.flatnonzero(simple), count)
    base = np.repeat(start, count)
    step = np.arange(len(cells)) - np.repeat(np.cumsum(count) - count, count) + base
    corners = mesh.local_points[vertices[np.stack((base, step + 1, step + 2), axis=1)]]
    areas = _areas(corners)
    fits = simple.copy()
    fits[cells[areas < -1e-14 * mesh.cell_measures[cells]]] = False
    kept = fits[cells]
    return cells[kept], corners[kept], fits


def _areas(corners: Float) -> Float:
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _delaunay(mesh: Mesh, cells: Int) -> tuple[Int, Float]:
    """Constrained Delaunay triangles of some cells, holes and pinches included, counter-clockwise."""
    import shapely

    triangles, owners = shapely.get_parts(
        shapely.constrained_delaunay_triangles(mesh.to_shapely()[cells]), return_index=True
    )
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3] - mesh.origin
    clockwise = _areas(corners) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return cells[owners], corners
