"""Kernels of the continuous space on polyhedra: fit cell polynomials to surface traces."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.auxiliary.conforming_kernels import solve_rows
from agglo_polydg_mg.space.legendre_kernels import CONSTANT, legendre_at, recurrences
from agglo_polydg_mg.space.solid_kernels import cross, in_box


@helper
def _place(unknown, indices, position, count):
    """Return an unknown's index in a cell's list, or the length ``count`` if it is absent."""
    for i in range(count):
        if indices[position + i] == unknown:
            return i
    return count


@helper
def _polynomials(x, y, z, orders, table, lines, values):
    """Evaluate the unscaled basis polynomials at a point in [−1, 1]³, and write them to ``values``."""
    degree = table.shape[1]
    legendre_at(x, degree, table, lines[0])
    legendre_at(y, degree, table, lines[1])
    legendre_at(z, degree, table, lines[2])
    for k in range(len(orders)):
        values[k] = lines[0, orders[k, 0]] * lines[1, orders[k, 1]] * lines[2, orders[k, 2]]


@helper
def _corners(points, face_vertices, first, last, box, ring):
    """Write a face's corners in box coordinates to ``ring``, and their mean to the next row."""
    count = last - first
    ring[count] = 0.0
    for k in range(count):
        for d in range(3):
            ring[k, d] = in_box(points[face_vertices[first + k]], box, d)
            ring[count, d] += ring[k, d] / count


@helper
def _list_face(numbers, edges, first, sides, indices, position, count, right, place):
    """Write each face unknown's position in the cell to ``place``, and return the cell's number of unknowns.

    Vertices precede edges; −1 marks an edge without unknown. Faces share vertices and edges, so unknowns are
    looked up before they are added.
    """
    for k in range(2 * sides):
        unknown = numbers[first + k] if k < sides else edges[first + k - sides]
        place[k] = -1
        if unknown >= 0:
            place[k] = _place(unknown, indices, position, count)
            if place[k] == count:
                indices[position + count] = unknown
                right[count, :] = 0.0
                count += 1
    return count


@helper
def _traces_at(r, s, t, k, sides, share):
    """Write the value of each trace function of a face to ``share``, at a point of its triangle k.

    ``r``, ``s`` and ``t`` are the barycentric coordinates at the centre, at corner k and at the next corner.
    At the centre the trace is the mean: 1 / sides for each vertex.
    """
    for i in range(2 * sides):
        share[i] = r / sides if i < sides and sides > 3 else 0.0
    share[k] += s
    share[(k + 1) % sides] += t
    if sides == 3:
        share[2] += r
        share[3], share[4], share[5] = 4.0 * s * t, 4.0 * t * r, 4.0 * r * s


