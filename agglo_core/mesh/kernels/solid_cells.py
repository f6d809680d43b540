"""Compiled loops for polyhedra: vertices, surface closedness, face pairing, element rotations."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _sort(values, start, stop):
    """Sort ``values[start:stop]`` by Shell sort."""
    gap = (stop - start) // 2
    while gap > 0:
        for i in range(start + gap, stop):
            v, j = values[i], i
            while j >= start + gap and values[j - gap] > v:
                values[j] = values[j - gap]
                j -= gap
            values[j] = v
        gap = gap // 2 if gap < 5 else (5 * gap - 1) // 11


@kernel
def vertices_of_solids(face_offsets, face_vertices, offsets, faces, n_points):
    """Return the distinct vertices per cell, ascending, as CSR.

    Cell c has ``faces[offsets[c]:offsets[c + 1]]``.
    """
    n, capacity = len(offsets) - 1, 0
    for h in range(len(faces)):
        capacity += face_offsets[faces[h] + 1] - face_offsets[faces[h]]
    ends, vertices, m = np.zeros(n + 1, np.int64), np.empty(capacity, np.int32), 0
    latest = np.full(n_points, -1, np.int32)  # last cell with this point
    for c in range(n):
        for h in range(offsets[c], offsets[c + 1]):
            for g in range(face_offsets[faces[h]], face_offsets[faces[h] + 1]):
                v = face_vertices[g]
                if latest[v] != c:
                    latest[v], vertices[m] = c, v
                    m += 1
        _sort(vertices, ends[c], m)
        ends[c + 1] = m
    return ends, vertices[:m].copy()


@kernel
def solid_moments(start, stop, vector, centre, face_cells, offsets, faces, volume, centroid):
    """Write volumes (n,) and centroids (n, 3) of the cells start..stop − 1 by the divergence theorem.

    The cell is divided into pyramids from the mean M of its face centroids over its faces. The pyramid over a
    face with area vector a and centroid x has volume a · (x − M) / 3 and centroid M + 3 (x − M) / 4.
    """
    for c in range(start, stop):
        # 1. Mean of the face centroids.
        mx, my, mz, count = 0.0, 0.0, 0.0, offsets[c + 1] - offsets[c]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            mx, my, mz = mx + centre[f, 0], my + centre[f, 1], mz + centre[f, 2]
        mx, my, mz = mx / count, my / count, mz / count
        # 2. Sums of three times the volume, and of the first moments.
        total, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            x, y, z = centre[f, 0] - mx, centre[f, 1] - my, centre[f, 2] - mz
            thrice = x * vector[f, 0] + y * vector[f, 1] + z * vector[f, 2]
            thrice = thrice if face_cells[f, 0] == c else -thrice
            total += thrice
            sx, sy, sz = sx + 0.25 * thrice * x, sy + 0.25 * thrice * y, sz + 0.25 * thrice * z
        safe, i = total / 3.0 if total != 0.0 else 1.0, c - start
        volume[i] = total / 3.0
        centroid[i, 0], centroid[i, 1], centroid[i, 2] = mx + sx / safe, my + sy / safe, mz + sz / safe


@kernel
def face_inertias(points, offsets, vertices, vector, centre):
    """Return ∫ |x − m|² / S of plane faces about their centroids m, with area S, by triangles from m."""
    found = np.zeros(len(offsets) - 1)
    for f in range(len(found)):
        square = vector[f, 0] ** 2 + vector[f, 1] ** 2 + vector[f, 2] ** 2
        v = vertices[offsets[f + 1] - 1]
        ax, ay, az = points[v, 0] - centre[f, 0], points[v, 1] - centre[f, 1], points[v, 2] - centre[f, 2]
        for h in range(offsets[f], offsets[f + 1]):
            v = vertices[h]
            bx, by, bz = points[v, 0] - centre[f, 0], points[v, 1] - centre[f, 1], points[v, 2] - centre[f, 2]
            # The triangle m, a, b has the area (a × b) · n / 2 and the mean square (a² + a · b + b²) / 6.
            area = (ay * bz - az * by) * vector[f, 0] + (az * bx - ax * bz) * vector[f, 1]
            area += (ax * by - ay * bx) * vector[f, 2]
            squares = ax * ax + ay * ay + az * az + ax * bx + ay * by + az * bz + bx * bx + by * by + bz * bz
            found[f] += area * squares
            ax, ay, az = bx, by, bz
        found[f] = found[f] / (12.0 * square) if square > 0.0 else 0.0
    return found


@kernel
def solid_inertias(start, stop, moments, vector, centre, face_cells, offsets, faces, centroids):
    """Return ∫ |x − C|² of the cells start..stop − 1 about their centroids C, by pyramids over their faces.

    A face with area S, centroid m and the ``moments`` ∫ |x − m|² / S = M, at the distance h from C,
    contributes h S (|m − C|² + M) / 5.
    """
    found = np.zeros(stop - start)
    for c in range(start, stop):
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            x, y, z = (
                centre[f, 0] - centroids[c, 0],
                centre[f, 1] - centroids[c, 1],
                centre[f, 2] - centroids[c, 2],
            )
            height = x * vector[f, 0] + y * vector[f, 1] + z * vector[f, 2]  # multiplied by the area
            share = height * (x * x + y * y + z * z + moments[f]) / 5.0
            found[c - start] += share if face_cells[f, 0] == c else -share
    return found


@helper
def add_surface(start, stop, vector, centre, sums, c):
    """Write the first five sums of :func:`surfaces` over half-faces start..stop − 1 to row c. Return M."""
    # 1. M, the mean of the centres.
    x, y, z, count = 0.0, 0.0, 0.0, stop - start
    for h in range(start, stop):
        x += centre[h, 0]
        y += centre[h, 1]
        z += centre[h, 2]
    x, y, z = x / count, y / count, z / count
    # 2. Sums of areas, area vectors (u, v, w) and fluxes. All fluxes have the same sign only if all faces
    #    look away from M, or all towards it.
    area, u, v, w, least, most, total = 0.0, 0.0, 0.0, 0.0, np.inf, -np.inf, 0.0
    for h in range(start, stop):
        a, b, d = vector[h, 0], vector[h, 1], vector[h, 2]
        area += np.sqrt(a * a + b * b + d * d)
        u += a
        v += b
        w += d
        flux = (centre[h, 0] - x) * a + (centre[h, 1] - y) * b + (centre[h, 2] - z) * d
        least, most = min(least, flux), max(most, flux)
        total += flux
    sums[c, 0], sums[c, 1] = area, np.sqrt(u * u + v * v + w * w)
    sums[c, 2], sums[c, 3], sums[c, 4] = least, most, total
    return x, y, z


@kernel
def surfaces(offsets, vector, centre):
    """Sum areas, area vectors and fluxes over the faces of each cell.

    Cell c has the half-faces ``offsets[c]:offsets[c + 1]``. ``vector`` and ``centre (h, 3)`` are the area
    vector a and the centre x of each half-face. With M the mean of a cell's centres, the flux of x - M
    through a half-face is a · (x - M).

    Returns
    -------
    sums : (n, 8) float
        Area; |Σ a|, 0 for closed surfaces; the smallest flux, the largest flux, and their sum, which is
        three times the volume; M.
    """
    sums = np.empty((len(offsets) - 1, 8))
    for c in range(len(sums)):
        x, y, z = add_surface(offsets[c], offsets[c + 1], vector, centre, sums, c)
        sums[c, 5], sums[c, 6], sums[c, 7] = x, y, z
    return sums


@kernel
def pair_half_faces(offsets, vertices, n_points):
    """Pair loops with equal vertex sets: the first gets the index of the second, the second −2.

    A loop without partner gets −1. If three loops have the same vertices, the result is empty. Loops repeat
    no point; loop f has ``vertices[offsets[f]:offsets[f + 1]]``.
    """
    n, share = len(offsets) - 1, 1
    while share * n_points < n:
        share *= 2
    # The slots of a point are for loops with this lowest vertex: near loops use near slots.
    head, link = np.full(share * n_points, -1, np.int32), np.empty(n, np.int32)
    partner, stamp = np.empty(n, np.int64), np.full(n_points, -1, np.int32)
    for f in range(n):
        # 1. Hash of the vertices: a sum, independent of their order. The points of loop f are stamped with f.
        key, low = np.uint64(0), vertices[offsets[f]]
        for h in range(offsets[f], offsets[f + 1]):
            x = (np.uint64(vertices[h]) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
            x = (x ^ (x >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
            key += x ^ (x >> np.uint64(32))
            stamp[vertices[h]] = f
            low = min(low, vertices[h])
        # 2. Search the slot for an earlier loop with the same number of vertices, all stamped.
        slot = low * share + np.int64(key & np.uint64(share - 1))
        g = head[slot]
        while g >= 0:
            is_match = offsets[g + 1] - offsets[g] == offsets[f + 1] - offsets[f]
            h = offsets[g]
            while is_match and h < offsets[g + 1]:
                is_match = stamp[vertices[h]] == f
                h += 1
            if is_match:
                break
            g = link[g]
        # 3. Only the first loop of a pair is in the list; a third loop finds it already paired.
        if g < 0:
            partner[f], link[f], head[slot] = -1, head[slot], f
        elif partner[g] == -1:
            partner[g], partner[f] = f, -2
        else:
            return partner[:0]
    return partner


@kernel
def first_turns(first, second, owns_face, places, ranks):
    """Return for each cell the first rotation in which its own faces have the element's order, or −1.

    A cell has −1 if no rotation fits. It owns the faces whose normal points out of it.

    Parameters
    ----------
    first, second : (n, F) int
        Local corners that begin each face of a cell.
    owns_face : (n, F) bool
        True if the cell owns the face; other faces may come in any order.
    places : (T, 8) int
        Position of each corner after each rotation.
    ranks : (8, 8) int
        Face of the element that begins with two corners, or −1.
    """
    rotation = np.full(len(first), -1, np.int64)
    for c in range(len(first)):
        for t in range(len(places)):
            # The ranks of the owned faces must increase in their listed order. Faces that the element does
            # not have get rank −1, which never exceeds the highest rank so far.
            highest, rises = -1, True
            for f in range(first.shape[1]):
                if owns_face[c, f]:
                    rank = ranks[places[t, first[c, f]], places[t, second[c, f]]]
                    rises &= rank > highest
                    highest = max(highest, rank)
            if rises:
                rotation[c] = t
                break
    return rotation
