"""Measures, centroids and diameters."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels import kernel

__all__ = ["block_diameters", "polygon_moments"]


@kernel
def polygon_moments(points, offsets, faces, face_vertices, face_cells):
    """Area and centroid of each 2-D cell by the divergence theorem over its faces.

    Coordinates are taken relative to a vertex of the cell, so small cells far out lose no digits.
    """
    n = len(offsets) - 1
    area = np.empty(n)
    centroid = np.empty((n, 2))
    for c in range(n):
        v = face_vertices[faces[offsets[c]], 0]
        x0, y0 = points[v, 0], points[v, 1]
        a, mx, my = 0.0, 0.0, 0.0
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            flip = 0 if face_cells[f, 0] == c else 1
            p, q = face_vertices[f, flip], face_vertices[f, 1 - flip]
            px, py = points[p, 0] - x0, points[p, 1] - y0
            qx, qy = points[q, 0] - x0, points[q, 1] - y0
            cross = px * qy - qx * py
            a += cross
            mx += (px + qx) * cross
            my += (py + qy) * cross
        area[c] = 0.5 * a
        centroid[c, 0] = x0 + mx / (3.0 * a)
        centroid[c, 1] = y0 + my / (3.0 * a)
    return area, centroid


@kernel
def block_diameters(block_offsets, cells, vertex_offsets, vertices, points):
    """Exact largest vertex distance of each block; block b owns ``cells[offsets[b]:offsets[b + 1]]``.

    A farthest pair must lie outside the ball where distance to the centre is below
    (lower bound) − (largest distance to the centre); only those few vertices are compared.
    """
    n_blocks = len(block_offsets) - 1
    d = points.shape[1]
    result = np.zeros(n_blocks)
    stamp = np.full(len(points), -1, np.int64)
    low, high, centre = np.empty(d), np.empty(d), np.empty(d)
    unique = np.empty(64, np.int64)
    for b in range(n_blocks):
        # distinct vertices of the block, and their bounding box
        m = 0
        for k in range(d):
            low[k], high[k] = np.inf, -np.inf
        for i in range(block_offsets[b], block_offsets[b + 1]):
            for h in range(vertex_offsets[cells[i]], vertex_offsets[cells[i] + 1]):
                v = vertices[h]
                if stamp[v] != b:
                    stamp[v] = b
                    if m == len(unique):
                        grown = np.empty(2 * m, np.int64)
                        for k in range(m):  # numba takes seconds longer to compile slice copies
                            grown[k] = unique[k]
                        unique = grown
                    unique[m] = v
                    m += 1
                    for k in range(d):
                        low[k] = min(low[k], points[v, k])
                        high[k] = max(high[k], points[v, k])
        for k in range(d):
            centre[k] = 0.5 * (low[k] + high[k])
        far = m
        if m > 12:
            # lower bound: from the vertex farthest from the centre to the one farthest from it
            reach, p = -1.0, unique[0]
            for i in range(m):
                s = 0.0
                for k in range(d):
                    s += (points[unique[i], k] - centre[k]) ** 2
                if s > reach:
                    reach, p = s, unique[i]
            bound = 0.0
            for _ in range(3):
                best, q = -1.0, p
                for i in range(m):
                    s = 0.0
                    for k in range(d):
                        s += (points[unique[i], k] - points[p, k]) ** 2
                    if s > best:
                        best, q = s, unique[i]
                if best <= bound:
                    break
                bound, p = best, q
            inner = np.sqrt(bound) - np.sqrt(reach)
            inner = inner * inner * (1.0 - 1e-12) if inner > 0.0 else 0.0
            far = 0
            for i in range(m):
                s = 0.0
                for k in range(d):
                    s += (points[unique[i], k] - centre[k]) ** 2
                if s >= inner:
                    unique[far], unique[i] = unique[i], unique[far]
                    far += 1
            result[b] = bound
        for i in range(far):
            for j in range(i):
                s = 0.0
                for k in range(d):
                    s += (points[unique[i], k] - points[unique[j], k]) ** 2
                result[b] = max(result[b], s)
        result[b] = np.sqrt(result[b])
    return result