@kernel
def fit_solid_traces(
    points, offsets, faces, face_offsets, face_vertices, numbers, edges, boxes, scale, orders, rule, weights,
    regularisation, max_rows, most,
):  # fmt: skip
    """Fit a polynomial q_u on each cell to the surface trace of each unknown's basis function.

    Returns each cell's unknowns, as offsets ``(n_cells + 1,)`` and indices, and the coefficients ``(·,
    n)`` of each q_u. The fit minimises ∫ (q − trace)² ds over the cell surface, after mapping the bounding
    box to a cube, plus ``regularisation`` times the squares of total degree times coefficient, from degree
    2 on.

    A face is cut into triangles around the mean of its corners. The trace is linear on these triangles,
    with the mean corner value at the centre; a triangular face stays uncut. Vertex
    ``face_vertices[k]`` has the unknown ``numbers[k]``, the edge from there to the next vertex of the face
    ``edges[k]``, if nonnegative: the bubble 4 λ_a λ_b, on triangles. ``rule (q, 2)`` and ``weights (q,)``
    are a rule on the triangle. ``max_rows`` bounds the row count, ``most`` the number of
    unknowns of a cell or face.
    """
    n, table = len(orders), recurrences(orders[len(orders) - 1, 2])
    counts, indices = np.zeros(len(offsets), np.int64), np.empty(max_rows, np.int32)
    fitted, lines = np.empty((max_rows, n)), np.empty((3, table.shape[1] + 1))
    normal, right, values = np.empty((n, n)), np.empty((most, n)), np.empty(n)
    ring, place, share = np.empty((most, 3)), np.empty(most, np.int64), np.empty(most)
    position = 0
    for c in range(len(offsets) - 1):
        normal[:] = 0.0
        count = 0
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            first, last = face_offsets[f], face_offsets[f + 1]
            sides = last - first
            # 1. Corners of the face, and positions of its unknowns in the cell.
            _corners(points, face_vertices, first, last, boxes[c], ring)
            count = _list_face(numbers, edges, first, sides, indices, position, count, right, place)
            # 2. Quadrature over the triangles (centre, corner k, next corner) in the coordinates of the cube.
            #    The centre of a triangular face is its last corner.
            for k in range(1 if sides == 3 else sides):
                after = (k + 1) % sides
                centre = ring[2] if sides == 3 else ring[sides]
                x, y, z = cross(centre, ring[k], ring[after])
                size = np.sqrt(x * x + y * y + z * z)
                for q in range(len(weights)):
                    s, t = rule[q, 0], rule[q, 1]
                    r = 1.0 - s - t
                    _polynomials(
                        r * centre[0] + s * ring[k, 0] + t * ring[after, 0],
                        r * centre[1] + s * ring[k, 1] + t * ring[after, 1],
                        r * centre[2] + s * ring[k, 2] + t * ring[after, 2],
                        orders, table, lines, values,
                    )  # fmt: skip
                    _traces_at(r, s, t, k, sides, share)
                    # Add w p pᵀ to N, lower half, and w p times each trace function to its right-hand side.
                    for i in range(n):
                        weighted = size * weights[q] * values[i]
                        for j in range(i + 1):
                            normal[i, j] += weighted * values[j]
                        for j in range(2 * sides):
                            if place[j] >= 0:
                                right[place[j], i] += weighted * share[j]
        # 3. The regularisation limits polynomials that vanish on the surface; degrees 0 and 1 are exempt.
        for k in range(n):
            total = orders[k, 0] + orders[k, 1] + orders[k, 2]
            normal[k, k] += regularisation * total * total if total > 1 else 0.0
        # 4. Solve for all unknowns of the cell, and convert to coefficients of its scaled polynomials.
        solve_rows(normal, right, n, count)
        for i in range(count):
            for j in range(n):
                fitted[position + i, j] = right[i, j] / scale[c]
        position += count
        counts[c + 1] = position
    return counts, indices[:position].copy(), fitted[:position].copy()


@kernel
def fit_corners(points, offsets, vertices, boxes, scale):
    """Fit a linear polynomial on each cell to the basis function of each corner by least squares.

    Returns the unknowns ``(v,)`` of ``vertices``, numbered by first cell, the coefficients ``(v, 4)`` and
    the number of unknowns. If the trace is linear, or the cell a box, the result equals
    :func:`fit_solid_traces`.
    """
    numbers, count = np.full(len(points), -1), 0
    unknowns, fitted = np.empty(len(vertices), np.int32), np.empty((len(vertices), 4))
    normal, slope = np.empty((4, 4)), np.sqrt(3.0) * CONSTANT**3
    for c in range(len(offsets) - 1):
        first, last = offsets[c], offsets[c + 1]
        # 1. p(x_k) at each corner k: the basis √½³ (1, √3 x̂, √3 ŷ, √3 ẑ), and N = Σ_k p(x_k) p(x_k)ᵀ. As the
        #    function of corner k is 1 there and 0 at the others, p(x_k) is its right-hand side too.
        normal[:] = 0.0
        for k in range(first, last):
            v = vertices[k]
            if numbers[v] < 0:
                numbers[v] = count
                count += 1
            unknowns[k], fitted[k, 0] = numbers[v], CONSTANT**3
            for d in range(3):
                fitted[k, 1 + d] = slope * in_box(points[v], boxes[c], d)
            for i in range(4):
                for j in range(i + 1):
                    normal[i, j] += fitted[k, i] * fitted[k, j]
        # 2. N c_k = p(x_k) for all corners, in place.
        solve_rows(normal, fitted[first:last], 4, last - first)
        for k in range(first, last):
            for i in range(4):
                fitted[k, i] /= scale[c]
    return unknowns, fitted, count
