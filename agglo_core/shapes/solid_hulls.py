"""Convex hulls of agglomerates in space."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# A larger value leaves more points out of the hull, a smaller one lets rounding make faces.
_TINY = 1e-12  # of the extent: points that are no further outside a plane are on it


@helper
def _height(planes, f, points, p):
    """Signed distance of a point from the plane of a face."""
    x, y, z = points[p, 0], points[p, 1], points[p, 2]
    return planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z - planes[f, 3]


@helper
def _set_face(f, a, b, c, points, corners, planes, head):
    """Make f the face abc, counter-clockwise from outside, with no points outside of it yet."""
    corners[f, 0], corners[f, 1], corners[f, 2] = a, b, c
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scale = 1.0 / max(np.sqrt(x * x + y * y + z * z), 1e-300)
    planes[f, 0], planes[f, 1], planes[f, 2] = x * scale, y * scale, z * scale
    planes[f, 3] = 0.0
    planes[f, 3] = _height(planes, f, points, a)
    head[f] = -1


@helper
def _farthest(points, m, a, ux, uy, uz, across):
    """The point farthest from a along the unit vector u, in either direction, or (``across``) from that line.

    Returns the square of its distance, and the point. With u = 0 and ``across`` it is the distance from a.
    """
    best, found = -1.0, 0
    for p in range(m):
        x, y, z = points[p, 0] - points[a, 0], points[p, 1] - points[a, 1], points[p, 2] - points[a, 2]
        along = x * ux + y * uy + z * uz
        square = x * x + y * y + z * z - along * along if across else along * along
        if square > best:
            best, found = square, p
    return best, found


@helper
def _first_four(points, m, corners, planes, beside, head):
    """Write a tetrahedron of points far from each other as the first four faces.

    Returns False if all points are in one plane.
    """
    # 1. a far from the first point, b from a, c from the line ab, d from the plane abc.
    a = _farthest(points, m, 0, 0.0, 0.0, 0.0, True)[1]
    square, b = _farthest(points, m, a, 0.0, 0.0, 0.0, True)
    scale = 1.0 / max(np.sqrt(square), 1e-300)
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    c = _farthest(points, m, a, ux * scale, uy * scale, uz * scale, True)[1]
    _set_face(0, a, b, c, points, corners, planes, head)
    height, d = _farthest(points, m, a, planes[0, 0], planes[0, 1], planes[0, 2], False)
    if not height > square * _TINY * _TINY:
        return False
    # 2. Turn abc so that d is below it; then all four faces look outwards. ``beside[f, k]`` is the face
    #    across the side from corner k to corner k + 1.
    if _height(planes, 0, points, d) > 0.0:
        b, c = c, b
        _set_face(0, a, b, c, points, corners, planes, head)
    _set_face(1, a, d, b, points, corners, planes, head)
    _set_face(2, b, d, c, points, corners, planes, head)
    _set_face(3, c, d, a, points, corners, planes, head)
    beside[0, 0], beside[0, 1], beside[0, 2] = 1, 2, 3
    beside[1, 0], beside[1, 1], beside[1, 2] = 3, 2, 0
    beside[2, 0], beside[2, 1], beside[2, 2] = 1, 3, 0
    beside[3, 0], beside[3, 1], beside[3, 2] = 2, 1, 0
    return True


@helper
def _hand_on(p, first, last, order, tiny, points, planes, head, following):
    """Put point p on the list of the first of the faces ``order[first:last]`` that it is outside of.

    A point inside all of them is in the hull, and on no list.
    """
    for k in range(first, last):
        f = order[k]
        if _height(planes, f, points, p) > tiny:
            following[p], head[f] = head[f], p
            return


@helper
def _grow(f, tiny, points, corners, planes, beside, head, following, state, order, free, start):
    """Join the farthest of the points outside face f to the hull.

    ``state[r]``: 0 a face, 1 one that the point sees, -1 a free row; its last entry counts the free rows, a
    stack in ``free``. Lists of points begin with ``head`` of a face and go on with ``following`` of a point.
    Writes to ``order`` the faces that the point saw, then the new ones, and returns how many both are; -1
    if there are not enough rows.
    """
    # 1. The farthest point p outside f.
    p, best, q = head[f], -1.0, head[f]
    while q >= 0:
        height = _height(planes, f, points, q)
        if height > best:
            best, p = height, q
        q = following[q]
    # 2. All faces that p is outside of, from neighbour to neighbour: those that it sees.
    seen, k = 1, 0
    order[0], state[f] = f, 1
    while k < seen:
        for side in range(3):
            g = beside[order[k], side]
            if state[g] == 0 and _height(planes, g, points, p) > tiny:
                state[g], order[seen] = 1, g
                seen += 1
        k += 1
    # 3. The horizon: edges between a face that p sees and one that it does not. Each needs a row.
    made, left = seen, state[len(state) - 1]
    edges = 0
    for k in range(seen):
        for side in range(3):
            edges += state[beside[order[k], side]] == 0
    if edges > left:
        return -1
    # 4. A new face from each edge of the horizon to p. It takes the place of the old face beside the face g
    #    across that edge, and is noted in ``start`` at the corner where the edge begins.
    for k in range(seen):
        for side in range(3):
            g = beside[order[k], side]
            if state[g] == 1:
                continue
            a, b = corners[order[k], side], corners[order[k], (side + 1) % 3]
            left -= 1
            new = free[left]
            _set_face(new, a, b, p, points, corners, planes, head)
            beside[new, 0], state[new], start[a] = g, 0, new
            for other in range(3):
                if corners[g, other] == b and beside[g, other] == order[k]:
                    beside[g, other] = new
            order[made] = new
            made += 1
    # 5. New faces beside one another: the horizon is one loop, so one of them begins where another ends.
    for k in range(seen, made):
        new, after = order[k], start[corners[order[k], 1]]
        beside[new, 1], beside[after, 2] = after, new
    # 6. Points outside the old faces go to new ones, or are inside the hull; rows of old faces become free.
    for k in range(seen):
        old = order[k]
        q = head[old]
        while q >= 0:
            rest = following[q]
            if q != p:
                _hand_on(q, seen, made, order, tiny, points, planes, head, following)
            q = rest
        state[old], free[left] = -1, old
        left += 1
    state[len(state) - 1] = left
    return made


@helper
def _hull(m, points, corners, planes, beside, head, following, state, order, free, start):
    """Hull of ``points[:m]``: its faces are the rows below the number returned whose ``state`` is 0.

    Returns 0 if all points are in one plane, -1 if rounding led to more faces than there is room for.
    """
    # 1. All rows are free, the lowest on top of the stack; the first tetrahedron takes four.
    rows = 6 * m + 8
    for r in range(rows):
        state[r], free[r] = -1, rows - 1 - r
    if not _first_four(points, m, corners, planes, beside, head):
        return 0
    # 2. Each point goes to a face that it is outside of. Coordinates are relative to one of the points, so
    #    the largest of them measures the extent.
    extent = 0.0
    for p in range(m):
        for k in range(3):
            extent = max(extent, abs(points[p, k]))
    tiny = _TINY * extent
    for k in range(4):
        state[k], order[k] = 0, k
    state[len(state) - 1], used = rows - 4, 4
    for p in range(m):
        _hand_on(p, 0, 4, order, tiny, points, planes, head, following)
    # 3. Grow the hull while there is a point outside a face. New faces may take rows that this pass has left
    #    behind: hence the passes.
    again = True
    while again:
        again = False
        for f in range(rows):
            if f >= used:
                break
            if state[f] == 0 and head[f] >= 0:
                made = _grow(
                    f, tiny, points, corners, planes, beside, head, following, state, order, free, start
                )
                if made < 0:
                    return -1
                for k in range(made):
                    used = max(used, order[k] + 1)
                again = True
    return used


@kernel
def solid_hulls(points, offsets, vertices):
    """Convex hulls of cells by Quickhull (Barber, Dobkin and Huhdanpaa 1996).

    Cell c has the distinct vertices ``vertices[offsets[c]:offsets[c + 1]]``.

    Returns
    -------
    volume : (n,) float
        0 if all vertices are in one plane, and -1 if rounding led to a surface that is none.
    ends : (n + 1,) int
        The hull of cell c has the triangles ``ends[c]:ends[c + 1]``.
    triangles : (t, 3) int
        Vertices, counter-clockwise as seen from outside.
    neighbours : (t, 3) int
        Neighbour k, a row of the same array, has corners k and k + 1 of the triangle as well.
    """
    n, most = len(offsets) - 1, np.int64(4)
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    rows = 6 * most + 8
    near, following, start = np.empty((most, 3)), np.empty(most, np.int64), np.empty(most, np.int64)
    corners, beside, planes = (
        np.empty((rows, 3), np.int64),
        np.empty((rows, 3), np.int64),
        np.empty((rows, 4)),
    )
    head, order, free = np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows, np.int64)
    state = np.empty(rows + 1, np.int64)
    volume, ends = np.zeros(n), np.zeros(n + 1, np.int64)
    room = 2 * len(vertices)
    triangles, neighbours = np.empty((room, 3), np.int32), np.empty((room, 3), np.int32)
    top = np.int64(0)
    for c in range(n):
        # 1. The hull of the vertices, relative to the first of them so that cells far out lose no digits.
        first, m = offsets[c], offsets[c + 1] - offsets[c]
        for i in range(m):
            for k in range(3):
                near[i, k] = points[vertices[first + i], k] - points[vertices[first], k]
        used = _hull(m, near, corners, planes, beside, head, following, state, order, free, start)
        # 2. Number its faces in the arrays returned. A closed surface of triangles on m points has at most
        #    2m - 4 of them; more are not a hull.
        faces = 0
        for f in range(used):
            if state[f] == 0:
                order[f] = top + faces
                faces += 1
        if used < 0 or faces > 2 * m - 4:
            volume[c], faces, used = -1.0, 0, 0
        # 3. Add the signed volumes of the tetrahedra from the first vertex to each face, and copy the faces.
        for f in range(used):
            if state[f] != 0:
                continue
            i, j, k = corners[f, 0], corners[f, 1], corners[f, 2]
            x, y, z = near[i, 0], near[i, 1], near[i, 2]
            cross = near[j, 1] * near[k, 2] - near[j, 2] * near[k, 1]
            volume[c] += x * cross / 6.0
            cross = near[j, 2] * near[k, 0] - near[j, 0] * near[k, 2]
            volume[c] += y * cross / 6.0
            cross = near[j, 0] * near[k, 1] - near[j, 1] * near[k, 0]
            volume[c] += z * cross / 6.0
            for side in range(3):
                triangles[order[f], side] = vertices[first + corners[f, side]]
                neighbours[order[f], side] = order[beside[f, side]]
        top += faces
        ends[c + 1] = top
    return volume, ends, triangles[:top].copy(), neighbours[:top].copy()
