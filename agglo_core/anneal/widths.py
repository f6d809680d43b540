"""Part diameters while cells move, and the initial arrays of simulated annealing."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.anneal.state import COLUMNS, COUNT, DIAMETER, MEASURE, SURFACE, Parts, Work
from agglo_core.compiled.compiling import ONE, helper, kernel


@helper
def square_between(u, v, points):
    """Return the squared distance between two vertices."""
    x, y = points[u, 0] - points[v, 0], points[u, 1] - points[v, 1]
    z = points[u, 2] - points[v, 2] if points.shape[1] > 2 else 0.0
    return x * x + y * y + z * z  # a loop over the dimensions takes twice the time


@helper
def _apart(i, j, centroids):
    """Return the squared distance between two centroids."""
    x, y = centroids[i, 0] - centroids[j, 0], centroids[i, 1] - centroids[j, 1]
    z = centroids[i, 2] - centroids[j, 2] if centroids.shape[1] > 2 else 0.0
    return x * x + y * y + z * z


@helper
def _list_vertices(p, cells, parts, work, stamp):
    """List the vertices of part p without duplicates.

    Returns their number, the centre of their bounding box, and its longest side.
    """
    m, last = np.int64(0), cells.points.shape[1] - 1
    x0, x1, y0, y1, z0, z1 = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf
    i = parts.first[p]
    while i >= 0:
        c = np.uint64(i)
        i = parts.after[c]
        # A leaving cell is still in the list.
        if parts.labels[c] != p:
            continue
        for g in range(np.uint64(cells.offsets[c]), np.uint64(cells.offsets[c + ONE])):
            v = np.uint32(cells.vertices[g])
            if work.seen[v] == stamp:
                continue
            work.seen[v] = stamp
            work.found[m] = v
            m += 1
            x, y, z = cells.points[v, 0], cells.points[v, 1], cells.points[v, last]
            x0, x1, y0, y1, z0, z1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y), min(z0, z), max(z1, z)
    z0, z1 = (z0, z1) if last > 1 else (0.0, 0.0)
    return m, (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1)), max(x1 - x0, max(y1 - y0, z1 - z0))


@helper
def widest(p, cells, parts, work, stamp):
    """Return the diameter of part p and the two vertices at its ends.

    Vertices near the box centre, whose distances to all others are below the longest side, are skipped.
    """
    m, middle, span = _list_vertices(p, cells, parts, work, stamp)
    last, reach = cells.points.shape[1] - 1, 0.0
    # 1. Two passes over the vertices. The first finds the largest distance R from the centre. The second
    #    drops vertices nearer than (longest side) − R, because no vertex is as far from them as the longest
    #    side.
    for turn in range(2):
        inner = span - np.sqrt(reach)
        inner = inner * inner * (1.0 - 1e-12) if inner > 0.0 and turn == 1 else 0.0
        n_outer = np.int64(0)
        for k in range(m):
            v = np.uint32(work.found[k])
            x, y = cells.points[v, 0] - middle[0], cells.points[v, 1] - middle[1]
            z = cells.points[v, 2] - middle[2] if last > 1 else 0.0
            square = x * x + y * y + z * z
            reach = max(reach, square)
            work.found[n_outer] = v
            n_outer += np.int64(square >= inner)
        m = n_outer
    # 2. Compare all pairs of the remaining vertices.
    most, end_a, end_b = 0.0, np.int32(-1), np.int32(-1)
    for k in range(m):
        for j in range(k):
            square = square_between(np.uint32(work.found[k]), np.uint32(work.found[j]), cells.points)
            if square > most:
                most, end_a, end_b = square, work.found[k], work.found[j]
    return np.sqrt(most), end_a, end_b


@helper
def width_with_cell(i, q, cells, parts):
    """Return the diameter of part q together with cell i, and the two vertices at its ends."""
    width, end_a, end_b = parts.tally[q, DIAMETER], parts.ends[q, 0], parts.ends[q, 1]
    i, square = np.uint64(i), width * width
    begin, end = np.uint64(cells.offsets[i]), np.uint64(cells.offsets[i + ONE])
    # The cell itself comes first if it alone is wider than the part, then each cell in the part. Vertices are
    # compared only if centroids and radii allow a larger width.
    j = np.int64(i) if cells.spans[i] > width else np.int64(parts.first[q])
    is_cell_i = cells.spans[i] > width
    while j >= 0:
        c = np.uint64(j)
        slack = width - cells.radii[i] - cells.radii[c]
        if slack <= 0.0 or _apart(i, c, cells.centroids) >= slack * slack:
            for g in range(np.uint64(cells.offsets[c]), np.uint64(cells.offsets[c + ONE])):
                u = np.uint32(cells.vertices[g])
                for h in range(begin, end):
                    vertex_square = square_between(u, np.uint32(cells.vertices[h]), cells.points)
                    if vertex_square > square:
                        square, end_a, end_b = vertex_square, np.int32(u), cells.vertices[h]
                        width = np.sqrt(vertex_square)
        j = np.int64(parts.first[q]) if is_cell_i else np.int64(parts.after[c])
        is_cell_i = False
    return width, end_a, end_b


@helper
def _still_there(v, p, cells, parts):
    """Return True if a cell in part p has the vertex."""
    if v < 0:
        return False
    for g in range(cells.meeting_offsets[v], cells.meeting_offsets[v + 1]):
        if parts.labels[np.uint32(cells.meeting[g])] == p:
            return True
    return False


@helper
def width_without_cell(p, cells, parts, work, stamp):
    """Return the diameter of part p after a cell left, and the two vertices at its ends.

    The diameter is recomputed only if an end is gone.
    """
    one, other = parts.ends[p, 0], parts.ends[p, 1]
    if _still_there(one, p, cells, parts) and _still_there(other, p, cells, parts):
        return parts.tally[p, DIAMETER], one, other
    return widest(p, cells, parts, work, stamp)


@kernel
def cell_surroundings(indptr, interface, boundary, centroids, offsets, vertices, points):
    """Return face measure, radius and diameter per cell, and the cells at each vertex (CSR).

    The radius is the largest vertex distance from the centroid. The CSR consists of its offsets, then the
    cells.
    """
    n, solid = len(boundary), points.shape[1] > 2
    surfaces, radii, spans = np.empty(n), np.zeros(n), np.zeros(n)
    starts, cells = np.zeros(len(points) + 1, np.int64), np.empty(len(vertices), np.int32)
    for i in range(n):
        # 1. Faces at the boundary and with neighbours, radius and diameter from the vertices, and cell counts
        #    per vertex.
        surfaces[i] = boundary[i]
        for h in range(indptr[i], indptr[i + 1]):
            surfaces[i] += interface[h]
        for g in range(offsets[i], offsets[i + 1]):
            v = vertices[g]
            starts[v + 1] += 1
            x, y = points[v, 0] - centroids[i, 0], points[v, 1] - centroids[i, 1]
            z = points[v, 2] - centroids[i, 2] if solid else 0.0
            radii[i] = max(radii[i], np.sqrt(x * x + y * y + z * z))
            for h in range(offsets[i], g):
                square = square_between(np.uint32(v), np.uint32(vertices[h]), points)
                spans[i] = max(spans[i], np.sqrt(square))
    # 2. Counting sort of the cells by vertex. Counts are shifted by one. Filling from behind, with the cells
    #    in reverse, leaves the start of vertex v in ``starts[v + 1]``.
    for v in range(len(points)):
        starts[v + 1] += starts[v]
    for i in range(n - 1, -1, -1):
        for g in range(offsets[i], offsets[i + 1]):
            starts[vertices[g] + 1] -= 1
            cells[starts[vertices[g] + 1]] = i
    # 3. Shift back to CSR offsets.
    for v in range(len(points)):
        starts[v] = starts[v + 1]
    starts[len(points)] = len(vertices)
    return surfaces, radii, spans, starts, cells


@kernel
def part_state(cells, labels, count):
    """Set up the arrays of the parts ``0..count−1``: sums, diameters and lists, and the workspace."""
    n, points = len(labels), len(cells.points)
    part_labels, tally, ends = (
        np.empty(n, np.int32),
        np.zeros((count, COLUMNS)),
        np.full((count, 2), -1, np.int32),
    )
    first, after, before = np.full(count, -1, np.int32), np.empty(n, np.int32), np.full(n, -1, np.int32)
    # 1. Cell lists and sums. Faces within a part do not belong to its surface: each is subtracted from both
    #    sides.
    for i in range(n - 1, -1, -1):
        p = labels[i]
        part_labels[i], after[i] = p, first[p]
        if first[p] >= 0:
            before[first[p]] = i
        first[p] = i
        tally[p, MEASURE] += cells.measures[i]
        tally[p, SURFACE] += cells.surfaces[i]
        tally[p, COUNT] += 1.0
        for h in range(cells.indptr[i], cells.indptr[i + 1]):
            if labels[cells.indices[h]] == p:
                tally[p, SURFACE] -= cells.interface[h]
    parts = Parts(part_labels, tally, ends, first, after, before)
    marks, seen = np.full((n, 2), -1, np.int64), np.full(points, -1, np.int64)
    work = Work(
        np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), marks, seen, np.empty(points + 1, np.int32)
    )
    # 2. Diameters, with negative marks, because searches only use other marks.
    for p in range(count):
        tally[p, DIAMETER], ends[p, 0], ends[p, 1] = widest(p, cells, parts, work, -2 - p)
    return parts, work
