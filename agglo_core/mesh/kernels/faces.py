"""Topology of 2-D meshes: from vertex loops of cells to faces, and from faces to loops."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

# edges per cell up to which the next edge is found by linear search; above, by lists (benchmarks/threads.py)
FEW = 24
# edges whose faces are fetched together (16 KiB), so that cache misses overlap (benchmarks/files.py --chain)
_ROOM = 1024


@kernel
def match_half_edges(offsets, vertices, n_points):
    """Pair the half-edges of counter-clockwise cells into faces.

    Returns face vertices (F, 2), face cells (F, 2), the cell pairs (D, 2) that traverse an edge in the same
    direction (they overlap; each keeps its own face), and the first edge with a third cell as (a, b, its
    three cells), else −1. An edge that one cell traverses in both directions is a bridge and dropped.
    """
    n_half = len(vertices)
    head = np.full(n_points, -1, np.int64)
    link = np.empty(n_half, np.int64)
    face_vertices = np.empty((n_half, 2), np.int64)
    face_cells = np.empty((n_half, 2), np.int64)
    double = np.empty((n_half, 2), np.int64)
    n_faces, n_double = 0, 0
    for c in range(len(offsets) - 1):
        start, stop = offsets[c], offsets[c + 1]
        for h in range(start, stop):
            a = vertices[h]
            b = vertices[h + 1] if h + 1 < stop else vertices[start]
            low, high = min(a, b), max(a, b)
            # 1. Search faces with these two vertices in the list of the lower vertex: ``partner`` has the
            #    opposite direction, ``rival`` the same direction. A third cell is an error.
            f, partner, rival = head[low], -1, -1
            while f >= 0:
                if max(face_vertices[f, 0], face_vertices[f, 1]) == high:
                    previous = max(partner, rival)
                    second = face_cells[previous, 0] if previous >= 0 else face_cells[f, 1]
                    if second >= 0:
                        return face_vertices, face_cells, double, (a, b, face_cells[f, 0], second, c)
                    if face_vertices[f, 0] == b:
                        partner = f
                    else:
                        rival = f
                f = link[f]
            # 2. Make the cell the second cell of a face, or create a face; overlapping cells get separate
            #    faces.
            if partner >= 0:
                face_cells[partner, 1] = c
                continue
            if rival >= 0:
                double[n_double, 0], double[n_double, 1] = face_cells[rival, 0], c
                n_double += 1
            face_vertices[n_faces, 0], face_vertices[n_faces, 1] = a, b
            face_cells[n_faces, 0], face_cells[n_faces, 1] = c, -1
            link[n_faces] = head[low]
            head[low] = n_faces
            n_faces += 1
    # 3. Drop bridges, which have the same cell on both sides.
    n_kept = 0
    for f in range(n_faces):
        if face_cells[f, 0] != face_cells[f, 1]:
            for s in range(2):  # numba takes a second longer to compile row copies
                face_vertices[n_kept, s] = face_vertices[f, s]
                face_cells[n_kept, s] = face_cells[f, s]
            n_kept += 1
    return (
        face_vertices[:n_kept].copy(),
        face_cells[:n_kept].copy(),
        double[:n_double].copy(),
        (-1, -1, -1, -1, -1),
    )


@kernel
def cell_faces(face_cells, first, places, faces):
    """Write faces, from ``first`` on, to the lists of their cells, or only count if ``faces`` is empty.

    The next face of cell c is written to ``faces[places[c]]``, and ``places[c]`` is incremented.
    """
    only_count = len(faces) == 0
    for f in range(len(face_cells)):
        for s in range(2):
            c = face_cells[f, s]
            if c >= 0:
                if not only_count:
                    faces[places[c]] = first + f
                places[c] += 1


@helper
def _next_edge(points, start, end, first, link, visited, h, seed):
    """Return the edge that continues edge h with the sharpest left turn.

    The loop thus stays at the same corner of the cell.

    Candidates at the end of h are unused edges, and the ``seed``, which closes the loop.
    """
    # One edge starts at most vertices; the caller checks whether it is used.
    g = first[end[h]]
    if g < 0 or link[g] < 0:
        return g
    ux, uy = points[end[h], 0] - points[start[h], 0], points[end[h], 1] - points[start[h], 1]
    best, best_angle = -1, -10.0
    # Angle of the turn from h to g, between −π and π, positive to the left.
    while g >= 0:
        if not visited[g] or g == seed:
            vx, vy = points[end[g], 0] - points[start[g], 0], points[end[g], 1] - points[start[g], 1]
            angle = np.arctan2(ux * vy - uy * vx, ux * vx + uy * vy)
            if angle > best_angle:
                best, best_angle = g, angle
        g = link[g]
    return best


@helper
def _follow_loop(start, end, base, size, walk):
    """Trace the edges base..base + size − 1 of a cell, and return True if they form one simple loop."""
    h = base
    for k in range(size):
        walk[k] = start[h]
        v, h = end[h], base
        while h < base + size and start[h] != v:
            h += 1
        if h == base + size or h == base:
            return h == base and k == size - 1
    return False


@kernel
def chain_loops(points, offsets, faces, face_vertices, face_cells, first_cell, loops):
    """Chain the edges of cells, from ``first_cell`` on, to closed loops with the cell on their left.

    No loop repeats a vertex. Cell ``first_cell + c`` has ``faces[offsets[c]:offsets[c + 1]]``. Vertices are
    written to ``loops``, with space for one per face, which may be the memory of these faces. Returns the
    number of loops per cell (n + 1,) as offsets, and vertex offsets per loop.
    """
    n = len(offsets) - 1
    most = 0
    for c in range(n):
        most = max(most, offsets[c + 1] - offsets[c])
    room = max(_ROOM, most)
    starts, ends = np.empty(room, np.int64), np.empty(room, np.int64)
    link = np.empty(most, np.int64)  # previous edge with the same start
    visited = np.empty(most, np.bool_)
    walk = np.empty(most, np.int64)
    first = np.empty(0, np.int64)  # last edge of this cell that starts at a vertex
    place = np.empty(0, np.int64)  # position of a vertex in the walk
    cell_loops = np.zeros(n + 1, np.int64)
    loop_ends = np.empty(offsets[n] - offsets[0] + 1, np.int64)  # mostly unused, so that pages stay free
    loop_ends[0] = 0
    n_loops, filled, first_fetched, last_fetched = 0, 0, 0, 0
    for c in range(n):
        size = offsets[c + 1] - offsets[c]
        # 1. Edges of as many cells as fit, with the cell on their left: faces are reversed for neighbours.
        if c == last_fetched:
            first_fetched = c
            while last_fetched < n and offsets[last_fetched + 1] - offsets[first_fetched] <= room:
                cell = first_cell + last_fetched
                for h in range(offsets[last_fetched], offsets[last_fetched + 1]):
                    f, i = np.uint64(faces[h]), np.uint64(h - offsets[first_fetched])
                    p, q, is_owner = face_vertices[f, 0], face_vertices[f, 1], face_cells[f, 0] == cell
                    starts[i], ends[i] = p if is_owner else q, q if is_owner else p
                last_fetched += 1
        base = offsets[c] - offsets[first_fetched]
        # 2. Most cells have few edges that form one simple loop.
        if size <= FEW and _follow_loop(starts, ends, base, size, walk):
            for k in range(size):
                loops[filled + k] = walk[k]
            filled += size
            n_loops += 1
            loop_ends[n_loops] = filled
            cell_loops[c + 1] = n_loops
            continue
        if len(first) == 0:  # rarely necessary
            first, place = np.empty(len(points), np.int64), np.full(len(points), -1, np.int64)
        # 3. Other cells: list the edges that start at each vertex.
        start, end = starts[base : base + size], ends[base : base + size]
        for h in range(size):
            visited[h] = False
            first[start[h]] = -1
            first[end[h]] = -1
        for h in range(size):
            link[h] = first[start[h]]
            first[start[h]] = h
        # 4. Walk from each unused edge until the walk returns to it. At each repeated vertex the part since
        #    its first visit is split off as a loop, so no loop repeats a vertex.
        for seed in range(size):
            h, length = seed, 0
            while h >= 0 and (not visited[h] or (h == seed and length > 0)):
                v = start[h]
                if place[v] >= 0:
                    back = place[v]
                    for k in range(back, length):
                        place[walk[k]] = -1
                        loops[filled] = walk[k]
                        filled += 1
                    n_loops += 1
                    loop_ends[n_loops] = filled
                    length = back
                if visited[h]:
                    break
                visited[h] = True
                place[v] = length
                walk[length] = v
                length += 1
                h = _next_edge(points, start, end, first, link, visited, h, seed)
        cell_loops[c + 1] = n_loops
    return cell_loops, loop_ends[: n_loops + 1].copy()
