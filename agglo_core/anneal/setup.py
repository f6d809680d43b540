"""What annealing starts from: the surroundings of cells, and the sums and lists of parts."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.anneal.state import COLUMNS, COUNT, DIAMETER, MEASURE, SURFACE, Parts, Work
from agglo_core.anneal.widths import square_between, widest
from agglo_core.compiled.compiling import kernel


@kernel
def cell_surroundings(indptr, interface, boundary, centroids, offsets, vertices, points):
    """Measure of the faces of each cell, radius about its centroid, diameter; cells at each vertex (CSR)."""
    n, solid = len(boundary), points.shape[1] > 2
    surfaces, radii, spans = np.empty(n), np.zeros(n), np.zeros(n)
    starts, cells = np.zeros(len(points) + 1, np.int64), np.empty(len(vertices), np.int32)
    for i in range(n):
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
    for v in range(len(points)):
        starts[v + 1] += starts[v]
    for i in range(n - 1, -1, -1):
        for g in range(offsets[i], offsets[i + 1]):
            starts[vertices[g] + 1] -= 1
            cells[starts[vertices[g] + 1]] = i
    for v in range(len(points)):
        starts[v] = starts[v + 1]
    starts[len(points)] = len(vertices)
    return surfaces, radii, spans, starts, cells


@kernel
def part_state(given, labels, count):
    """Parts ``0..count−1`` of the cells, with their sums and lists, and room for searches."""
    n, points = len(labels), len(given.points)
    own, tally, ends = np.empty(n, np.int32), np.zeros((count, COLUMNS)), np.full((count, 2), -1, np.int32)
    first, after, before = np.full(count, -1, np.int32), np.empty(n, np.int32), np.full(n, -1, np.int32)
    for i in range(n - 1, -1, -1):
        p = labels[i]
        own[i], after[i] = p, first[p]
        if first[p] >= 0:
            before[first[p]] = i
        first[p] = i
        tally[p, MEASURE] += given.measures[i]
        tally[p, SURFACE] += given.surfaces[i]
        tally[p, COUNT] += 1.0
        for h in range(given.indptr[i], given.indptr[i + 1]):
            if labels[given.indices[h]] == p:
                tally[p, SURFACE] -= given.interface[h]
    parts = Parts(own, tally, ends, first, after, before)
    marks, seen = np.full((n, 2), -1, np.int64), np.full(points, -1, np.int64)
    room = Work(
        np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), marks, seen, np.empty(points + 1, np.int32)
    )
    for p in range(count):
        tally[p, DIAMETER], ends[p, 0], ends[p, 1] = widest(p, given, parts, room, -2 - p)
    return parts, room
