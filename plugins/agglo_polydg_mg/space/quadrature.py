"""Quadrature on the triangles or tetrahedra of cells, and exact polynomial moments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
)
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.space.gauss_points import gauss, simplex_rule
from agglo_polydg_mg.space.polynomials import n_polynomials, orders
from agglo_polydg_mg.space.solid_geometry import tetrahedra_of_solids
from agglo_polydg_mg.space.walk import Walk


def triangulate(mesh: Mesh) -> tuple[Int, Float]:
    """Triangulate each cell: offsets ``(n + 1,)`` and corners ``(t, 3, 2)`` relative to the origin.

    Raises
    ------
    MeshError
        For cells whose triangle areas do not sum to the cell area.
    """
    # 1. Fans where they fit, constrained Delaunay triangles elsewhere
    cells, corners, fanned = _fans(mesh)
    rest = np.flatnonzero(~fanned)
    if len(rest):
        more, others = _delaunay(mesh, rest)
        cells, corners = np.concatenate((cells, more)), np.concatenate((corners, others))
        order = np.argsort(cells, kind="stable")
        cells, corners = cells[order], corners[order]
    # 2. Check the areas
    areas = np.bincount(cells, _areas(corners), mesh.n_cells)
    wrong = np.flatnonzero(np.abs(areas - mesh.cell_measures) > 1e-8 * mesh.cell_measures)
    if len(wrong):
        raise MeshError(f"cells {wrong[:5].tolist()} cannot be cut into triangles: they overlap themselves")
    return frozen_int(np.searchsorted(cells, np.arange(mesh.n_cells + 1))), frozen_float(corners)


def _fans(mesh: Mesh) -> tuple[Int, Float, np.ndarray]:
    """Cut cells into fans of triangles from a vertex, if possible: cells, corners, and a mask ``(n,)``.

    The mask is True for cells that are cut.
    """
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
    """Return constrained Delaunay triangles of some cells, with holes and pinches, counter-clockwise."""
    import shapely

    triangles, owners = shapely.get_parts(
        shapely.constrained_delaunay_triangles(mesh.to_shapely()[cells]), return_index=True
    )
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3] - mesh.origin
    clockwise = _areas(corners) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return cells[owners], corners


# Quadrature points per batch, which fits into the processor cache (benchmarks/constants.py)
_POINTS = 200_000


class Batch(NamedTuple):
    """Quadrature points of the cells ``first … first + n``.

    ``offsets (n + 1,)`` index the points; ``points (q, d)`` are relative to the mesh origin;
    ``weights (q,)`` sum to areas or volumes.
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


