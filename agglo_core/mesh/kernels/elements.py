"""Compare the faces of cells with VTK's 3-D elements."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _place(corners, v):
    """Return the index of vertex v among the corners, or −1."""
    for k in range(len(corners)):
        if corners[k] == v:
            return k
    return -1


@helper
def _vertex_after(loop_offsets, vertices, first, last, a, b):
    """Return the vertex after the edge from a to b in the face of a cell that has this edge, or −1."""
    for loop in range(first, last):
        start, stop = loop_offsets[loop], loop_offsets[loop + 1]
        for h in range(start, stop):
            if vertices[h] == a and vertices[h + 1 if h + 1 < stop else start] == b:
                h += 2
                return vertices[h if h < stop else h - stop + start]
    return -1


@kernel
def match_elements(cells, cell_offsets, loop_offsets, vertices, base_size, walk, following, corners):
    """Write the ``corners (n, k)`` of cells that are elements, and return the mask of these cells.

    The faces of a cell are loops, counter-clockwise from outside. An edge from corner a to corner b of the
    element is followed by ``following[a, b]`` in its face, or −1 if there is no such edge. The corners
    ``walk`` are those of its first face, with ``base_size`` vertices, and then for each edge of this face the
    corner beyond its first end, in the face on the other side.
    """
    fits = np.zeros(len(cells), np.bool_)
    for i in range(len(cells)):
        first, last = cell_offsets[cells[i]], cell_offsets[cells[i] + 1]
        # 1. Number the corners along the first face with as many vertices, and across its edges.
        base = first
        while base < last and loop_offsets[base + 1] - loop_offsets[base] != base_size:
            base += 1
        if base == last:
            continue
        start = loop_offsets[base]
        for k in range(base_size):
            a, b = vertices[start + k], vertices[start + (k + 1) % base_size]
            corners[i, walk[k]] = a
            corners[i, walk[base_size + k]] = _vertex_after(loop_offsets, vertices, first, last, b, a)
        # 2. Each edge must be an edge of the element, once, and be followed by the same corner.
        seen, is_equal = np.uint64(0), True
        for loop in range(first, last):
            start, stop = loop_offsets[loop], loop_offsets[loop + 1]
            a, b = _place(corners[i], vertices[stop - 2]), _place(corners[i], vertices[stop - 1])
            for h in range(start, stop):
                c = _place(corners[i], vertices[h])
                edge = np.uint64(1) << np.uint64(max(a, 0) * 8 + max(b, 0))
                is_equal &= min(a, b, c) >= 0 and following[a, b] == c and seen & edge == np.uint64(0)
                seen |= edge
                a, b = b, c
        fits[i] = is_equal
    return fits


@kernel
def first_corners(cells, offsets, faces, face_offsets, face_vertices, corners, first, second):
    """Write the corners (n, F) that begin each face of each cell, as indices into its ``corners``."""
    for i in range(len(cells)):
        for k in range(first.shape[1]):
            h = face_offsets[faces[offsets[cells[i]] + k]]
            first[i, k] = _place(corners[i], face_vertices[h])
            second[i, k] = _place(corners[i], face_vertices[h + 1])
