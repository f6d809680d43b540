"""Sum areas and vertex hashes over the faces of 2-D cells, to check that cells are closed."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# increment and multipliers of SplitMix64
_STEP, _MIX, _LAST = (np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)  # shifts of SplitMix64


@helper
def _random_number(vertex):
    """Return a pseudo-random hash of a vertex index, as :func:`agglo_core.arrays.splitmix`."""
    z = np.uint64(vertex) + _STEP
    z = (z ^ (z >> _SHIFT_1)) * _MIX
    z = (z ^ (z >> _SHIFT_2)) * _LAST
    return z ^ (z >> _SHIFT_3)


@kernel
def add_faces(points, face_vertices, face_cells, gap, area):
    """Add the faces of a 2-D mesh to the sums of their cells, and return the bounding box.

    Parameters
    ----------
    points : (n_points, 2) float
    face_vertices : (2 * n_faces,) int
    face_cells : (n_faces, 2) int
    gap : (n_cells,) uint64
        Output: sum of head hashes minus tail hashes along the boundary, modulo 2^64; 0 if closed.
    area : (n_cells, 2) float
        Output: twice the area, and the sum of the absolute values of its terms.

    Returns
    -------
    low_x, low_y, high_x, high_y : float
        Relative to the first vertex.
    """
    x0, y0 = points[face_vertices[0], 0], points[face_vertices[0], 1]
    low_x, low_y, high_x, high_y = 0.0, 0.0, 0.0, 0.0
    for f in range(len(face_cells)):
        # Ends of the face, relative to the first vertex, so that meshes far from 0 lose no digits.
        tail, head = np.uint64(face_vertices[2 * f]), np.uint64(face_vertices[2 * f + 1])
        px, py = points[tail, 0] - x0, points[tail, 1] - y0
        qx, qy = points[head, 0] - x0, points[head, 1] - y0
        # Extend the box.
        low_x, low_y = min(low_x, px, qx), min(low_y, py, qy)
        high_x, high_y = max(high_x, px, qx), max(high_y, py, qy)
        # Terms of the closed-boundary test and of the shoelace formula.
        step = _random_number(head) - _random_number(tail)
        positive, negative = px * qy, qx * py
        cross, magnitude = positive - negative, abs(positive) + abs(negative)
        # The face is counter-clockwise for the owner; the neighbour traverses it from head to tail.
        owner, neighbour = np.uint64(face_cells[f, 0]), face_cells[f, 1]
        gap[owner] += step
        area[owner, 0] += cross
        area[owner, 1] += magnitude
        if neighbour >= 0:
            adjacent = np.uint64(neighbour)
            gap[adjacent] -= step
            area[adjacent, 0] -= cross
            area[adjacent, 1] += magnitude
    return low_x, low_y, high_x, high_y
