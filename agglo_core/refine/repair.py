"""Repair connectivity: choose the component that each part keeps, and join the other components to parts."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.graphs import components

_TIE = 1e-7  # relative: closer sizes, interfaces and positions count as equal (rounding far from the origin)


@helper
def _before(a, b, value_a, value_b, places):
    """Return True if component ``a`` precedes ``b``: by value, then by position.

    The values are ``value_a`` and ``value_b``, larger first. For equal values the component with the larger
    entry in ``places (components, k)`` comes first, at the first column where the entries differ.
    """
    if abs(value_a - value_b) > _TIE * max(value_a, value_b):
        return value_a > value_b
    for k in range(places.shape[1]):
        if abs(places[a, k] - places[b, k]) > _TIE:
            return places[a, k] > places[b, k]
    return a < b


@helper(allocates=True)
def keepers(part_of, sizes, places, n_parts):
    """Return the component that each part keeps ``(n_parts,)``: its largest, or −1 if the part is empty.

    Ties go to the first component by position. ``part_of``, ``sizes`` and ``places`` (lengths of order 1) are
    component arrays.
    """
    keeper = np.full(n_parts, -1)
    for c in range(len(part_of)):
        best = keeper[part_of[c]]
        if best < 0 or _before(c, best, sizes[c], sizes[best], places):
            keeper[part_of[c]] = c
    return keeper


@helper(allocates=True)
def absorb(indptr, indices, interface, start_parts, nodes, component_offsets, loose, keeper, places):
    """Join the ``loose`` components to adjacent parts, ring by ring, and return the part per node.

    ``start_parts`` is the part of the remaining nodes, and −1 elsewhere. ``loose`` lists components, whose
    nodes are ``nodes[component_offsets[c]:component_offsets[c + 1]]``. All components adjacent to nodes with
    a part choose at once and join, then the next ring of components. Each component chooses the part with the
    longest common interface. Ties go to the part whose ``keeper`` comes first by ``places``. Unreachable
    nodes remain at −1.
    """
    parts = start_parts.copy()
    queue = loose.copy()
    shared = np.zeros(len(keeper))
    touched = np.empty(len(keeper), np.int64)
    choice = np.empty(len(loose), np.int64)
    m = len(queue)
    while m > 0:
        # 1. For each waiting component, sum the interface with each adjacent part. The tiny addend
        #    distinguishes parts adjacent through faces of measure 0 from parts that are not adjacent.
        for w in range(m):
            c, count = queue[w], 0
            for k in range(component_offsets[c], component_offsets[c + 1]):
                for h in range(indptr[nodes[k]], indptr[nodes[k] + 1]):
                    p = parts[indices[h]]
                    if p >= 0:
                        if shared[p] == 0.0:
                            touched[count] = p
                            count += 1
                        shared[p] += interface[h] + 1e-300
            # 2. Choose the part with the longest interface, ties by the keeper's position, and clear the
            #    sums.
            choice[w] = -1
            for t in range(count):
                p, best = touched[t], choice[w]
                if best < 0 or _before(keeper[p], keeper[best], shared[p], shared[best], places):
                    choice[w] = p
            for t in range(count):
                shared[touched[t]] = 0.0
        # 3. All components with a choice join, the others wait for the next ring. As all choose first, the
        #    result does not depend on their order.
        n_remaining = 0
        for w in range(m):
            c = queue[w]
            if choice[w] < 0:
                queue[n_remaining] = c
                n_remaining += 1
                continue
            for k in range(component_offsets[c], component_offsets[c + 1]):
                parts[nodes[k]] = choice[w]
        # 4. Nothing joined: the remaining components touch no part.
        if n_remaining == m:
            break
        m = n_remaining
    return parts


@helper(allocates=True)
def _places(cells, centroids, nodes, offsets):
    """Return sort keys ``(components, 3 + d)`` of order 1 for the components' positions.

    The first three columns are invariant under rotation, reflection, translation and scaling of the mesh: the
    projection onto the mean position, the projection onto the mean weighted by squared distance, and the
    squared distance from the middle. Coordinates follow for symmetric labels, where the invariants are equal.
    """
    count, d, n = len(offsets) - 1, centroids.shape[1], len(nodes)
    places, mean = np.zeros((count, 3 + d)), np.zeros(d)
    # 1. The middle of the piece: the mean of its centroids.
    for k in range(n):
        for x in range(d):
            mean[x] += centroids[cells[nodes[k]], x] / n
    # 2. Last columns: mean centroid of each component relative to the middle, in units of the largest
    #    distance.
    furthest = 0.0
    for c in range(count):
        square, m = 0.0, offsets[c + 1] - offsets[c]
        for x in range(d):
            for k in range(offsets[c], offsets[c + 1]):
                places[c, 3 + x] += centroids[cells[nodes[k]], x]
            places[c, 3 + x] = places[c, 3 + x] / m - mean[x]
            square += places[c, 3 + x] ** 2
        furthest = max(furthest, np.sqrt(square))
    # 3. Column 2: squared distance r². Also the component means of the positions x, and of r² x.
    plain_mean, weighted_mean = np.zeros(d), np.zeros(d)
    for c in range(count):
        for x in range(d):
            places[c, 3 + x] /= furthest if furthest > 0.0 else 1.0
            places[c, 2] += places[c, 3 + x] ** 2
        for x in range(d):
            plain_mean[x] += places[c, 3 + x] / count
            weighted_mean[x] += places[c, 2] * places[c, 3 + x] / count
    # 4. Columns 0 and 1: projections onto these two means.
    for c in range(count):
        for x in range(d):
            places[c, 0] += places[c, 3 + x] * plain_mean[x]
            places[c, 1] += places[c, 3 + x] * weighted_mean[x]
    return places


@helper(allocates=True)
def _piece(cells, indptr, indices, interface, local):
    """Extract the subgraph of the piece ``cells`` as a CSR.

    The cells are in ascending order. Cells are renumbered in this order. ``local (n,)`` is a workspace.
    """
    # 1. Number the cells, and count their entries.
    m, count = len(cells), 0
    for i in range(m):
        local[cells[i]] = i
        count += indptr[cells[i] + 1] - indptr[cells[i]]
    # ``local`` is not cleared between pieces: a number is valid only if it leads back to the cell.
    rows, columns, lengths = np.zeros(m + 1, np.int64), np.empty(count, np.int32), np.empty(count)
    filled = 0
    for i in range(m):
        for h in range(indptr[cells[i]], indptr[cells[i] + 1]):
            j = local[indices[h]]
            if j < m and cells[j] == indices[h]:
                columns[filled], lengths[filled] = j, interface[h]
                filled += 1
        rows[i + 1] = filled
    return rows, columns, lengths


@helper(allocates=True)
def mend_piece(cells, labels, parts, indptr, indices, interface, centroids, measures, local):
    """Connect all ``parts`` within the connected piece ``cells (m,)``.

    Returns the labels ``(m,)``. Each part keeps its largest component, and the other components are absorbed.
    Unreachable nodes get −1. ``cells`` are in ascending order. ``local (n,)`` is a workspace of cell numbers,
    all in ``0..n-1``.
    """
    rows, columns, lengths = _piece(cells, indptr, indices, interface, local)
    # 1. Components of the parts within the piece, with the part and the measure of each component.
    nodes, offsets = components(rows, columns, labels)
    count = len(offsets) - 1
    part_of, size, loose = np.empty(count, np.int64), np.zeros(count), np.empty(count, np.int64)
    for c in range(count):
        part_of[c] = labels[nodes[offsets[c]]]
        for k in range(offsets[c], offsets[c + 1]):
            size[c] += measures[cells[nodes[k]]]
    # 2. Each part keeps its largest component. The nodes of the other components lose their label.
    places = _places(cells, centroids, nodes, offsets)
    keeper = keepers(part_of, size, places, parts)
    start_parts, n_loose = labels.copy(), 0
    for c in range(count):
        if keeper[part_of[c]] != c:
            loose[n_loose] = c
            n_loose += 1
            for k in range(offsets[c], offsets[c + 1]):
                start_parts[nodes[k]] = -1
    # 3. These components join adjacent parts, ring by ring.
    return absorb(rows, columns, lengths, start_parts, nodes, offsets, loose[:n_loose], keeper, places)


@kernel
def mend_sides(pieces, cells, tag, indptr, indices, interface, centroids, measures, local):
    """Connect both sides of each piece in ``pieces (P, 2)``, slices of ``cells`` with side tags.

    See ``piece_splits`` for cells and tags, and :func:`mend_piece` for ``local``.
    """
    for p in range(len(pieces)):
        lo, hi = pieces[p, 0], pieces[p, 1]
        # 1. Sides of the piece's cells.
        piece_cells, sides = np.empty(hi - lo, np.int32), np.empty(hi - lo, np.int64)
        for k in range(hi - lo):
            piece_cells[k], sides[k] = cells[lo + k], tag[cells[lo + k]] & 1
        # 2. Connect both sides, and write the new tags.
        new_sides = mend_piece(piece_cells, sides, 2, indptr, indices, interface, centroids, measures, local)
        for k in range(hi - lo):
            tag[piece_cells[k]] = 2 * hi - 1 if new_sides[k] else 2 * lo


@kernel
def mend_blocks(offsets, indptr, indices, interface, centroids, measures, labels, parts):
    """Return labels ``(n,)`` with every part of every block connected.

    Labels are in 0..parts−1, and −1 for unreachable nodes.
    """
    mended, local = np.empty(len(labels), np.int64), np.zeros(len(labels), np.int32)
    for b in range(len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        cells, block_labels = np.empty(stop - start, np.int32), np.empty(stop - start, np.int64)
        for i in range(stop - start):  # loops, because slices and ranges take seconds to compile
            cells[i], block_labels[i] = start + i, labels[start + i]
        new_labels = mend_piece(
            cells, block_labels, parts, indptr, indices, interface, centroids, measures, local
        )
        for i in range(stop - start):
            mended[start + i] = new_labels[i]
    return mended
