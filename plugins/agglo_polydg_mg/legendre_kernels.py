"""Legendre polynomials in kernels, and integrals of polynomials over cells.

Polynomials are products L_i(x̂) L_j(ŷ) of orthonormal Legendre polynomials on the bounding box of a
cell, a box being its centre and half sides (cx, cy, hx, hy). They are numbered by total degree:
(0,0), (1,0), (0,1), (2,0), (1,1), (0,2), …
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import kernel

__all__ = ["boundary_moments", "legendre_at", "point_moments", "roots_up_to", "slopes_of"]


@kernel
def roots_up_to(degree):
    """Inverse norms √(k + 1/2) of the Legendre polynomials P_0, …, P_degree on [−1, 1]."""
    return np.sqrt(np.arange(degree + 1) + 0.5)


@kernel
def legendre_at(x, degree, roots, out):
    """Orthonormal Legendre polynomials 0..degree at x, with the ``roots`` of :func:`roots_up_to`."""
    out[0] = roots[0]
    if degree == 0:
        return
    out[1] = x * roots[1]
    before, value = 1.0, x
    for k in range(1, degree):
        before, value = value, ((2 * k + 1) * x * value - k * before) / (k + 1)
        out[k + 1] = value * roots[k + 1]


@kernel
def slopes_of(values, degree, roots, out):
    """Derivatives of the polynomials ``values``: P'_{k+1} = P'_{k-1} + (2k + 1) P_k, normalised."""
    out[0] = 0.0
    for k in range(degree):
        below = out[k - 1] / roots[k - 1] if k > 1 else 0.0
        out[k + 1] = (below + 2.0 * roots[k] * values[k]) * roots[k + 1]


@kernel
def boundary_moments(points, offsets, faces, face_vertices, face_cells, boxes, nodes, weights, degree):
    """Integrals ``(n, m)`` of the polynomials of a degree over each cell, by the divergence theorem.

    L_i has the antiderivative (P_{i+1} − P_{i−1}) / (2i + 1) times its normalisation; ``nodes`` must
    integrate degree + 1 on [−1, 1].
    """
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    roots = roots_up_to(degree + 1)
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
                legendre_at(ax + s * (bx - ax), degree + 1, roots, lx)
                legendre_at(ay + s * (by - ay), degree, roots, ly)
                for i in range(degree + 1):
                    below = lx[i - 1] / roots[i - 1] if i > 0 else 0.0
                    value = (lx[i + 1] / roots[i + 1] - below) / (2.0 * roots[i])
                    primitive[i] = rise * weights[q] * value
                for j in range(degree + 1):
                    for i in range(degree + 1 - j):
                        moments[c, ((i + j) * (i + j + 1)) // 2 + j] += primitive[i] * ly[j]
    return moments


@kernel
def point_moments(points, values, offsets, boxes, degree):
    """Sums ``(n, m)`` of values times polynomials over each cell's points ``offsets[c]:offsets[c + 1]``."""
    n = len(offsets) - 1
    moments = np.zeros((n, (degree + 1) * (degree + 2) // 2))
    roots, lx, ly = roots_up_to(degree), np.empty(degree + 1), np.empty(degree + 1)
    for c in range(n):
        for q in range(offsets[c], offsets[c + 1]):
            legendre_at((points[q, 0] - boxes[c, 0]) / boxes[c, 2], degree, roots, lx)
            legendre_at((points[q, 1] - boxes[c, 1]) / boxes[c, 3], degree, roots, ly)
            k = 0
            for total in range(degree + 1):
                for j in range(total + 1):
                    moments[c, k] += values[q] * lx[total - j] * ly[j]
                    k += 1
    return moments
