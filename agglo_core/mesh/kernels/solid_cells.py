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
        # 1. M, the mean of the centres.
        x, y, z, count = 0.0, 0.0, 0.0, offsets[c + 1] - offsets[c]
        for h in range(offsets[c], offsets[c + 1]):
            x += centre[h, 0]
            y += centre[h, 1]
            z += centre[h, 2]
        x, y, z = x / count, y / count, z / count
        # 2. Sums of areas, area vectors (u, v, w) and fluxes. All fluxes have the same sign only if all faces
        #    look away from M, or all towards it.
        area, u, v, w, least, most, total = 0.0, 0.0, 0.0, 0.0, np.inf, -np.inf, 0.0
        for h in range(offsets[c], offsets[c + 1]):
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
        sums[c, 5], sums[c, 6], sums[c, 7] = x, y, z
    return sums


@kernel
def pair_half_faces(offsets, vertices, n_points):
    """Pair loops with equal vertex sets: the first gets the index of the second, the second −2.

    A loop without partner gets −1. If three loops have the same vertices, the result is empty. Loops repeat
    no point; loop f has ``vertices[offsets[f]:offsets[f + 1]]``.
    """
    n, slots = len(offsets) - 1, 1
    while slots < n:
        slots *= 2
    head, link = np.full(slots, -1, np.int64), np.empty(n, np.int64)
    partner, stamp = np.empty(n, np.int64), np.full(n_points, -1, np.int64)
    for f in range(n):
        # 1. Hash of the vertices: a sum, independent of their order. The points of loop f are stamped with f.
        key = np.uint64(0)
        for h in range(offsets[f], offsets[f + 1]):
            x = (np.uint64(vertices[h]) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
            x = (x ^ (x >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
            key += x ^ (x >> np.uint64(32))
            stamp[vertices[h]] = f
        # 2. Search the slot for an earlier loop with the same number of vertices, all stamped.
        slot = np.int64(key & np.uint64(slots - 1))
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
