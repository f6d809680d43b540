"""Edges of 2-D cells, reconstructed from vertices and neighbours."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


class Edges(NamedTuple):
    """Edges of each 2-D cell as a CSR.

    ``beside (e,)`` is the adjacent cell or −1. ``lines (e, 5)`` are one end (two columns), the vector from
    there to the other end (two), and 1/length², or 0.
    """

    offsets: Any
    beside: Any
    lines: Any


@helper
def _shared_ends(i, j, cells):
    """Find the two farthest vertices that cells i and j share, or −1 twice if they share fewer than two."""
    end_u, end_v, most = np.int32(-1), np.int32(-1), 0.0
    begin, end = cells.offsets[j], cells.offsets[j + 1]
    # Visit all vertex pairs u, v of cell i, v listed before u, that are both vertices of cell j.
    for g in range(cells.offsets[i], cells.offsets[i + 1]):
        u = cells.vertices[g]
        for a in range(begin, end):
            if cells.vertices[a] != u:
                continue
            for f in range(cells.offsets[i], g):
                v = cells.vertices[f]
                for b in range(begin, end):
                    if cells.vertices[b] == v:
                        square = (cells.points[u, 0] - cells.points[v, 0]) ** 2
                        square += (cells.points[u, 1] - cells.points[v, 1]) ** 2
                        if square > most:
                            most, end_u, end_v = square, u, v
    return end_u, end_v


@helper
def _write_line(row, u, v, points, lines):
    """Write the edge between two vertices to a row of ``lines``, and return its length."""
    x, y = points[v, 0] - points[u, 0], points[v, 1] - points[u, 1]
    square = x * x + y * y
    lines[row, 0], lines[row, 1], lines[row, 2], lines[row, 3] = points[u, 0], points[u, 1], x, y
    lines[row, 4] = 1.0 / square if square > 0.0 else 0.0
    return np.sqrt(square)


@helper
def _outer_edges(i, m, ring, cells, pairs, lines, neighbours, n_shared):
    """Write the edges between consecutive corners of a cell that it shares with no other cell.

    ``pairs[:n_shared]`` contain the ends of its shared edges in the first two columns. The third column and
    ``ring`` are workspace. Returns the edge count so far, and the total length of the new edges.
    """
    start, count = cells.offsets[i], cells.offsets[i + 1] - cells.offsets[i]
    # 1. Sort the corners by their angle about the centroid (insertion sort, as they are few).
    for a in range(count):
        v = cells.vertices[start + a]
        angle = np.arctan2(
            cells.points[v, 1] - cells.centroids[i, 1], cells.points[v, 0] - cells.centroids[i, 0]
        )
        b = a
        while b > 0 and ring[b - 1] > angle:
            ring[b], pairs[b, 2] = ring[b - 1], pairs[b - 1, 2]
            b -= 1
        ring[b], pairs[b, 2] = angle, v
    # 2. Write the edge from each corner to the next, unless it is a shared edge.
    length = 0.0
    for a in range(count):
        u, v = np.int32(pairs[a, 2]), np.int32(pairs[(a + 1) % count, 2])
        inner = False
        for b in range(n_shared):
            inner |= pairs[b, 0] == u and pairs[b, 1] == v
            inner |= pairs[b, 0] == v and pairs[b, 1] == u
        if not inner:
            length += _write_line(m, u, v, cells.points, lines)
            neighbours[m] = -1
            m += 1
    return m, length


@kernel
def cell_edges(cells, boundary):
    """Return the edges of 2-D cells, and the relative error of the total outline length.

    Neighbours share the edge between their two farthest common vertices: exact unless the interface is bent.
    The boundary of a cell connects its corners in order about its centroid.
    """
    n, most = len(boundary), 1
    # 1. Allocate for the largest numbers of neighbours and corners per cell, and for all edges.
    for i in range(n):
        most = max(most, cells.indptr[i + 1] - cells.indptr[i], cells.offsets[i + 1] - cells.offsets[i])
    size = len(cells.indices) + len(cells.vertices)
    offsets, neighbours, lines = np.zeros(n + 1, np.int64), np.empty(size, np.int32), np.empty((size, 5))
    pairs, ring = np.empty((most, 3), np.int64), np.empty(most)
    m, error, total = 0, 0.0, 0.0
    for i in range(n):
        # 2. Write one edge for each neighbour with two common vertices.
        length, n_shared = 0.0, 0
        for h in range(cells.indptr[i], cells.indptr[i + 1]):
            j = cells.indices[h]
            u, v = _shared_ends(i, j, cells)
            if u >= 0:
                length += _write_line(m, u, v, cells.points, lines)
                pairs[n_shared, 0], pairs[n_shared, 1], neighbours[m] = u, v, j
                n_shared += 1
                m += 1
        # 3. Write the boundary edges of cells at the domain boundary.
        if boundary[i] > 0.0:
            m, outer = _outer_edges(i, m, ring, cells, pairs, lines, neighbours, n_shared)
            length += outer
        # 4. Error: if all edges are found and straight, their lengths add up to the measure of the cell's
        #    faces.
        error += abs(length - cells.surfaces[i])
        total += cells.surfaces[i]
        offsets[i + 1] = m
    return Edges(offsets, neighbours[:m].copy(), lines[:m].copy()), error / total if total > 0.0 else 1.0
