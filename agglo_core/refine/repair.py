"""Connectivity repair: which component of a part stays, and which part each of the others joins."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.graphs import components

_TIE = 1e-7  # relative: closer sizes, interfaces and places count as equal (rounding far from the origin)


@helper
def _before(one, other, value, beside, places):
    """Return whether component ``one`` comes before ``other``: by value, of equal ones by their places.

    The values are ``value`` and ``beside``, the larger one first. Of equal ones that component is first whose
    ``places (components, k)`` are larger where they first differ.
    """
    if abs(value - beside) > _TIE * max(value, beside):
        return value > beside
    for k in range(places.shape[1]):
        if abs(places[one, k] - places[other, k]) > _TIE:
            return places[one, k] > places[other, k]
    return one < other


@helper(allocates=True)
def keepers(part_of, sizes, places, n_parts):
    """Component that each part keeps ``(n_parts,)``: its largest, of equal ones the foremost, or −1.

    ``part_of``, ``sizes`` and ``places`` (lengths of order 1) are those of the components.
    """
    kept = np.full(n_parts, -1)
    for c in range(len(part_of)):
        best = kept[part_of[c]]
        if best < 0 or _before(c, best, sizes[c], sizes[best], places):
            kept[part_of[c]] = c
    return kept


@helper(allocates=True)
def absorb(indptr, indices, interface, kept, nodes, component_offsets, loose, keeper, places):
    """Part of each node once every loose component has joined a kept one.

    ``kept`` is the part of the nodes that stay, −1 elsewhere; ``loose`` lists components, whose nodes
    are ``nodes[component_offsets[c]:component_offsets[c + 1]]``. All components that touch nodes with
    a part choose at once and join; then the next ring of components. Each chooses the part with which it
    shares the most interface, of equal ones the part whose ``keeper`` comes first by the ``places``. A node
    left at −1 cannot be reached.
    """
    parts = kept.copy()
    waiting = loose.copy()
    shared = np.zeros(len(keeper))
    touched = np.empty(len(keeper), np.int64)
    choice = np.empty(len(loose), np.int64)
    m = len(waiting)
    while m > 0:
        # 1. For each component that waits, the interface with each part that it touches. The tiny addend
        #    tells parts touched through faces of measure 0 from those not touched.
        for w in range(m):
            c, count = waiting[w], 0
            for k in range(component_offsets[c], component_offsets[c + 1]):
                for h in range(indptr[nodes[k]], indptr[nodes[k] + 1]):
                    p = parts[indices[h]]
                    if p >= 0:
                        if shared[p] == 0.0:
                            touched[count] = p
                            count += 1
                        shared[p] += interface[h] + 1e-300
            # 2. It chooses the part with the most interface, of equal ones that of the foremost keeper, and
            #    clears the sums.
            choice[w] = -1
            for t in range(count):
                p, best = touched[t], choice[w]
                if best < 0 or _before(keeper[p], keeper[best], shared[p], shared[best], places):
                    choice[w] = p
            for t in range(count):
                shared[touched[t]] = 0.0
        # 3. All that have chosen join, the others wait for the next ring. As all choose first, the result
        #    does not depend on their order.
        left = 0
        for w in range(m):
            c = waiting[w]
            if choice[w] < 0:
                waiting[left] = c
                left += 1
                continue
            for k in range(component_offsets[c], component_offsets[c + 1]):
                parts[nodes[k]] = choice[w]
        # 4. Nothing joined: what is left touches no part.
        if left == m:
            break
        m = left
    return parts


@helper(allocates=True)
def _places(cells, centroids, nodes, offsets):
    """Places of the components in a piece, ``(components, 3 + d)`` numbers of order 1.

    The first three do not change if the mesh is turned, mirrored, moved or scaled: how far along the mean
    of all components from the middle, and along their mean weighted by squared distance, and the squared
    distance itself. Coordinates are for labels that have a symmetry, where those are equal.
    """
    count, d, n = len(offsets) - 1, centroids.shape[1], len(nodes)
    places, mean = np.zeros((count, 3 + d)), np.zeros(d)
    # 1. The middle of the piece: the mean of its centroids.
    for k in range(n):
        for x in range(d):
            mean[x] += centroids[cells[nodes[k]], x] / n
    # 2. Last columns: mean centroid of each component about the middle, in units of the largest distance.
    furthest = 0.0
    for c in range(count):
        square, m = 0.0, offsets[c + 1] - offsets[c]
        for x in range(d):
            for k in range(offsets[c], offsets[c + 1]):
                places[c, 3 + x] += centroids[cells[nodes[k]], x]
            places[c, 3 + x] = places[c, 3 + x] / m - mean[x]
            square += places[c, 3 + x] ** 2
        furthest = max(furthest, np.sqrt(square))
    # 3. Column 2: squared distance r². Means over the components of their positions x, and of r² x.
    along, heavy = np.zeros(d), np.zeros(d)
    for c in range(count):
        for x in range(d):
            places[c, 3 + x] /= furthest if furthest > 0.0 else 1.0
            places[c, 2] += places[c, 3 + x] ** 2
        for x in range(d):
            along[x] += places[c, 3 + x] / count
            heavy[x] += places[c, 2] * places[c, 3 + x] / count
    # 4. Columns 0 and 1: projections onto these two means.
    for c in range(count):
        for x in range(d):
            places[c, 0] += places[c, 3 + x] * along[x]
            places[c, 1] += places[c, 3 + x] * heavy[x]
    return places


@helper(allocates=True)
def _piece(cells, indptr, indices, interface, local):
    """CSR of the piece ``cells``, which are ascending and numbered in that order.

    ``local (n,)`` is a work array.
    """
    m, count = len(cells), 0
    for i in range(m):
        local[cells[i]] = i
        count += indptr[cells[i] + 1] - indptr[cells[i]]
    # ``local`` is not cleared between pieces: a number counts only if it leads back to the cell.
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
    """Labels ``(m,)`` of the connected piece ``cells (m,)``, every one of the ``parts`` connected.

    Each keeps its largest component; the others are absorbed. Nodes that cannot be reached have −1.
    ``cells`` are ascending; ``local (n,)`` is a work array of cell numbers, all in ``0..n-1``.
    """
    rows, columns, lengths = _piece(cells, indptr, indices, interface, local)
    # 1. Components of the parts, within the piece; the part and the measure of each.
    nodes, offsets = components(rows, columns, labels)
    count = len(offsets) - 1
    part_of, size, loose = np.empty(count, np.int64), np.zeros(count), np.empty(count, np.int64)
    for c in range(count):
        part_of[c] = labels[nodes[offsets[c]]]
        for k in range(offsets[c], offsets[c + 1]):
            size[c] += measures[cells[nodes[k]]]
    # 2. Each part keeps its largest component; the nodes of the others lose their label.
    places = _places(cells, centroids, nodes, offsets)
    keeper = keepers(part_of, size, places, parts)
    kept, found = labels.copy(), 0
    for c in range(count):
        if keeper[part_of[c]] != c:
            loose[found] = c
            found += 1
            for k in range(offsets[c], offsets[c + 1]):
                kept[nodes[k]] = -1
    # 3. These components join the parts around them, ring by ring.
    return absorb(rows, columns, lengths, kept, nodes, offsets, loose[:found], keeper, places)


@kernel
def mend_sides(pieces, cells, tag, indptr, indices, interface, centroids, measures, local):
    """Connect both sides of each of the connected ``pieces (P, 2)``, slices of ``cells`` with tags.

    See ``piece_splits`` for cells and tags, and :func:`mend_piece` for ``local``.
    """
    for p in range(len(pieces)):
        lo, hi = pieces[p, 0], pieces[p, 1]
        own, sides = np.empty(hi - lo, np.int32), np.empty(hi - lo, np.int64)
        for k in range(hi - lo):
            own[k], sides[k] = cells[lo + k], tag[cells[lo + k]] & 1
        found = mend_piece(own, sides, 2, indptr, indices, interface, centroids, measures, local)
        for k in range(hi - lo):
            tag[own[k]] = 2 * hi - 1 if found[k] else 2 * lo


@kernel
def mend_blocks(offsets, indptr, indices, interface, centroids, measures, labels, parts):
    """Labels ``(n,)`` with every part of every block connected.

    They are 0..parts−1, and −1 where no part is reached.
    """
    mended, local = np.empty(len(labels), np.int64), np.zeros(len(labels), np.int32)
    for b in range(len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        cells, own = np.empty(stop - start, np.int32), np.empty(stop - start, np.int64)
        for i in range(stop - start):  # slices and ranges compile for seconds
            cells[i], own[i] = start + i, labels[start + i]
        found = mend_piece(cells, own, parts, indptr, indices, interface, centroids, measures, local)
        for i in range(stop - start):
            mended[start + i] = found[i]
    return mended
