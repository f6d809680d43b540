"""Compiled kernels for Legendre polynomials and for polynomial integrals over polygons.

Polynomials are products L_i(x̂) L_j(ŷ) of orthonormal Legendre polynomials on a cell's bounding box. A
box consists of its centre, its half sides and the direction of the first (cx, cy, hx, hy, c, s).
Polynomials are numbered by total degree: (0,0), (1,0), (0,1), (2,0), (1,1), (0,2), …
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel

LANES = 64
"""Number of cells or faces per batch: the last array index, so that inner loops fill vector registers.

Fewer leave registers unused or loops short, more need workspace that exceeds the caches
(benchmarks/assembly.py).
"""
CONSTANT = np.sqrt(0.5)
"""The Legendre polynomial with degree 0."""


@helper(allocates=True)
def recurrences(degree):
    """Return the recurrence coefficients a, b, c, d ``(4, degree)`` of Legendre polynomials up to a degree.

    For L_k = √(k + 1/2) P_k on [−1, 1] they are L_{k+1} = a_k x L_k − b_k L_{k−1} and L'_{k+1} = c_k
    L'_{k−1} + d_k L_k, from P'_{k+1} = P'_{k−1} + (2k + 1) P_k; L_k has the antiderivative L_{k+1} /
    d_k − L_{k−1} / d_{k−1}.
    """
    table = np.zeros((4, degree))
    for k in range(degree):
        table[3, k] = np.sqrt((2.0 * k + 1.0) * (2.0 * k + 3.0))
        table[0, k] = table[3, k] / (k + 1)
        if k > 0:
            table[2, k] = np.sqrt((2.0 * k + 3.0) / (2.0 * k - 1.0))
            table[1, k] = table[2, k] * k / (k + 1)
    return table


@helper
def legendre_at(x, degree, table, values):
    """Write orthonormal Legendre polynomials 0..degree at x to ``values``, by the :func:`recurrences`."""
    before, value = 0.0, CONSTANT
    values[0] = value
    for k in range(degree):
        before, value = value, table[0, k] * x * value - table[1, k] * before
        values[k + 1] = value


@helper
def slopes_of(values, table, slopes):
    """Write the derivatives of the :func:`legendre_at` polynomials to ``slopes`` from their ``values``."""
    before, slope = 0.0, 0.0
    slopes[0] = 0.0
    for k in range(table.shape[1]):
        before, slope = slope, table[2, k] * before + table[3, k] * values[k]
        slopes[k + 1] = slope


@helper
def along_box(x, y, box):
    """Return a vector's components along the sides of a box."""
    return box[4] * x + box[5] * y, box[4] * y - box[5] * x


@helper
def _fit_box(points, first, last, faces, face_vertices, box):
    """Fit a cell's bounding box in the direction of ``box``: write its centre and half sides.

    The cell has the faces ``faces[first:last]``.
    """
    x_min, y_min, x_max, y_max = np.inf, np.inf, -np.inf, -np.inf
    for h in range(first, last):
        for k in range(2):
            v = face_vertices[faces[h], k]
            x, y = along_box(points[v, 0], points[v, 1], box)
            x_min, y_min, x_max, y_max = min(x_min, x), min(y_min, y), max(x_max, x), max(y_max, y)
    x, y = 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)
    box[0], box[1] = box[4] * x - box[5] * y, box[5] * x + box[4] * y
    box[2], box[3] = 0.5 * (x_max - x_min), 0.5 * (y_max - y_min)


@kernel
def bounding_boxes(points, offsets, faces, face_vertices, areas, least):
    """Return each cell's bounding box ``(n, 6)``, rotated for some thin cells.

    Sides are parallel to the axes unless the cell fills less than the fraction ``least`` of that box: then
    they follow the face with the smallest box, if it is less than half as large. On a diagonal sliver the
    polynomials would be linearly dependent up to a power of its width.
    """
    boxes, trial = np.empty((len(offsets) - 1, 6)), np.empty(6)
    for c in range(len(boxes)):
        box, first, last = boxes[c], offsets[c], offsets[c + 1]
        # 1. The box along the axes, sufficient for most cells.
        box[4], box[5] = 1.0, 0.0
        _fit_box(points, first, last, faces, face_vertices, box)
        if areas[c] >= least * 4.0 * box[2] * box[3]:
            continue
        # 2. Thin cells: boxes along each face. The smallest replaces the first if it is less than half as
        # large. Flat boxes are excluded, because coordinates are divided by the half sides.
        smallest = 0.5 * box[2] * box[3]
        for h in range(first, last):
            a, b = face_vertices[faces[h], 0], face_vertices[faces[h], 1]
            x, y = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            length = np.sqrt(x * x + y * y)
            if not length > 0.0:
                continue
            trial[4], trial[5] = x / length, y / length
            _fit_box(points, first, last, faces, face_vertices, trial)
            if 0.0 < trial[2] * trial[3] < smallest:
                smallest = trial[2] * trial[3]
                for k in range(6):
                    box[k] = trial[k]
    return boxes


