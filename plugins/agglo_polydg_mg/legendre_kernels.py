"""Legendre polynomials in kernels, and integrals of polynomials over cells.

Polynomials are products L_i(x̂) L_j(ŷ) of orthonormal Legendre polynomials on the bounding box of a
cell, a box being its centre and half sides (cx, cy, hx, hy). They are numbered by total degree:
(0,0), (1,0), (0,1), (2,0), (1,1), (0,2), …
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel

__all__ = ["boundary_moments", "legendre_at", "point_moments", "recurrence", "slopes_of"]


@kernel
def recurrence(degree):
    """Factors ``(6, degree + 1)`` of the orthonormal Legendre polynomials L_k = √(k + 1/2) P_k.

    With column k: L_{k+1} = a x L_k − b L_{k−1}, L'_{k+1} = α L'_{k−1} + β L_k, and u L_{k+1} − v L_{k−1} is
    an antiderivative of L_k; no divisions are left to the loops over points.
    """
    factors = np.zeros((6, degree + 1))
    for k in range(degree + 1):
        below, here, above = np.sqrt(max(k - 0.5, 0.5)), np.sqrt(k + 0.5), np.sqrt(k + 1.5)
        factors[0, k] = above * (2 * k + 1) / ((k + 1) * here)
        factors[3, k] = 2.0 * here * above
        factors[4, k] = 0.5 / (here * above)
        if k > 0:
            factors[1, k] = above * k / ((k + 1) * below)
            factors[2, k] = above / below
            factors[5, k] = 0.5 / (here * below)
    return factors


@kernel
def legendre_at(x, degree, factors, out):
    """Orthonormal Legendre polynomials 0..degree at x, with the factors of :func:`recurrence`."""
    before, value = 0.0, np.sqrt(0.5)
    out[0] = value
    for k in range(degree):
        before, value = value, factors[0, k] * x * value - factors[1, k] * before
        out[k + 1] = value


@kernel
def slopes_of(values, degree, factors, out):
    """Derivatives of the polynomials ``values``, with the factors of :func:`recurrence`."""
    before, slope = 0.0, 0.0
    out[0] = slope
    for k in range(degree):
        before, slope = slope, factors[2, k] * before + factors[3, k] * values[k]
        out[k + 1] = slope


@kernel
def boundary_moments(points, offsets, faces, face_vertices, face_cells, boxes, nodes, weights, degree):
    """Integrals ``(n, m)`` of the polynomials of a degree over each cell, by the divergence theorem.

    L_i has the antiderivative (P_{i+1} − P_{i−1}) / (2i + 1) times its normalisation; ``nodes`` must
    integrate degree + 1 on [−1, 1].
    """
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    factors = recurrence(degree + 1)
    lx, ly, primitive = np.empty(degree + 2), np.empty(degree + 2), np.empty(degree + 1)
    for c in range(n):
        cx, cy, hx, hy = boxes[c, 0], boxes[c, 1], boxes[c, 2], boxes[c, 3]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            flip = 0 if face_cells[f, 0] == c else 1
            a, b = face_vertices[f, flip], face_vertices[f, 1 - flip]
            ax, ay = (points[a, 0] - cx) / hx, (points[a, 1] - cy) / hy
            bx, by = (points[b, 0] - cx) / hx, (points[b, 1] - cy) / hy
            if ay == by:
                continue
            rise = 0.5 * (by - ay) * hx * hy
            for q in range(len(nodes)):
                s = 0.5 * (1.0 + nodes[q])
                legendre_at(ax + s * (bx - ax), degree + 1, factors, lx)
                legendre_at(ay + s * (by - ay), degree, factors, ly)
                for i in range(degree + 1):
                    below = factors[5, i] * lx[i - 1] if i > 0 else 0.0
                    primitive[i] = factors[4, i] * lx[i + 1] - below
                for j in range(degree + 1):
                    weight = rise * weights[q] * ly[j]
                    for i in range(degree + 1 - j):
                        moments[c, ((i + j) * (i + j + 1)) // 2 + j] += weight * primitive[i]
    return moments


@kernel
def point_moments(points, values, offsets, boxes, degree):
    """Sums ``(n, m)`` of values times polynomials over each cell's points ``offsets[c]:offsets[c + 1]``."""
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    factors, lx, ly = recurrence(degree), np.empty(degree + 1), np.empty(degree + 1)
    for c in range(n):
        for q in range(offsets[c], offsets[c + 1]):
            legendre_at((points[q, 0] - boxes[c, 0]) / boxes[c, 2], degree, factors, lx)
            legendre_at((points[q, 1] - boxes[c, 1]) / boxes[c, 3], degree, factors, ly)
            k = 0
            for total in range(degree + 1):
                for j in range(total + 1):
                    moments[c, k] += values[q] * lx[total - j] * ly[j]
                    k += 1
    return moments
