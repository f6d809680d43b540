"""Kernels of the continuous space: clusters of vertices, unknowns of corners, fits of traces.

A corner is a cell at a cluster of vertices. ``ends (F, 2, 2)`` holds the corners of the cells beside a face:
``ends[f, side, k]`` is the corner of cell ``face_cells[f, side]`` at vertex ``face_vertices[f, k]``.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import along_box


@helper
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def cluster_vertices(points, edges, limits):
    """Cluster ``(n_points,)`` of each vertex: ends of ``edges (q, 2)`` are joined, in their order, unless
    the bounding box of what is joined would have a diagonal longer than ``limits (q,)`` of any of its edges.

    A chain of short edges becomes a few clusters and never one.
    """
    n = len(points)
    parents, limit = np.arange(n), np.full(n, np.inf)
    boxes = np.concatenate((points, points), axis=1)
    for q in range(len(edges)):
        a, b = _root(parents, edges[q, 0]), _root(parents, edges[q, 1])
        if a == b:
            continue
        least = min(limits[q], min(limit[a], limit[b]))
        width = max(boxes[a, 2], boxes[b, 2]) - min(boxes[a, 0], boxes[b, 0])
        height = max(boxes[a, 3], boxes[b, 3]) - min(boxes[a, 1], boxes[b, 1])
        if width * width + height * height <= least * least:
            parents[b], limit[a] = a, least
            for x in range(2):
                boxes[a, x] = min(boxes[a, x], boxes[b, x])
                boxes[a, 2 + x] = max(boxes[a, 2 + x], boxes[b, 2 + x])
    for i in range(n):
        parents[i] = _root(parents, i)
    return parents


@kernel
def corners_of_cells(offsets, faces, face_vertices, face_cells, clusters):
    """Corners by cell, offsets ``(n_cells + 1,)``, and ``ends (F, 2, 2)``, −1 outside the domain."""
    ends = np.full((len(face_cells), 2, 2), -1)
    starts = np.zeros(len(offsets), np.int64)
    last = np.full(len(clusters), -1)
    count = 0
    for c in range(len(offsets) - 1):
        first = count
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            side = 0 if face_cells[f, 0] == c else 1
            for k in range(2):
                v = clusters[face_vertices[f, k]]
                if last[v] < first:
                    last[v] = count
                    count += 1
                ends[f, side, k] = last[v]
        starts[c + 1] = count
    return starts, ends


@kernel
def corner_unknowns(offsets, faces, face_cells, ends, starts, coupling, stiffness, order, weak, comparable):
    """Unknown ``(m,)`` of each corner, numbered by first cell, and their number.

    ``coupling (F,)`` is what a jump of 1 across a face costs, ``stiffness (n_cells,)`` the most that it
    could in a cell; cells come in ``order (n_cells,)`` of falling stiffness. At each of its corners a cell
    looks at the cells across its faces that came before, unless ``weak`` times the coupling is less than its
    stiffness, and at the unknowns they have there. If there is one it takes that: the weaker follows the
    stronger. If there are several it makes them one where ``comparable`` times its own stiffness is at least
    that of the second of them: otherwise groups that touch at the corner only would be tied together by
    nothing but a weak cell, which then has an unknown of its own.
    """
    m = starts[-1]
    parents, rank = np.arange(m), np.empty(len(order), np.int64)
    for i in range(len(order)):
        rank[order[i]] = i
    strongest, best, second, strength = np.full(m, -1), np.zeros(m), np.zeros(m), np.empty(m)
    for c in order:
        strength[starts[c] : starts[c + 1]] = stiffness[c]
        for again in range(2):
            for h in range(offsets[c], offsets[c + 1]):
                f = faces[h]
                side = 0 if face_cells[f, 0] == c else 1
                other = face_cells[f, 1 - side]
                if other < 0 or rank[other] > rank[c] or coupling[f] * weak < stiffness[c]:
                    continue
                for k in range(2):
                    mine, root = ends[f, side, k], _root(parents, ends[f, 1 - side, k])
                    if again:
                        own = _root(parents, mine)
                        if own != root and stiffness[c] * comparable >= second[mine]:
                            parents[own], strength[root] = root, max(strength[own], strength[root])
                    elif strength[root] > best[mine]:
                        strongest[mine], best[mine], second[mine] = root, strength[root], best[mine]
                    elif root != strongest[mine]:
                        second[mine] = max(second[mine], strength[root])
    numbers, unknowns, count = np.full(m, -1), np.empty(m, np.int64), 0
    for i in range(m):
        root = _root(parents, i)
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        unknowns[i] = numbers[root]
    return unknowns, count


@helper
def _polynomials(x, y, box, roots, out):
    """The polynomials of a cell, not scaled, at a point; ``roots`` are (i + 1/2)^½ up to their degree."""
    degree = len(roots) - 1
    x, y = along_box(x - box[0], y - box[1], box)
    x, y = x / box[2], y / box[3]
    k = 0
    before, value = 0.0, 1.0
    for i in range(degree + 1):  # L_i(x), at the places of (i, j) for all j
        k = i * (i + 1) // 2
        for j in range(degree + 1 - i):
            out[k] = value * roots[i]
            k += i + j + 2
        before, value = value, ((2 * i + 1) * x * value - i * before) / (i + 1)
    before, value = 0.0, 1.0
    for j in range(degree + 1):
        k = j * (j + 3) // 2
        for i in range(degree + 1 - j):
            out[k] *= value * roots[j]
            k += i + j + 1
        before, value = value, ((2 * j + 1) * y * value - j * before) / (j + 1)


@helper
def _add_point(weight, values, normal, n):
    """Add weight times the products of the polynomials at a point to the lower half of a matrix."""
    for i in range(n):
        t = weight * values[i]
        for j in range(i + 1):
            normal[i, j] += t * values[j]


@helper
def solve_rows(normal, right, n, count):
    """Replace the rows of ``right (count, n)`` by solutions; ``normal`` becomes its Cholesky factor."""
    for i in range(n):
        for j in range(i + 1):
            t = normal[i, j]
            for k in range(j):
                t -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(t) if i == j else t / normal[j, j]
    for r in range(count):
        row = right[r]
        for i in range(n):
            t = row[i]
            for k in range(i):
                t -= normal[i, k] * row[k]
            row[i] = t / normal[i, i]
        for i in range(n - 1, -1, -1):
            t = row[i]
            for k in range(i + 1, n):
                t -= normal[k, i] * row[k]
            row[i] = t / normal[i, i]


@kernel
def fit_traces(
    points, offsets, faces, face_vertices, face_cells, ends, starts, unknowns, bubbles, held, orthogonal,
    boxes, scale, degree, nodes, weights, regularisation, squares, room,
):  # fmt: skip
    """Unknowns of each cell, as offsets ``(n_cells + 1,)`` and indices, and coefficients ``(·, m)`` of each.

    They are those of the polynomial next to the trace on the cell's boundary, in the mean square over the
    bounding box turned to a square. The trace is linear between the corners of a face, plus the bubbles
    4t(1 − t)(2t − 1)^k numbered from ``bubbles (F,)`` on, if that is not negative; on faces that are ``held
    (F,)`` row k of ``orthogonal`` times the functions at the ends and the bubbles is added to bubble k. Of a
    cell with more than ``squares²`` corners one in each square of a grid on its box counts, for all of them:
    the polynomial fits the values there. ``nodes`` and ``weights`` are on [0, 1]; ``room`` is the most that
    may be needed.
    """
    n, most, extra = (degree + 1) * (degree + 2) // 2, squares * squares, degree - 1
    counts, indices = np.zeros(len(offsets), np.int64), np.empty(room, np.int32)
    fitted = np.empty((room, n))
    widest = most
    for c in range(len(offsets) - 1):
        if starts[c + 1] - starts[c] <= most:
            widest = max(widest, starts[c + 1] - starts[c] + extra * (offsets[c + 1] - offsets[c]))
    normal, right, values = np.empty((n, n)), np.empty((widest, n)), np.empty(n)
    place, where, roots = np.empty(most, np.int64), np.empty((most, 2)), np.empty(degree + 1)
    for i in range(degree + 1):
        roots[i] = np.sqrt(i + 0.5)
    position = 0
    for c in range(len(offsets) - 1):
        corners = starts[c + 1] - starts[c]
        box = boxes[c]
        many = corners > most
        normal[:], place[:] = 0.0, -1
        right[: most if many else corners + extra * (offsets[c + 1] - offsets[c])] = 0.0
        count = 0 if many else corners
        for i in range(count):
            indices[position + i] = unknowns[starts[c] + i]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            side = 0 if face_cells[f, 0] == c else 1
            a, b = face_vertices[f, 0], face_vertices[f, 1]
            ax, ay, bx, by = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
            ex, ey = along_box(bx - ax, by - ay, box)
            length = np.sqrt((ex / box[2]) ** 2 + (ey / box[3]) ** 2)
            if many:
                for k in range(2):
                    v = face_vertices[f, k]
                    x, y = along_box(points[v, 0] - box[0], points[v, 1] - box[1], box)
                    column = min(int(squares * 0.5 * (1.0 + x / box[2])), squares - 1)
                    row = min(int(squares * 0.5 * (1.0 + y / box[3])), squares - 1)
                    s = max(row, 0) * squares + max(column, 0)
                    if place[s] < 0:
                        place[s], where[count] = count, points[v]
                        indices[position + count] = unknowns[ends[f, side, k]]
                        count += 1
                    i = place[s]
                    _polynomials(where[i, 0], where[i, 1], box, roots, values)
                    _add_point(0.5 * length, values, normal, n)
                    for j in range(n):
                        right[i, j] += 0.5 * length * values[j]
                continue
            first, last = ends[f, side, 0] - starts[c], ends[f, side, 1] - starts[c]
            for q in range(len(nodes)):
                t, weight = nodes[q], weights[q] * length
                _polynomials(ax + t * (bx - ax), ay + t * (by - ay), box, roots, values)
                _add_point(weight, values, normal, n)
                bubble = 4.0 * t * (1.0 - t) * weight
                for j in range(n):
                    right[first, j] += (1.0 - t) * weight * values[j]
                    right[last, j] += t * weight * values[j]
                if bubbles[f] >= 0:
                    for k in range(extra):
                        for j in range(n):
                            right[count + k, j] += bubble * values[j]
                        bubble *= 2.0 * t - 1.0
            if bubbles[f] >= 0:
                for k in range(extra):
                    indices[position + count + k] = bubbles[f] + k
                count += extra
        k = 0
        for total in range(degree + 1):
            for _ in range(total + 1):
                normal[k, k] += regularisation * total * total if total > 1 else 0.0
                k += 1
        solve_rows(normal, right, n, count)
        column = corners
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            if many or bubbles[f] < 0:
                continue
            if held[f]:
                side = 0 if face_cells[f, 0] == c else 1
                first, last = ends[f, side, 0] - starts[c], ends[f, side, 1] - starts[c]
                for k in range(extra - 1, -1, -1):
                    for j in range(n):
                        right[column + k, j] += orthogonal[k, 0] * right[first, j]
                        right[column + k, j] += orthogonal[k, 1] * right[last, j]
                        for i in range(k):
                            right[column + k, j] += orthogonal[k, 2 + i] * right[column + i, j]
            column += extra
        for i in range(count):
            for j in range(n):
                fitted[position + i, j] = right[i, j] / scale[c]
        position += count
        counts[c + 1] = position
    return counts, indices[:position], fitted[:position]