@kernel
def boundary_moments(
    points, offsets, faces, face_vertices, face_cells, first_cell, boxes, nodes, weights, degree
):  # fmt: skip
    """Integrate polynomials up to a degree over the cells from ``first_cell`` on: ``(n, m)``.

    By the divergence theorem, ∫_K L_i(x̂) L_j(ŷ) = ∮ X_i(x̂) L_j(ŷ) dy with the antiderivative X_i of L_i
    in x, exactly for any cell shape; ``nodes`` must integrate degree + 1 on [−1, 1].
    """
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    table = recurrences(degree + 1)
    lx, ly, upper = np.empty(degree + 2), np.empty(degree + 1), 1.0 / table[3]
    for c in range(n):
        box = boxes[c]
        cx, cy, hx, hy = box[0], box[1], box[2], box[3]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            # 1. The edge anticlockwise about the cell, in box coordinates −1..1. Edges along x̂ have dy =
            # 0.
            flip = 0 if face_cells[f, 0] == first_cell + c else 1
            a, b = face_vertices[f, flip], face_vertices[f, 1 - flip]
            ax, ay = along_box(points[a, 0] - cx, points[a, 1] - cy, box)
            bx, by = along_box(points[b, 0] - cx, points[b, 1] - cy, box)
            ax, ay, bx, by = ax / hx, ay / hy, bx / hx, by / hy
            if ay == by:
                continue
            rise = 0.5 * (by - ay) * hx * hy
            # 2. X_i = hx (L_{i+1} / d_i − L_{i−1} / d_{i−1}) at the Gauss points of the edge, times dy; k is
            #    the number of the polynomial (i, j).
            for q in range(len(nodes)):
                s, weight = 0.5 * (1.0 + nodes[q]), rise * weights[q]
                legendre_at(ax + s * (bx - ax), degree + 1, table, lx)
                legendre_at(ay + s * (by - ay), degree, table, ly)
                for i in range(degree + 1):
                    primitive = weight * lx[i + 1] * upper[i]
                    if i > 0:
                        primitive -= weight * lx[i - 1] * upper[i - 1]
                    k = (i * (i + 1)) // 2
                    for j in range(degree + 1 - i):
                        moments[c, k] += primitive * ly[j]
                        k += i + j + 2
    return moments


@kernel
def point_moments(points, values, offsets, boxes, degree):
    """Sum values times polynomials over each cell's points: ``(n, m)``.

    Cell c has the points ``offsets[c]:offsets[c + 1]``.
    """
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    table, lx, ly = recurrences(degree), np.empty(degree + 1), np.empty(degree + 1)
    for c in range(n):
        for q in range(offsets[c], offsets[c + 1]):
            # Accumulate by total degree
            x, y = along_box(points[q, 0] - boxes[c, 0], points[q, 1] - boxes[c, 1], boxes[c])
            legendre_at(x / boxes[c, 2], degree, table, lx)
            legendre_at(y / boxes[c, 3], degree, table, ly)
            k = 0
            for total in range(degree + 1):
                for j in range(total + 1):
                    moments[c, k] += values[q] * lx[total - j] * ly[j]
                    k += 1
    return moments


@kernel
def sparse_products(integrals, places, columns, factors, blocks):
    """Add Σ_t factors[t] integrals[c, columns[t]] to the entries ``places (t, 2)`` of symmetric blocks.

    The places are sorted and refer to the lower halves of ``blocks (n, m, m)``.
    """
    # Terms for one place are contiguous: they are added up, and written after the last term.
    for c in range(len(blocks)):
        block, cell_integrals, value = blocks[c], integrals[c], 0.0
        for t in range(len(columns)):
            i, j = places[t, 0], places[t, 1]
            value += factors[t] * cell_integrals[columns[t]]
            if t + 1 == len(columns) or places[t + 1, 0] != i or places[t + 1, 1] != j:
                block[i, j] += value
                if i != j:
                    block[j, i] += value
                value = 0.0
