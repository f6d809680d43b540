"""How wide a part is, becomes when a cell joins it, or has become when one has left it: exact diameters."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.anneal.state import DIAMETER
from agglo_core.compiled.compiling import ONE, helper


@helper
def square_between(u, v, points):
    """Square of the distance of two vertices."""
    x, y = points[u, 0] - points[v, 0], points[u, 1] - points[v, 1]
    z = points[u, 2] - points[v, 2] if points.shape[1] > 2 else 0.0
    return x * x + y * y + z * z  # a loop over two or three takes twice the time


@helper
def _apart(i, j, centroids):
    """Square of the distance of two centroids."""
    x, y = centroids[i, 0] - centroids[j, 0], centroids[i, 1] - centroids[j, 1]
    z = centroids[i, 2] - centroids[j, 2] if centroids.shape[1] > 2 else 0.0
    return x * x + y * y + z * z


@helper
def _listed_vertices(p, cells, parts, work, stamp):
    """List the vertices of part p, each once; how many, and the middle of the box around them."""
    m, last = np.int64(0), cells.points.shape[1] - 1
    x0, x1, y0, y1, z0, z1 = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf
    i = parts.first[p]
    while i >= 0:
        c = np.uint64(i)
        i = parts.after[c]
        if parts.labels[c] != p:  # on its way out
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
    """Diameter of part p and the vertices it is taken between.

    Vertices near the middle of its box, from which none is as far as the widest side, are left out.
    """
    m, middle, span = _listed_vertices(p, cells, parts, work, stamp)
    last, reach = cells.points.shape[1] - 1, 0.0
    for turn in range(2):
        inner = span - np.sqrt(reach)
        inner = inner * inner * (1.0 - 1e-12) if inner > 0.0 and turn == 1 else 0.0
        kept = np.int64(0)
        for k in range(m):
            v = np.uint32(work.found[k])
            x, y = cells.points[v, 0] - middle[0], cells.points[v, 1] - middle[1]
            z = cells.points[v, 2] - middle[2] if last > 1 else 0.0
            square = x * x + y * y + z * z
            reach = max(reach, square)
            work.found[kept] = v
            kept += np.int64(square >= inner)
        m = kept
    most, one, other = 0.0, np.int32(-1), np.int32(-1)
    for k in range(m):
        for j in range(k):
            square = square_between(np.uint32(work.found[k]), np.uint32(work.found[j]), cells.points)
            if square > most:
                most, one, other = square, work.found[k], work.found[j]
    return np.sqrt(most), one, other


@helper
def joined_width(i, q, cells, parts):
    """Diameter of part q together with cell i, and the vertices it is taken between."""
    width, one, other = parts.tally[q, DIAMETER], parts.ends[q, 0], parts.ends[q, 1]
    i, square = np.uint64(i), width * width
    begin, end = np.uint64(cells.offsets[i]), np.uint64(cells.offsets[i + ONE])
    j = np.int64(i) if cells.spans[i] > width else np.int64(parts.first[q])
    own = cells.spans[i] > width
    while j >= 0:
        c = np.uint64(j)
        slack = width - cells.radii[i] - cells.radii[c]
        if slack <= 0.0 or _apart(i, c, cells.centroids) >= slack * slack:
            for g in range(np.uint64(cells.offsets[c]), np.uint64(cells.offsets[c + ONE])):
                u = np.uint32(cells.vertices[g])
                for h in range(begin, end):
                    far = square_between(u, np.uint32(cells.vertices[h]), cells.points)
                    if far > square:
                        square, one, other = far, np.int32(u), cells.vertices[h]
                        width = np.sqrt(far)
        j = np.int64(parts.first[q]) if own else np.int64(parts.after[c])
        own = False
    return width, one, other


@helper
def _still_there(v, p, cells, parts):
    """Whether a cell of part p has the vertex."""
    if v < 0:
        return False
    for g in range(cells.meeting_offsets[v], cells.meeting_offsets[v + 1]):
        if parts.labels[np.uint32(cells.meeting[g])] == p:
            return True
    return False


@helper
def left_width(p, cells, parts, work, stamp):
    """Diameter of part p, which a cell has just left, and the vertices it is taken between."""
    one, other = parts.ends[p, 0], parts.ends[p, 1]
    if _still_there(one, p, cells, parts) and _still_there(other, p, cells, parts):
        return parts.tally[p, DIAMETER], one, other
    return widest(p, cells, parts, work, stamp)
