"""Moments of polynomials and of fields on cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Field, Float, Int, Mesh, frozen_float
from agglo_core.fields.gauss_points import gauss, simplex_rule
from agglo_core.fields.rules import inside
from agglo_core.fields.values import per_cell, sample
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.space.polynomials import n_polynomials, orders


def moments(mesh: Mesh, boxes: Float, degree: int) -> Float:
    """Integrate polynomials up to a degree over each cell: ``(n, m)``, exact for any shape."""
    if mesh.dim == 3:
        return _solid_moments(mesh, boxes, degree)
    from agglo_polydg_mg.space.legendre_kernels import boundary_moments

    rule = gauss((degree + 3) // 2)  # the antiderivative has a higher degree by one
    points, (offsets, faces), boxes = mesh.local_points, mesh.cell_faces, frozen_float(boxes)
    sides = mesh.face_pairs, mesh.face_cells

    def integrals(start: int, stop: int) -> Float:
        own = offsets[start : stop + 1]
        found: Float = boundary_moments(points, own, faces, *sides, start, boxes[start:stop], *rule, degree)
        return found

    return np.concatenate(over_ranges(integrals, mesh.n_cells, few=COSTLY))


def _solid_moments(mesh: Mesh, boxes: Float, degree: int) -> Float:
    from agglo_polydg_mg.space.solid_kernels import solid_moments

    rule, (offsets, faces) = simplex_rule(2, (degree + 3) // 2), mesh.cell_faces
    boxes, shape = frozen_float(boxes), (mesh.face_offsets, mesh.face_vertices, mesh.face_cells)

    def integrals(start: int, stop: int) -> Float:
        own = mesh.local_points, offsets[start : stop + 1], faces, *shape, start, boxes[start:stop]
        return np.asarray(solid_moments(*own, *rule, orders(degree, 3)))

    return np.concatenate(over_ranges(integrals, mesh.n_cells, few=COSTLY))


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
