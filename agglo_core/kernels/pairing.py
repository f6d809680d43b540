"""Half-edges of plane cells paired into faces, where every edge has one cell or two that fit.

``match_half_edges`` says what is wrong elsewhere. Here the half-edges are first moved to buckets of
points that fit a cache. The largest arrays are the caller's: see :mod:`agglo_core.kernels.plane_cells`.
"""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["number_faces", "pair_half_edges"]

_BITS = 11  # points of a bucket, as a power of two


@helper(allocates=True)
def _to_buckets(offsets, vertices, n_points, edges):
    """Write (lower end, upper end, half-edge, cell), sorted by buckets of lower ends; where they end.

    The upper end is ~upper where the half-edge starts there.
    """
    ends = np.zeros(((n_points - 1) >> _BITS) + 2, np.int64)
    c = 0
    for h in range(len(vertices)):
        c += h == offsets[c + 1]  # no loop over cells: its end would be mispredicted
        a, b = vertices[h], vertices[h + 1 if h + 1 < offsets[c + 1] else offsets[c]]
        ends[(min(a, b) >> _BITS) + 1] += 1
    for k in range(len(ends) - 1):
        ends[k + 1] += ends[k]
    c = 0
    for h in range(len(vertices)):
        c += h == offsets[c + 1]
        a, b = vertices[h], vertices[h + 1 if h + 1 < offsets[c + 1] else offsets[c]]
        low, high = min(a, b), max(a, b)
        i = ends[low >> _BITS]
        ends[low >> _BITS] = i + 1
        edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3] = low, high if a == low else ~high, h, c
    return ends[:-1]


@kernel
def pair_half_edges(offsets, vertices, n_points, edges, beyond):
    """Write the cell beyond each half-edge of counter-clockwise cells: −1 outside, −2 at the later of two.

    ``edges (n, 4)`` is room to work in. Returns the number of faces, or −1 if an edge has more than two
    cells, two on the same side, or one cell on both sides; what is written is then of no use.
    """
    stops = _to_buckets(offsets, vertices, n_points, edges)
    most, start = 0, 0
    for stop in stops:
        most, start = max(most, stop - start), stop
    head, link = np.empty(1 << _BITS, np.int32), np.empty(most, np.int32)
    n_faces, start = len(vertices), 0
    for k in range(len(stops)):
        for v in range(len(head)):
            head[v] = -1
        for i in range(start, stops[k]):
            low, key = edges[i, 0] - (k << _BITS), edges[i, 1]
            j = head[low]
            while j >= 0 and edges[j, 1] != key and edges[j, 1] != ~key:
                j = link[j - start]
            if j < 0:
                beyond[edges[i, 2]] = -1
                link[i - start] = head[low]
                head[low] = i
            elif edges[j, 1] == ~key and beyond[edges[j, 2]] == -1 and edges[j, 3] != edges[i, 3]:
                beyond[edges[j, 2]], beyond[edges[i, 2]] = edges[i, 3], -2
                n_faces -= 1
            else:
                return -1
        start = stops[k]
    return n_faces


@kernel
def number_faces(offsets, vertices, beyond, face_vertices, face_cells):
    """Write the vertices and cells of the faces, in the order in which the cells meet them."""
    f, c = 0, 0
    for h in range(len(vertices)):
        c += h == offsets[c + 1]
        if f < len(face_cells):  # what is no face is written, too, and then overwritten
            face_vertices[f, 0] = vertices[h]
            face_vertices[f, 1] = vertices[h + 1 if h + 1 < offsets[c + 1] else offsets[c]]
            face_cells[f, 0], face_cells[f, 1] = c, beyond[h]
        f += beyond[h] >= -1
