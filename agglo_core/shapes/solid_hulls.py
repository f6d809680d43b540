"""Convex hulls of 3-D agglomerates."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# Relative to the extent: points within this distance outside a plane count as on it. A larger value leaves
# more points out of the hull, with a smaller value rounding creates faces.
_TINY = 1e-12


@helper
def _height(planes, f, points, p):
    """Return the signed distance from the plane of face f to point p."""
    x, y, z = points[p, 0], points[p, 1], points[p, 2]
    return planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z - planes[f, 3]


@helper
def _set_face(f, a, b, c, points, corners, planes, head):
    """Set face f to the triangle abc, counter-clockwise from outside, with no points assigned to it."""
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
    """Find the point farthest from a along the unit vector u, or (``across``) from the line along u.

    Along u, both directions count. Returns the squared distance, and the point. With u = 0 and ``across``
    this is the distance from a.
    """
    best, best_p = -1.0, 0
    for p in range(m):
        x, y, z = points[p, 0] - points[a, 0], points[p, 1] - points[a, 1], points[p, 2] - points[a, 2]
        along = x * ux + y * uy + z * uz
        square = x * x + y * y + z * z - along * along if across else along * along
        if square > best:
            best, best_p = square, p
    return best, best_p


@helper
def _first_four(points, m, corners, planes, links, head):
    """Write a tetrahedron of distant points: the initial faces of the hull.

    Returns False if all points are coplanar.
    """
    # 1. Choose a far from the first point, b far from a, c far from the line ab, d far from the plane abc.
    a = _farthest(points, m, 0, 0.0, 0.0, 0.0, True)[1]
    square, b = _farthest(points, m, a, 0.0, 0.0, 0.0, True)
    scale = 1.0 / max(np.sqrt(square), 1e-300)
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    c = _farthest(points, m, a, ux * scale, uy * scale, uz * scale, True)[1]
    _set_face(0, a, b, c, points, corners, planes, head)
    height, d = _farthest(points, m, a, planes[0, 0], planes[0, 1], planes[0, 2], False)
    if not height > square * _TINY * _TINY:
        return False
    # 2. Orient abc so that d is below it. Then all four faces point outward. ``links[f, k]`` is the face
    #    across the side from corner k to corner k + 1.
    if _height(planes, 0, points, d) > 0.0:
        b, c = c, b
        _set_face(0, a, b, c, points, corners, planes, head)
    _set_face(1, a, d, b, points, corners, planes, head)
    _set_face(2, b, d, c, points, corners, planes, head)
    _set_face(3, c, d, a, points, corners, planes, head)
    links[0, 0], links[0, 1], links[0, 2] = 1, 2, 3
    links[1, 0], links[1, 1], links[1, 2] = 3, 2, 0
    links[2, 0], links[2, 1], links[2, 2] = 1, 3, 0
    links[3, 0], links[3, 1], links[3, 2] = 2, 1, 0
    return True


@helper
def _hand_on(p, first, last, order, tiny, points, planes, head, following):
    """Assign point p to the first face in ``order[first:last]`` that has p on its outer side.

    A point inside all faces is in the hull, and on no list.
    """
    for k in range(first, last):
        f = order[k]
        if _height(planes, f, points, p) > tiny:
            following[p], head[f] = head[f], p
            return


@helper
def _grow(f, tiny, points, corners, planes, links, head, following, state, order, free, start):
    """Add the farthest point outside face f to the hull, and replace the faces that it sees.

    ``state[r]`` is 0 for a face, 1 for a face that the point sees, -1 for a free row. Its last entry counts
    the free rows, which are a stack in ``free``. Lists of points begin with ``head`` of a face and continue
    with ``following`` of a point. Writes the visible faces, then the new faces, to ``order``, and returns the
    number of both, or -1 if there are not enough rows.
    """
    # 1. Find the farthest point p outside f.
    p, best, q = head[f], -1.0, head[f]
    while q >= 0:
        height = _height(planes, f, points, q)
        if height > best:
            best, p = height, q
        q = following[q]
    # 2. Collect the visible faces, with p outside, from neighbour to neighbour.
    n_visible, k = 1, 0
    order[0], state[f] = f, 1
    while k < n_visible:
        for side in range(3):
            g = links[order[k], side]
            if state[g] == 0 and _height(planes, g, points, p) > tiny:
                state[g], order[n_visible] = 1, g
                n_visible += 1
        k += 1
    # 3. Count the horizon edges, between a visible and a hidden face. Each edge needs a row.
    n_listed, n_free = n_visible, state[len(state) - 1]
    edges = 0
    for k in range(n_visible):
        for side in range(3):
            edges += state[links[order[k], side]] == 0
    if edges > n_free:
        return -1
    # 4. Create a new face from each horizon edge to p. It replaces the old face next to face g across that
    #    edge, and is recorded in ``start`` at the first corner of the edge.
    for k in range(n_visible):
        for side in range(3):
            g = links[order[k], side]
            if state[g] == 1:
                continue
            a, b = corners[order[k], side], corners[order[k], (side + 1) % 3]
            n_free -= 1
            new = free[n_free]
            _set_face(new, a, b, p, points, corners, planes, head)
            links[new, 0], state[new], start[a] = g, 0, new
            for s in range(3):
                if corners[g, s] == b and links[g, s] == order[k]:
                    links[g, s] = new
            order[n_listed] = new
            n_listed += 1
    # 5. Link adjacent new faces: the horizon is a single loop, so each new face begins where another ends.
    for k in range(n_visible, n_listed):
        new, after = order[k], start[corners[order[k], 1]]
        links[new, 1], links[after, 2] = after, new
    # 6. Distribute the outside points of old faces to new faces, or drop them if inside the hull. Free the
    #    rows of old faces.
    for k in range(n_visible):
        old = order[k]
        q = head[old]
        while q >= 0:
            next_q = following[q]
            if q != p:
                _hand_on(q, n_visible, n_listed, order, tiny, points, planes, head, following)
            q = next_q
        state[old], free[n_free] = -1, old
        n_free += 1
    state[len(state) - 1] = n_free
    return n_listed


@helper
def _hull(m, points, corners, planes, links, head, following, state, order, free, start):
    """Compute the convex hull of ``points[:m]``.

    The faces are the rows below the returned number with ``state`` 0. Returns 0 if all points are coplanar,
    -1 if rounding led to more faces than rows.
    """
    # 1. All rows are free, the lowest on top of the stack. The first tetrahedron takes four.
    rows = 6 * m + 8
    for r in range(rows):
        state[r], free[r] = -1, rows - 1 - r
    if not _first_four(points, m, corners, planes, links, head):
        return 0
    # 2. Assign each point to a face with the point outside. Coordinates are relative to one of the points, so
    #    their maximum measures the extent.
    extent = 0.0
    for p in range(m):
        for k in range(3):
            extent = max(extent, abs(points[p, k]))
    tiny = _TINY * extent
    for k in range(4):
        state[k], order[k] = 0, k
    state[len(state) - 1], n_used = rows - 4, 4
    for p in range(m):
        _hand_on(p, 0, 4, order, tiny, points, planes, head, following)
    # 3. Grow the hull while a face has outside points. New faces may reuse rows that this pass already
    #    visited, hence several passes.
    grows = True
    while grows:
        grows = False
        for f in range(rows):
            if f >= n_used:
                break
            if state[f] == 0 and head[f] >= 0:
                n_listed = _grow(
                    f, tiny, points, corners, planes, links, head, following, state, order, free, start
                )
                if n_listed < 0:
                    return -1
                for k in range(n_listed):
                    n_used = max(n_used, order[k] + 1)
                grows = True
    return n_used


@kernel
def solid_hulls(points, offsets, vertices):
    """Compute the convex hulls of cells by Quickhull (Barber, Dobkin and Huhdanpaa 1996).

    Cell c has the distinct vertices ``vertices[offsets[c]:offsets[c + 1]]``.

    Returns
    -------
    volume : (n,) float
        0 if all vertices are coplanar, and -1 if rounding led to an invalid surface.
    ends : (n + 1,) int
        The hull of cell c has the triangles ``ends[c]:ends[c + 1]``.
    triangles : (t, 3) int
        Vertices, counter-clockwise from outside.
    neighbours : (t, 3) int
        Neighbour k, a row in this array, shares corners k and k + 1 of the triangle.
    """
    n, most = len(offsets) - 1, np.int64(4)
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    rows = 6 * most + 8
    near, following, start = np.empty((most, 3)), np.empty(most, np.int64), np.empty(most, np.int64)
    corners, links, planes = (
        np.empty((rows, 3), np.int64),
        np.empty((rows, 3), np.int64),
        np.empty((rows, 4)),
    )
    head, order, free = np.empty(rows, np.int64), np.empty(rows, np.int64), np.empty(rows, np.int64)
    state = np.empty(rows + 1, np.int64)
    volume, ends = np.zeros(n), np.zeros(n + 1, np.int64)
    capacity = 2 * len(vertices)
    triangles, neighbours = np.empty((capacity, 3), np.int32), np.empty((capacity, 3), np.int32)
    top = np.int64(0)
    for c in range(n):
        # 1. Hull of the vertices, relative to the first vertex, so that distant cells lose no digits.
        first, m = offsets[c], offsets[c + 1] - offsets[c]
        for i in range(m):
            for k in range(3):
                near[i, k] = points[vertices[first + i], k] - points[vertices[first], k]
        n_used = _hull(m, near, corners, planes, links, head, following, state, order, free, start)
        # 2. Number the faces in the result arrays. A closed triangle surface on m points has at most 2m - 4
        #    faces, otherwise the hull is invalid.
        faces = 0
        for f in range(n_used):
            if state[f] == 0:
                order[f] = top + faces
                faces += 1
        if n_used < 0 or faces > 2 * m - 4:
            volume[c], faces, n_used = -1.0, 0, 0
        # 3. Add the signed volumes of the tetrahedra from the first vertex to each face, and copy the faces.
        for f in range(n_used):
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
                neighbours[order[f], side] = order[links[f, side]]
        top += faces
        ends[c + 1] = top
    return volume, ends, triangles[:top].copy(), neighbours[:top].copy()
