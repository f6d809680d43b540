"""Compute geometry and neighbours of 2-D cells in one pass over their half-edges.

The caller allocates the largest arrays with numpy, which requests huge pages; numba does not, and filling its
arrays takes twice as long.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel

# half-edges whose points are fetched together (32 KiB), so that cache misses overlap (benchmarks/building.py)
_ROOM = 1024
# edges per cell up to which neighbours are compared one by one; above, by a table (benchmarks/threads.py)
_SHORT = 16


@kernel
def half_edges(face_vertices, face_cells, places, edges):
    """Write (tail, head, opposite cell, ownership flag) of each cell's edges, in face order.

    The next entry of cell c is written to ``edges[places[c]]``, and ``places[c]`` is incremented. If
    ``edges`` is empty, entries are only counted.
    """
    count_only = len(edges) == 0
    for f in range(len(face_cells)):
        for s in range(2):
            c = face_cells[f, s]
            if c >= 0:
                h = places[c]
                places[c] = h + 1
                if not count_only:
                    edges[h, 0], edges[h, 1] = face_vertices[f, s], face_vertices[f, 1 - s]
                    edges[h, 2], edges[h, 3] = face_cells[f, 1 - s], 1 - s


@kernel
def _moments(ends, owns_first, start, stop):
    """Return area and centroid of a cell by the divergence theorem.

    ``ends[start:stop]`` are (tail x, y, head x, y) of its edges, counter-clockwise. Coordinates are relative
    to a vertex of the cell, so that small cells far from 0 lose no digits: the tail of the first edge if the
    cell owns it (``owns_first``), else the head, which is then the first vertex of that face.
    """
    side = 0 if owns_first else 2
    x0, y0 = ends[start, side], ends[start, side + 1]
    a, mx, my = 0.0, 0.0, 0.0
    for i in range(start, stop):
        px, py = ends[i, 0] - x0, ends[i, 1] - y0
        qx, qy = ends[i, 2] - x0, ends[i, 3] - y0
        cross = px * qy - qx * py
        a += cross
        mx += (px + qx) * cross
        my += (py + qy) * cross
    return 0.5 * a, x0 + mx / (3.0 * a), y0 + my / (3.0 * a)


@kernel
def plane_cells(
    points, offsets, edges, n_cells, area, centroid, boundary, sizes, vertices, indices, interface
):
    """Compute moments, vertices and neighbours of cells with half-edges ``edges[offsets[c]:offsets[c + 1]]``.

    Writes area, centroid, boundary length and neighbour count per cell, and consecutively for all cells
    their vertices, neighbours (``indices``) and shared lengths (``interface``), with parallel faces summed.
    Returns the total neighbour count. ``edges`` come from :func:`half_edges`.
    """
    n, start_of_all = len(offsets) - 1, offsets[0]
    most = 0
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    ends = np.empty((max(_ROOM, most), 4))
    slot = np.full(n_cells if most > _SHORT else 0, -1, np.int64)  # position of a neighbour in a long row
    first, last, m = 0, 0, 0
    for c in range(n):
        # 1. Fetch the edge ends of as many cells as fit; ``vertices`` are the tails.
        if c == last:
            first = last
            while last < n and offsets[last + 1] - offsets[first] <= len(ends):
                last += 1
            for h in range(offsets[first], offsets[last]):
                i, tail, head = h - offsets[first], edges[h, 0], edges[h, 1]
                ends[i, 0], ends[i, 1] = points[tail, 0], points[tail, 1]
                ends[i, 2], ends[i, 3] = points[head, 0], points[head, 1]
                vertices[h - start_of_all] = tail
        # 2. Moments from the fetched ends.
        start, stop = offsets[c] - offsets[first], offsets[c + 1] - offsets[first]
        area[c], centroid[c, 0], centroid[c, 1] = _moments(ends, edges[offsets[c], 3], start, stop)
        # 3. Add lengths to the domain boundary or to the neighbour, at its position in the row if it has one.
        #    ``slot`` is never cleared, because positions in earlier rows are below ``row``.
        boundary[c] = 0.0
        row = m
        for i in range(start, stop):
            j = edges[offsets[first] + i, 2]
            dx, dy = ends[i, 2] - ends[i, 0], ends[i, 3] - ends[i, 1]
            length = np.sqrt(dx * dx + dy * dy)
            if j < 0:
                boundary[c] += length
                continue
            place = -1
            if stop - start > _SHORT:
                place = slot[j] if slot[j] >= row else -1
                slot[j] = m if place < 0 else place
            else:
                for k in range(row, m):
                    place = k if indices[k] == j else place
            if place >= 0:
                interface[place] += length
            else:
                indices[m], interface[m] = j, length
                m += 1
        sizes[c] = m - row
    return m


@kernel
def inertias(start, stop, points, face_pairs, face_cells, offsets, faces, centroids):
    """Return ∫ |x − C|² of the cells start..stop − 1 about their centroids C.

    The triangle C, a, b of an edge, with a and b relative to C, has a × b (a² + a·b + b²) / 12.
    """
    found = np.zeros(stop - start)
    for c in range(start, stop):
        x0, y0, total = centroids[c, 0], centroids[c, 1], 0.0
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            p, q = face_pairs[f, 0], face_pairs[f, 1]
            ax, ay, bx, by = points[p, 0] - x0, points[p, 1] - y0, points[q, 0] - x0, points[q, 1] - y0
            squares = ax * ax + ay * ay + ax * bx + ay * by + bx * bx + by * by
            cross = ax * by - ay * bx
            total += (cross if face_cells[f, 0] == c else -cross) * squares
        found[c - start] = total / 12.0
    return found