def moments(mesh: Mesh, boxes: Float, degree: int, walk: Walk | None = None) -> Float:
    """Integrate polynomials up to a degree over each cell: ``(n, m)``, exact for any shape.

    In 3-D cells may be visited in the order of a ``walk``.
    """
    if mesh.dim == 3:
        return _solid_moments(mesh, boxes, degree, walk)
    from agglo_polydg_mg.space.legendre_kernels import boundary_moments

    rule = gauss((degree + 3) // 2)  # the antiderivative has a higher degree by one
    points, (offsets, faces), boxes = mesh.local_points, mesh.cell_faces, frozen_float(boxes)
    sides = mesh.face_pairs, mesh.face_cells

    def integrals(start: int, stop: int) -> Float:
        own = offsets[start : stop + 1]
        found: Float = boundary_moments(points, own, faces, *sides, start, boxes[start:stop], *rule, degree)
        return found

    return np.concatenate(over_ranges(integrals, mesh.n_cells, few=COSTLY))


def _solid_moments(mesh: Mesh, boxes: Float, degree: int, walk: Walk | None) -> Float:
    from agglo_polydg_mg.space.solid_kernels import solid_moments

    rule = simplex_rule(2, (degree + 3) // 2)
    (offsets, faces), of_faces = mesh.cell_faces, mesh.face_cells
    if walk is not None:
        (offsets, faces), boxes = walk.rows(offsets, faces), boxes[walk.cells]
        of_faces = frozen_int(walk.turns[of_faces])
    boxes, shape = frozen_float(boxes), (mesh.face_offsets, mesh.face_vertices, of_faces)

    def integrals(start: int, stop: int) -> Float:
        own = mesh.local_points, offsets[start : stop + 1], faces, *shape, start, boxes[start:stop]
        return np.asarray(solid_moments(*own, *rule, orders(degree, 3)))

    found = np.concatenate(over_ranges(integrals, mesh.n_cells, few=COSTLY))
    return found if walk is None else walk.back(found)


def weighted_moments(mesh: Mesh, field: Field, boxes: Float, degree: int, name: str) -> Float:
    """Integrate a field times polynomials up to a degree over each cell: ``(n, m)``.

    Numbers and cell values are integrated exactly; a callable is sampled inside the cells, at points exact
    up to degree + 5.

    Raises
    ------
    OptionError
        For a field with the wrong shape or nonfinite values.
    """
    if not callable(field):
        values = per_cell(field, mesh.n_cells, name)
        return moments(mesh, boxes, degree) * values[:, None] if values.any() else _zeros(mesh, degree)
    boxes, result = frozen_float(boxes), _zeros(mesh, degree)
    for batch in inside(mesh, degree + 5):
        values = frozen_float(sample(field, batch.points + mesh.origin, name) * batch.weights)
        part = slice(batch.first, batch.first + len(batch.offsets) - 1)
        batch_boxes, offsets, points = boxes[part], batch.offsets, batch.points

        def integrals(start: int, stop: int) -> Float:
            ends = offsets[start : stop + 1]  # noqa: B023
            return _at_points(points, values, ends, batch_boxes[start:stop], degree)  # noqa: B023

        result[part] = np.concatenate(over_ranges(integrals, len(batch_boxes), few=COSTLY))
    return result


def _at_points(points: Float, values: Float, ends: Int, boxes: Float, degree: int) -> Float:
    """Sum values times polynomials over each cell's points: ``(n, m)``."""
    if points.shape[1] == 3:
        from agglo_polydg_mg.space.solid_kernels import solid_point_moments

        return np.asarray(solid_point_moments(points, values, ends, boxes, orders(degree, 3)))
    from agglo_polydg_mg.space.legendre_kernels import point_moments

    return np.asarray(point_moments(points, values, ends, boxes, degree))


def _zeros(mesh: Mesh, degree: int) -> Float:
    return np.zeros((mesh.n_cells, n_polynomials(degree, mesh.dim)))


def per_cell(field: float | Float, n: int, name: str) -> Float:
    """Convert a number or an array of cell values to finite cell values ``(n,)``.

    Raises
    ------
    OptionError
        For anything else; the message names the field.
    """
    try:
        values = frozen_float(field)
    except MeshError as error:
        raise OptionError(
            f"{name} must be a number, ({n},) values or a callable; given {field!r:.60} ({error})"
        ) from None
    if values.shape not in ((), (n,)):
        raise OptionError(f"{name} has shape {values.shape}: expected a number, ({n},) values or a callable")
    _require_finite(values, name)
    return np.broadcast_to(values, (n,))


def sample(field: Callable[[Float], Float], points: Float, name: str, shape: tuple[int, ...] = ()) -> Float:
    """Evaluate a callable at ``points (q, d)`` in user coordinates, and check the values ``(q, *shape)``.

    Raises
    ------
    OptionError
        If the callable fails, or its values are not numbers, have another shape, or are not finite.
    """
    try:
        returned = field(points)
    except AggloError:
        raise
    except Exception as error:  # a user's callable may raise any exception
        raise OptionError(
            f"{name} failed for {len(points)} points of shape {points.shape}: {type(error).__name__}: {error}"
        ) from error
    try:
        values = frozen_float(returned)
    except MeshError as error:
        raise OptionError(f"{name} did not return real numbers for {len(points)} points: {error}") from None
    if values.shape not in (shape, (len(points), *shape)):
        raise OptionError(f"{name} returned shape {values.shape} for {len(points)} points")
    _require_finite(values, name)
    return np.broadcast_to(values, (len(points), *shape))


def _require_finite(values: Float, name: str) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise OptionError(f"{name} is {values.flat[bad[0]]} (value {bad[0]} of {values.size}), not finite")


def inside(mesh: Mesh, degree: int) -> Iterator[Batch]:
    """Yield quadrature points inside the cells, exact up to a degree, in batches of cells.

    Raises
    ------
    MeshError
        See :func:`~agglo_polydg_mg.space.quadrature.triangulate`.
    """
    offsets, corners = triangulate(mesh) if mesh.dim == 2 else tetrahedra_of_solids(mesh)
    reference, weights = simplex_rule(mesh.dim, degree // 2 + 1)
    ends = offsets * len(weights)
    first = 0
    while first < mesh.n_cells:
        # Each batch has at least one cell, otherwise at most _POINTS points
        stop = max(first + 1, int(np.searchsorted(ends, ends[first] + _POINTS, "right")) - 1)
        chosen = corners[offsets[first] : offsets[stop]]
        edges = chosen[:, 1:] - chosen[:, :1]
        points = chosen[:, None, 0]
        for axis in range(mesh.dim):
            points = points + reference[:, axis : axis + 1] * edges[:, axis : axis + 1]
        yield Batch(
            first,
            frozen_int(ends[first : stop + 1] - ends[first]),
            frozen_float(points.reshape(-1, mesh.dim)),
            frozen_float((_determinants(edges)[:, None] * weights).ravel()),
        )
        first = stop


def _determinants(edges: Float) -> Float:
    """Return the determinants ``(t,)`` of the edges ``(t, d, d)`` from the first corner of each simplex."""
    u, v = edges[:, 0], edges[:, 1]
    if edges.shape[1] == 2:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.asarray((np.cross(u, v) * edges[:, 2]).sum(axis=1))
