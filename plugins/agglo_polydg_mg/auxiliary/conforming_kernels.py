"""Compiled kernels of the continuous space: vertex clusters, corner unknowns, trace fits.

A corner is a pair of a cell and a vertex cluster. ``ends (F, 2, 2)`` contains the corners at each face:
``ends[f, side, k]`` is the corner of cell ``face_cells[f, side]`` at vertex ``face_vertices[f, k]``.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_polydg_mg.space.legendre_kernels import along_box, legendre_at, recurrences


@helper
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def cluster_vertices(points, edges, limits):
    """Cluster vertices along short edges, and return each vertex's cluster ``(n_points,)``.

    The ends of ``edges (q, 2)`` are joined in order, unless the bounding box of the joined cluster would
    have a diagonal longer than the ``limits (q,)`` for any of its edges. A chain of short edges becomes
    several clusters, never a single cluster.
    """
    # Clusters are trees. A root stores the smallest limit of its edges and its box (x_min, y_min, x_max,
    # y_max).
    n = len(points)
    parents, limit = np.arange(n), np.full(n, np.inf)
    boxes = np.concatenate((points, points), axis=1)
    for q in range(len(edges)):
        a, b = _root(parents, edges[q, 0]), _root(parents, edges[q, 1])
        if a == b:
            continue
        # Join only if the diagonal of the common box respects the limits of this edge and of both clusters.
        least = min(limits[q], min(limit[a], limit[b]))
        width = max(boxes[a, 2], boxes[b, 2]) - min(boxes[a, 0], boxes[b, 0])
        height = max(boxes[a, 3], boxes[b, 3]) - min(boxes[a, 1], boxes[b, 1])
        if width * width + height * height <= least * least:
            parents[b], limit[a] = a, least
            for x in range(2):
                boxes[a, x] = min(boxes[a, x], boxes[b, x])
                boxes[a, 2 + x] = max(boxes[a, 2 + x], boxes[b, 2 + x])
    # A cluster takes the number of its root vertex: numbers leave gaps.
    for i in range(n):
        parents[i] = _root(parents, i)
    return parents


@kernel
def corners_of_cells(offsets, faces, face_vertices, face_cells, clusters):
    """Number the corners, pairs of a cell and one of its vertex clusters, cell by cell.

    Returns corner offsets ``(n_cells + 1,)`` and ``ends (F, 2, 2)``, −1 outside the domain. Cell c has the
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
    """Unite the corners of strongly coupled cells at a vertex into one unknown.

    Returns each corner's unknown ``(m,)``, numbered by first cell, and their number.
    ``coupling (F,)`` is the energy of a unit jump across a face, ``stiffness (n_cells,)`` the largest
    possible such energy in a cell; ``order (n_cells,)`` sorts the cells by decreasing stiffness.

    At each corner a cell joins the unknowns of earlier cells across its faces, except across faces
    with ``coupling * weak < stiffness``. A single unknown is shared: the weaker cell follows the stronger
    cell. Several unknowns are united if ``comparable`` times the cell's own stiffness is at least the
    second largest stiffness of these unknowns. Otherwise a weak cell would couple groups that touch only at
    the corner; the cell then gets its own unknown.
    """
    # Corner groups are trees; ``strength`` at a root is the largest stiffness of the cells in its group.
    m = starts[-1]
    parents, rank = np.arange(m), np.empty(len(order), np.int64)
    for i in range(len(order)):
        rank[order[i]] = i
    strongest, best, second, strength = np.full(m, -1), np.zeros(m), np.zeros(m), np.empty(m)
    for c in order:
        strength[starts[c] : starts[c + 1]] = stiffness[c]
        # Two passes over the faces. The first finds, at each corner, the strongest group across them and
        # the strength of the second strongest. The second pass joins, because the number of groups must be
        # known before.
        for join_pass in range(2):
            for h in range(offsets[c], offsets[c + 1]):
                f = faces[h]
                side = 0 if face_cells[f, 0] == c else 1
                neighbour = face_cells[f, 1 - side]
                # Skip the boundary, later cells (they will visit this cell) and weak faces.
                if neighbour < 0 or rank[neighbour] > rank[c] or coupling[f] * weak < stiffness[c]:
                    continue
                for k in range(2):
                    corner, root = ends[f, side, k], _root(parents, ends[f, 1 - side, k])
                    # With a single group across the corner, second is 0 and the corner joins.
                    if join_pass:
                        group = _root(parents, corner)
                        if group != root and stiffness[c] * comparable >= second[corner]:
                            parents[group], strength[root] = root, max(strength[group], strength[root])
                    elif strength[root] > best[corner]:
                        strongest[corner], best[corner], second[corner] = root, strength[root], best[corner]
                    elif root != strongest[corner]:
                        second[corner] = max(second[corner], strength[root])
    # Each group is an unknown. Corners are ordered by cell, so unknowns are numbered by their first cell.
    numbers, unknowns, count = np.full(m, -1), np.empty(m, np.int64), 0
    for i in range(m):
        root = _root(parents, i)
        if numbers[root] < 0:
            numbers[root] = count
            count += 1
        unknowns[i] = numbers[root]
    return unknowns, count


