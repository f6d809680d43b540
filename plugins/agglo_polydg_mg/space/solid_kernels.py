"""Compiled kernels for polyhedra: polynomial integrals, and heights over faces.

Polynomials are products L_i(x̂) L_j(ŷ) L_k(ẑ) of orthonormal Legendre polynomials on a cell's bounding box,
given by its centre and its half sides; ``orders (m, 3)`` are i, j, k. Faces are fans of triangles.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import legendre_at, recurrences

_FLAT = 1e-9
"""A vertex lies beyond a face if its distance exceeds this fraction of the cell height there.

A smaller value mistakes rounding for a dent, a larger value accepts slightly dented cells as convex.
"""


@helper
def in_box(point, box, axis):
    """Return the coordinate of a point along a box axis, −1..1 inside."""
    return (point[axis] - box[axis]) / box[3 + axis]


@helper
def cross(a, b, c):
    """Return (b − a) × (c − a), a normal of the triangle abc as long as twice its area."""
    return (
        (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1]),
        (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2]),
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]),
    )


@helper
def oriented_triangle(a, b, c, vector):
    """Return :func:`cross` and twice the area, negative if the triangle is reversed relative to ``vector``.

    In the fan of a nonconvex face triangles overlap and must cancel.
    """
    x, y, z = cross(a, b, c)
    size = np.sqrt(x * x + y * y + z * z)
    if x * vector[0] + y * vector[1] + z * vector[2] < 0.0:
        size = -size
    return x, y, z, size


@helper
def _primitives(lx, upper, degree, primitives):
    """Compute the antiderivatives of Legendre polynomials 0..degree from their values up to degree + 1."""
    primitives[0] = lx[1] * upper[0]
    for i in range(1, degree + 1):
        primitives[i] = lx[i + 1] * upper[i] - lx[i - 1] * upper[i - 1]


@helper
def _add_triangle(box, a, b, c, turned, rule, weights, orders, degree, table, lines, integrals):
    """Add ∫ X n_x over the triangle abc to ``integrals (m,)``, with the polynomials' antiderivatives X in x.

    ``turned`` is True if the triangle is clockwise seen from outside the cell.
    """
    upper, lx, ly, lz, primitive = lines[0], lines[1], lines[2], lines[3], lines[4]
    # 1. n_x times twice the area. Triangles parallel to x add nothing.
    across = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    if across == 0.0:
        return
    factor = -across * box[3] if turned else across * box[3]
    # 2. Corner a and the sides to b and c in box coordinates; at each point X_i L_j L_k. Weights sum to
    # 1/2, and dx = hx dx̂ in the antiderivatives.
    ax, ay, az = in_box(a, box, 0), in_box(a, box, 1), in_box(a, box, 2)
    bx, by, bz = in_box(b, box, 0) - ax, in_box(b, box, 1) - ay, in_box(b, box, 2) - az
    cx, cy, cz = in_box(c, box, 0) - ax, in_box(c, box, 1) - ay, in_box(c, box, 2) - az
    for q in range(len(weights)):
        s, t = rule[q, 0], rule[q, 1]
        legendre_at(ax + s * bx + t * cx, degree + 1, table, lx)
        legendre_at(ay + s * by + t * cy, degree, table, ly)
        legendre_at(az + s * bz + t * cz, degree, table, lz)
        _primitives(lx, upper, degree, primitive)
        weight = factor * weights[q]
        for k in range(len(orders)):
            integrals[k] += weight * primitive[orders[k, 0]] * ly[orders[k, 1]] * lz[orders[k, 2]]


@kernel
def solid_moments(
    points, offsets, faces, face_offsets, face_vertices, face_cells, first_cell, boxes, rule, weights, orders,
):  # fmt: skip
    """Integrate polynomials over cells from ``first_cell`` on by the divergence theorem, ``(n, m)``.

    ∫_K φ = ∮ Φ n_x with an antiderivative Φ in x, over the fans of all faces: exact for any cell shape.
    ``rule (q, 2)`` and ``weights`` must integrate one degree more on the triangle (0,0) (1,0) (0,1).
    """
    n, degree = len(offsets) - 1, orders[len(orders) - 1, 2]
    moments, table, lines = np.zeros((n, len(orders))), recurrences(degree + 1), np.empty((5, degree + 2))
    # Reciprocals 1 / d_k for the antiderivatives
    for k in range(degree + 1):
        lines[0, k] = 1.0 / table[3, k]
    for c in range(n):
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            turned, first = face_cells[f, 0] != first_cell + c, face_offsets[f]
            # Fan about the first vertex of the face
            a = points[face_vertices[first]]
            for k in range(first + 1, face_offsets[f + 1] - 1):
                _add_triangle(
                    boxes[c], a, points[face_vertices[k]], points[face_vertices[k + 1]], turned, rule,
                    weights, orders, degree, table, lines, moments[c],
                )  # fmt: skip
    return moments


@kernel
def solid_point_moments(points, values, offsets, boxes, orders):
    """Sum values times polynomials over each cell's points: ``(n, m)``.

    Cell c has the points ``offsets[c]:offsets[c + 1]``.
    """
    n, degree = len(offsets) - 1, orders[len(orders) - 1, 2]
    moments, table = np.zeros((n, len(orders))), recurrences(degree)
    lx, ly, lz = np.empty(degree + 1), np.empty(degree + 1), np.empty(degree + 1)
    for c in range(n):
        for q in range(offsets[c], offsets[c + 1]):
            legendre_at(in_box(points[q], boxes[c], 0), degree, table, lx)
            legendre_at(in_box(points[q], boxes[c], 1), degree, table, ly)
            legendre_at(in_box(points[q], boxes[c], 2), degree, table, lz)
            for k in range(len(orders)):
                moments[c, k] += values[q] * lx[orders[k, 0]] * ly[orders[k, 1]] * lz[orders[k, 2]]
    return moments


@kernel
def farthest_vertices(
    points, offsets, faces, starts, vertices, face_cells, normals, centres, first_cell, heights
):  # fmt: skip
    """Compute the ``heights (F, 2)`` of the cells from ``first_cell`` on over each of their faces.

    It is the largest distance of a vertex from the face plane, for owner and neighbour. ``normals (F, 3)``
    are unit normals outward from the owners, ``centres (F, 3)`` face points; cell c has the vertices
    ``vertices[starts[c]:starts[c + 1]]``. The result ``(n,)`` is True for convex cells: no vertex lies
    beyond a face. Faces with area 0 are skipped.
    """
    n = len(offsets) - 1
    convex = np.ones(n, np.bool_)
    for c in range(n):
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            side = 0 if face_cells[f, 0] == first_cell + c else 1
            inward, most, least = 2.0 * side - 1.0, 0.0, 0.0
            x, y, z = inward * normals[f, 0], inward * normals[f, 1], inward * normals[f, 2]
            if x == 0.0 and y == 0.0 and z == 0.0:
                continue
            # Distances from the face plane into the cell; negative distances are beyond the face.
            for k in range(starts[c], starts[c + 1]):
                p = points[vertices[k]]
                distance = (
                    x * (p[0] - centres[f, 0]) + y * (p[1] - centres[f, 1]) + z * (p[2] - centres[f, 2])
                )
                most, least = max(most, distance), min(least, distance)
            # Relative to the height, otherwise rounding would turn flat faces into dents.
            heights[f, side] = most
            if -least > _FLAT * most:
                convex[c] = False
    return convex
