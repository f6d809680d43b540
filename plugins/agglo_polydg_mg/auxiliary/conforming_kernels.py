"""Kernels of the continuous space: clusters of vertices, unknowns of corners, fits of traces.

A corner is a cell at a cluster of vertices. ``ends (F, 2, 2)`` holds the corners of the cells at each face:
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
    """Return the cluster ``(n_points,)`` of each vertex, joined along short edges.

    The ends of ``edges (q, 2)`` are joined in their order, unless the bounding box of the joined cluster
    would have a diagonal longer than the ``limits (q,)``, lengths, of any of its edges. A chain of short
    edges becomes a few clusters and never one.
    """
    # Clusters are trees. A root has the smallest limit of its edges and its box (x_min, y_min, x_max, y_max).
    n = len(points)
    parents, limit = np.arange(n), np.full(n, np.inf)
    boxes = np.concatenate((points, points), axis=1)
    for q in range(len(edges)):
        a, b = _root(parents, edges[q, 0]), _root(parents, edges[q, 1])
        if a == b:
            continue
        # Join only if the diagonal of the common box meets the limits of this edge and of both clusters.
        least = min(limits[q], min(limit[a], limit[b]))
        width = max(boxes[a, 2], boxes[b, 2]) - min(boxes[a, 0], boxes[b, 0])
        height = max(boxes[a, 3], boxes[b, 3]) - min(boxes[a, 1], boxes[b, 1])
        if width * width + height * height <= least * least:
            parents[b], limit[a] = a, least
            for x in range(2):
                boxes[a, x] = min(boxes[a, x], boxes[b, x])
                boxes[a, 2 + x] = max(boxes[a, 2 + x], boxes[b, 2 + x])
    # The number of a cluster is that of the vertex at its root: numbers leave gaps.
    for i in range(n):
        parents[i] = _root(parents, i)
    return parents


@kernel
def corners_of_cells(offsets, faces, face_vertices, face_cells, clusters):
    """Number the corners, cell by cell.

    Returns their offsets ``(n_cells + 1,)`` and ``ends (F, 2, 2)``, −1 outside the domain. Cell c has the
    faces ``faces[offsets[c]:offsets[c + 1]]``.
    """
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
                # A cell has one corner at each of its clusters: an older number belongs to another cell.
                v = clusters[face_vertices[f, k]]
                if last[v] < first:
                    last[v] = count
                    count += 1
                ends[f, side, k] = last[v]
        starts[c + 1] = count
    return starts, ends


@kernel
def corner_unknowns(offsets, faces, face_cells, ends, starts, coupling, stiffness, order, weak, comparable):
    """Unite corners into unknowns where cells are tied together.

    Returns the unknown ``(m,)`` of each corner, numbered by first cell, and the number of unknowns.
    ``coupling (F,)`` is the energy of a jump of 1 across a face, ``stiffness (n_cells,)`` the largest that it
    could be in a cell; cells come in ``order (n_cells,)`` of falling stiffness. At each of its corners a cell
    meets the unknowns of the cells across its faces that came before, except across faces whose coupling
    times ``weak`` is less than its stiffness. A single unknown is shared: the weaker cell follows the
    stronger. Several are united where ``comparable`` times its own stiffness is at least that of the second
    of them: otherwise groups that touch at the corner only would be tied together by nothing but a weak
    cell, which then has an unknown of its own.
    """
    # Groups of corners are trees; ``strength`` at a root is the largest stiffness of the cells of its group.
    m = starts[-1]
    parents, rank = np.arange(m), np.empty(len(order), np.int64)
    for i in range(len(order)):
        rank[order[i]] = i
    strongest, best, second, strength = np.full(m, -1), np.zeros(m), np.zeros(m), np.empty(m)
    for c in order:
        strength[starts[c] : starts[c + 1]] = stiffness[c]
        # Two passes over the faces: the first finds, at each corner, the strongest group beyond them and the
        # strength of the second; the second joins, as how many groups there are must be known before.
        for again in range(2):
            for h in range(offsets[c], offsets[c + 1]):
                f = faces[h]
                side = 0 if face_cells[f, 0] == c else 1
                other = face_cells[f, 1 - side]
                # Skip the boundary, cells that come later (they will look at this one) and weak faces.
                if other < 0 or rank[other] > rank[c] or coupling[f] * weak < stiffness[c]:
                    continue
                for k in range(2):
                    mine, root = ends[f, side, k], _root(parents, ends[f, 1 - side, k])
                    # A corner with one group beyond it has second 0 and always joins.
                    if again:
                        own = _root(parents, mine)
                        if own != root and stiffness[c] * comparable >= second[mine]:
                            parents[own], strength[root] = root, max(strength[own], strength[root])
                    elif strength[root] > best[mine]:
                        strongest[mine], best[mine], second[mine] = root, strength[root], best[mine]
                    elif root != strongest[mine]:
                        second[mine] = max(second[mine], strength[root])
    # Each group is an unknown; corners go by cell, so that unknowns are numbered by their first cell.
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
    """Write the polynomials of a cell, not scaled, at a point to ``out``.

    They are (i + 1/2)^½ (j + 1/2)^½ L_i(x̂) L_j(ŷ), numbered by total degree, with L_i of value 1 at 1 and
    ``roots (degree + 1,)`` the factors (i + 1/2)^½.
    """
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
    for j in range(degree + 1):  # times L_j(y), at the places of (i, j) for all i
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
    """Replace the rows of ``right (count, n)`` by the solutions x of ``normal`` x = row.

    Only the lower half of ``normal (n, n)``, symmetric and positive definite, is read. It becomes the
    Cholesky factor.
    """
    # 1. normal = L Lᵀ.
    for i in range(n):
        for j in range(i + 1):
            t = normal[i, j]
            for k in range(j):
                t -= normal[i, k] * normal[j, k]
            normal[i, j] = np.sqrt(t) if i == j else t / normal[j, j]
    # 2. L y = row, forwards, then Lᵀ x = y, backwards.
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
    """Fit a polynomial q_u of each cell to the trace of each of its unknowns u.

    Returns the unknowns of each cell, as offsets ``(n_cells + 1,)`` and indices, and the coefficients
    ``(·, n)`` of each q_u. It minimises ∫ (q − trace)² ds over the cell's boundary, after a map that makes
    the bounding box a square, plus ``regularisation`` times the squares of total degree times coefficient,
    from degree 2 on.

    The trace is linear between the corners of a face, plus the bubbles 4t(1 − t)(2t − 1)^k numbered from
    ``bubbles (F,)`` on, if that is not negative; on faces that are ``held (F,)`` row k of ``orthogonal``
    times the functions at the ends and the bubbles is added to bubble k. A cell with more than ``squares²``
    corners has one unknown for each square of a grid on its box, that of the first vertex there: the
    polynomial fits the values at these vertices. ``nodes`` and ``weights`` are a rule on [0, 1]; ``room`` is
    an upper bound of the rows of the result.
    """
    # 0. Workspaces: rows of ``right`` for the cell with the most unknowns.
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
        # 1. The unknowns of the corners come first, bubbles after them. With ``many`` corners they are only
        #    known once the squares are.
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
            # 2. The length of the face on the square [−1, 1]² weights its part of the integral.
            a, b = face_vertices[f, 0], face_vertices[f, 1]
            ax, ay, bx, by = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
            ex, ey = along_box(bx - ax, by - ay, box)
            length = np.sqrt((ex / box[2]) ** 2 + (ey / box[3]) ** 2)
            # 3. Many corners: half of the length goes to each end, or rather to the first vertex found in
            #    the square of the grid where the end lies: N and the right-hand side take the value there.
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
            # 4. Otherwise quadrature along the face: N += w p pᵀ, and w p times the functions 1 − t, t and
            #    the bubbles to the right-hand sides. A corner collects from both of its faces.
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
        # 5. The regularisation keeps polynomials small that vanish on the boundary; constants and linear
        #    functions stay free, so that they are reproduced.
        k = 0
        for total in range(degree + 1):
            for _ in range(total + 1):
                normal[k, k] += regularisation * total * total if total > 1 else 0.0
                k += 1
        solve_rows(normal, right, n, count)
        # 6. On held faces bubble k takes its multiples of the end functions and of the bubbles before it.
        #    The fit is linear in the trace, so solutions are combined instead of right-hand sides; the last
        #    bubble first, since it needs the others unchanged.
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
        # 7. Coefficients of the scaled polynomials of the cell.
        for i in range(count):
            for j in range(n):
                fitted[position + i, j] = right[i, j] / scale[c]
        position += count
        counts[c + 1] = position
    return counts, indices[:position], fitted[:position]