@helper
def _polynomials(x, y, box, table, lines, values):
    """Evaluate the unscaled basis polynomials of a cell at a point, and write them to ``values``."""
    degree = table.shape[1]
    x, y = along_box(x - box[0], y - box[1], box)
    legendre_at(x / box[2], degree, table, lines[0])
    legendre_at(y / box[3], degree, table, lines[1])
    k = 0
    for total in range(degree + 1):
        for j in range(total + 1):
            values[k] = lines[0, total - j] * lines[1, j]
            k += 1


@helper
def _add_point(weight, values, normal, n):
    """Add ``weight`` v vᵀ, with the polynomial values v at a point, to the lower half of ``normal``."""
    for i in range(n):
        t = weight * values[i]
        for j in range(i + 1):
            normal[i, j] += t * values[j]


@helper
def solve_rows(normal, right, n, count):
    """Replace the rows of ``right (count, n)`` by the solutions x of ``normal`` x = row.

    Only the lower half of the symmetric positive definite ``normal (n, n)`` is read. The Cholesky factor
    overwrites it.
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


@helper
def _grid_square(point, box, squares):
    """Return the square of a grid on the box of a cell in which a point lies."""
    x, y = along_box(point[0] - box[0], point[1] - box[1], box)
    column = min(int(squares * 0.5 * (1.0 + x / box[2])), squares - 1)
    row = min(int(squares * 0.5 * (1.0 + y / box[3])), squares - 1)
    return max(row, 0) * squares + max(column, 0)


@helper
def _add_edge(
    a, b, length, box, nodes, weights, table, lines, values, first, last, bubble, extra, normal, right
):
    """Add the quadrature along an edge to N and to the right-hand sides of its unknowns.

    ``normal`` is N, ``right[first]`` and ``right[last]`` belong to the ends, and ``extra`` rows from
    ``bubble`` on, if nonnegative, to the bubbles. ``length`` is that of the edge on the square [−1, 1]².
    """
    n = len(values)
    for q in range(len(nodes)):
        t, weight = nodes[q], weights[q] * length
        _polynomials(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), box, table, lines, values)
        _add_point(weight, values, normal, n)
        for j in range(n):
            right[first, j] += (1.0 - t) * weight * values[j]
            right[last, j] += t * weight * values[j]
        factor = 4.0 * t * (1.0 - t) * weight
        for k in range(extra if bubble >= 0 else 0):
            for j in range(n):
                right[bubble + k, j] += factor * values[j]
            factor *= 2.0 * t - 1.0


@helper
def _add_vertex(point, weight, box, table, lines, values, normal, row):
    """Add the value at a point, times a weight, to N and to the right-hand side ``row`` of its unknown."""
    _polynomials(point[0], point[1], box, table, lines, values)
    _add_point(weight, values, normal, len(values))
    for j in range(len(values)):
        row[j] += weight * values[j]


@helper
def _regularise(normal, degree, regularisation):
    """Add the squares of degree times coefficient to N, from degree 2 on."""
    k = 0
    for total in range(degree + 1):
        for _ in range(total + 1):
            normal[k, k] += regularisation * total * total if total > 1 else 0.0
            k += 1


@helper
def _most_unknowns(offsets, starts, most, extra):
    """Return the largest number of unknowns of a cell, at least ``most``."""
    largest = most
    for c in range(len(offsets) - 1):
        if starts[c + 1] - starts[c] <= most:
            largest = max(largest, starts[c + 1] - starts[c] + extra * (offsets[c + 1] - offsets[c]))
    return largest


@helper
def _make_orthogonal(right, bubble, first, last, orthogonal):
    """Add to each bubble of an edge its multiples of the end functions and of lower bubbles.

    The fit is linear in the trace, so solutions are combined instead of right-hand sides. The last bubble is
    first, because it needs the others unchanged.
    """
    for k in range(len(orthogonal) - 1, -1, -1):
        for j in range(right.shape[1]):
            right[bubble + k, j] += orthogonal[k, 0] * right[first, j]
            right[bubble + k, j] += orthogonal[k, 1] * right[last, j]
            for i in range(k):
                right[bubble + k, j] += orthogonal[k, 2 + i] * right[bubble + i, j]


@kernel
def fit_traces(
    points, offsets, faces, face_vertices, face_cells, ends, starts, unknowns, bubbles, isolated, orthogonal,
    boxes, scale, degree, nodes, weights, regularisation, squares, max_rows,
):  # fmt: skip
    """Fit a polynomial q_u on each cell to the boundary trace of each unknown's basis function.

    Returns each cell's unknowns, as offsets ``(n_cells + 1,)`` and indices, and the coefficients ``(·,
    n)`` of each q_u. The fit minimises ∫ (q − trace)² ds over the cell boundary, after mapping the bounding
    box to a square, plus ``regularisation`` times the squares of total degree times coefficient, from
    degree 2 on.

    The trace is linear between the corners of a face, plus the bubbles 4t(1 − t)(2t − 1)^k numbered from
    ``bubbles (F,)`` on, if nonnegative. On ``isolated (F,)`` faces, row k of ``orthogonal`` times the end
    functions and the bubbles is added to bubble k. A cell with more than ``squares²`` corners has one
    unknown per square of a grid on its box, taken from the first vertex there: the polynomial fits the
    values at these vertices. ``nodes`` and ``weights`` are a rule on [0, 1]; ``max_rows`` is an upper bound
    for the row count.
    """
    # 0. Workspaces. ``right`` has a row for each unknown of the largest cell.
    n, most, extra = (degree + 1) * (degree + 2) // 2, squares * squares, degree - 1
    counts, indices = np.zeros(len(offsets), np.int64), np.empty(max_rows, np.int32)
    fitted = np.empty((max_rows, n))
    widest = _most_unknowns(offsets, starts, most, extra)
    normal, right, values = np.empty((n, n)), np.empty((widest, n)), np.empty(n)
    place, square_points = np.empty(most, np.int64), np.empty((most, 2))
    table, lines = recurrences(degree), np.empty((2, degree + 1))
    position = 0
    for c in range(len(offsets) - 1):
        # 1. Corner unknowns come first, then bubbles. With ``use_grid`` the unknowns are only known
        # after the grid squares are.
        corners = starts[c + 1] - starts[c]
        box = boxes[c]
        use_grid = corners > most
        normal[:], place[:] = 0.0, -1
        right[: most if use_grid else corners + extra * (offsets[c + 1] - offsets[c])] = 0.0
        count = 0 if use_grid else corners
        for i in range(count):
            indices[position + i] = unknowns[starts[c] + i]
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            side = 0 if face_cells[f, 0] == c else 1
            # 2. The face length on the square [−1, 1]² weights its part of the integral.
            a, b = points[face_vertices[f, 0]], points[face_vertices[f, 1]]
            ex, ey = along_box(b[0] - a[0], b[1] - a[1], box)
            length = np.sqrt((ex / box[2]) ** 2 + (ey / box[3]) ** 2)
            # 3. Many corners: each end takes half of the length. The point is the first vertex found in the
            # grid square of the end: N and the right-hand side take the value there.
            if use_grid:
                for k in range(2):
                    v = face_vertices[f, k]
                    s = _grid_square(points[v], box, squares)
                    if place[s] < 0:
                        place[s], square_points[count] = count, points[v]
                        indices[position + count] = unknowns[ends[f, side, k]]
                        count += 1
                    i = place[s]
                    _add_vertex(square_points[i], 0.5 * length, box, table, lines, values, normal, right[i])
                continue
            # 4. Few corners: quadrature along the face. Add w p pᵀ to N, and w p times the functions 1 − t,
            # t and the bubbles to the right-hand sides. A corner collects contributions of both its faces.
            first, last = ends[f, side, 0] - starts[c], ends[f, side, 1] - starts[c]
            bubble = count if bubbles[f] >= 0 else -1
            _add_edge(
                a, b, length, box, nodes, weights, table, lines, values, first, last, bubble, extra, normal,
                right,
            )  # fmt: skip
            if bubbles[f] >= 0:
                for k in range(extra):
                    indices[position + count + k] = bubbles[f] + k
                count += extra
        # 5. The regularisation limits polynomials that vanish on the boundary. Constants and linear
        # functions are exempt, so that they are reproduced.
        _regularise(normal, degree, regularisation)
        solve_rows(normal, right, n, count)
        # 6. Make the bubbles of isolated faces orthogonal.
        column = corners
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            if use_grid or bubbles[f] < 0:
                continue
            if isolated[f]:
                side = 0 if face_cells[f, 0] == c else 1
                first, last = ends[f, side, 0] - starts[c], ends[f, side, 1] - starts[c]
                _make_orthogonal(right, column, first, last, orthogonal)
            column += extra
        # 7. Convert to coefficients of the scaled polynomials.
        for i in range(count):
            for j in range(n):
                fitted[position + i, j] = right[i, j] / scale[c]
        position += count
        counts[c + 1] = position
    return counts, indices[:position], fitted[:position]
