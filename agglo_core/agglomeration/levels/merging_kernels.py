"""Merge adjacent parts, roundest unions first, in rounds that visit only changed parts."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.geometry import distinct_vertices, largest_distance

_FINE = 2.0**40  # scores are rounded to multiples of 2^-40: the order of summation does not matter


@helper
def _renew_neighbours(c, lists, root, epochs, step, places, marks, stamp):
    """Replace the merged neighbours of part c by the parts that they merged into, without duplicates.

    For each part, ``lists`` contain a neighbour range (start, length), the shared interfaces, and whether
    each union fits: 1, 0, or −1 for unknown. ``epochs`` are the rounds in which parts last grew.
    """
    near, shared, fits, start, length = lists
    end = start[c]
    for h in range(start[c], start[c] + length[c]):
        r = near[h]
        while root[r] != r:
            r = root[r]
        if r == c:
            continue
        # 1. A union that did not fit never will, because unions only become wider. A union that fitted is
        #    unknown again after the neighbour has grown.
        fit = 0 if fits[h] == 0 else (-1 if epochs[r] == step else fits[h])
        # 2. Several neighbours may be one part now: their interfaces are added, and if any union did not fit,
        #    the new union does not fit. The list is overwritten in place.
        if marks[r] == stamp:
            g = places[r]
            shared[g] += shared[h]
            fits[g] = min(abs(fits[g]), abs(fit)) * -1
        else:
            marks[r], places[r] = stamp, end
            near[end], shared[end], fits[end] = r, shared[h], fit
            end += 1
    length[c] = end - start[c]


@helper(allocates=True)
def _boxes(vertex_offsets, vertices, points):
    """Return the bounding box per part: lowest and highest vertex coordinates."""
    n, d = len(vertex_offsets) - 1, points.shape[1]
    low, high = np.full((n, d), np.inf), np.full((n, d), -np.inf)
    for c in range(n):
        for h in range(vertex_offsets[c], vertex_offsets[c + 1]):
            for k in range(d):
                low[c, k] = min(low[c, k], points[vertices[h], k])
                high[c, k] = max(high[c, k], points[vertices[h], k])
    return low, high


@helper
def _union_fits(a, b, following, shapes, space, stamp, limit):
    """Return True if the union of parts a and b has a diameter of at most ``limit``."""
    vertex_offsets, vertices, points, low, high = shapes
    members, marks, unique, centre = space
    longest, diagonal = 0.0, 0.0
    # 1. The diameter lies between the longest side and the diagonal of the box around both.
    for k in range(len(centre)):
        side = max(high[a, k], high[b, k]) - min(low[a, k], low[b, k])
        longest = max(longest, side)
        diagonal += side * side
    if longest > limit * (1.0 + 1e-12) or np.sqrt(diagonal) < limit * (1.0 - 1e-12):
        return longest <= limit
    # 2. If these bounds do not decide, measure the diameter over the vertices of all members of both parts.
    count = 0
    for part in (a, b):
        member = part
        while member >= 0:
            members[count] = member
            count += 1
            member = following[member]
    m = distinct_vertices(stamp, members[:count], vertex_offsets, vertices, points, marks, unique, centre)
    return largest_distance(m, unique, centre, points) <= limit


@helper
def _partner(c, lists, outline, owner, following, shapes, space, stamps, limit):
    """Find the neighbour with which part c forms the roundest admissible union, or −1 if there is none.

    Both parts lie in one block. Ties go to the larger part numbers: compare the smaller number first, then
    the larger number. This order is total and symmetric in both parts.
    """
    near, shared, fits, start, length = lists
    best, partner, row, column = -1.0, -1, -1, -1
    for h in range(start[c], start[c] + length[c]):
        r = near[h]
        if owner[r] != owner[c] or fits[h] == 0:
            continue
        # 1. Score: share of both outlines that would become interior, rounded.
        score = np.rint(_FINE * shared[h] / (outline[c] + outline[r]))
        low, high = min(c, r), max(c, r)
        if score < best or (score == best and (low < row or (low == row and high < column))):
            continue
        # 2. Test only a union with the best score so far, because diameters are expensive.
        if fits[h] < 0:
            stamps[0] += 1
            fits[h] = 1 if _union_fits(c, r, following, shapes, space, stamps[0], limit) else 0
        if fits[h]:
            best, partner, row, column = score, r, low, high
    return partner


@helper(allocates=True)
def _compact_lists(lists, root):
    """Move the neighbour lists of the remaining parts to the front of the arrays, and return their end."""
    near, shared, fits, start, length = lists
    old = near.copy(), shared.copy(), fits.copy()
    end = 0
    for c in range(len(root)):
        if root[c] == c:
            for h in range(start[c], start[c] + length[c]):
                near[end + h - start[c]], shared[end + h - start[c]] = old[0][h], old[1][h]
                fits[end + h - start[c]] = old[2][h]
            start[c] = end
            end += length[c]
    return end


@helper
def _append(lists, a, b, top):
    """Write the joint neighbour list of parts a and b from index ``top`` on, and return its end.

    Part a then owns the list. Whether unions fit is unknown, except for unions that did not fit before.
    """
    near, shared, fits, start, length = lists
    end = top
    for part in (a, b):
        for h in range(start[part], start[part] + length[part]):
            near[end], shared[end], fits[end] = near[h], shared[h], -abs(fits[h])
            end += 1
    start[a], length[a] = top, end - top
    return end


@kernel
def merge_by_proposals(indptr, indices, interface, boundary, owner, vertex_offsets, vertices, points, limit):
    """Merge parts that are each other's best neighbour, and return each union's smallest part index ``(n,)``.

    Parts of different ``owner (n,)`` do not merge. In each round every part proposes to the neighbour that
    gives the roundest union (by the outline share that becomes interior) with diameter at most ``limit``.
    Mutual proposals merge. Only merged parts and their neighbours can change their proposals, so a round
    visits only these.
    """
    n = len(owner)
    # 1. Neighbour lists, which grow to the right. The members of a part form a chain (``following``,
    #    ``last``).
    capacity = 2 * len(indices)  # merged lists are appended; the lists in use fill at most half of the arrays
    near, shared, fits = np.empty(capacity, np.int64), np.empty(capacity), np.full(capacity, -1, np.int64)
    for h in range(len(indices)):
        near[h], shared[h] = indices[h], interface[h]
    start, length = indptr[:-1].astype(np.int64), np.empty(n, np.int64)
    root, following, last = np.arange(n), np.full(n, -1, np.int64), np.arange(n)
    outline, sides = np.empty(n), boundary.copy()
    # 2. Outlines: boundary of the domain plus interfaces. ``sides`` contains the boundary alone.
    for c in range(n):
        length[c] = indptr[c + 1] - indptr[c]
        outline[c] = boundary[c]
        for h in range(indptr[c], indptr[c + 1]):
            outline[c] += interface[h]
    lists, top = (near, shared, fits, start, length), len(indices)
    # 3. Bounding boxes of the parts, and workspace for the diameters.
    low, high = _boxes(vertex_offsets, vertices, points)
    shapes = (vertex_offsets, vertices, points, low, high)
    space = (
        np.empty(n, np.int64),
        np.full(len(points), -1, np.int64),
        np.empty(len(points), np.int64),
        np.empty(points.shape[1]),
    )
    partner, epochs, listed = np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    places, marks, stamps = np.empty(n, np.int64), np.full(n, -1, np.int64), np.zeros(2, np.int64)
    proposers, pairs = np.arange(n), np.empty(n, np.int64)
    count, step = n, 0
    while count > 0:
        # 4. Each changed part proposes to a neighbour. The other proposals remain valid.
        for q in range(count):
            c = proposers[q]
            stamps[1] += 1
            _renew_neighbours(c, lists, root, epochs, step, places, marks, stamps[1])
            partner[c] = _partner(c, lists, outline, owner, following, shapes, space, stamps, limit)
        # 5. Mutual proposals become pairs, each listed once by its smaller number.
        merging = 0
        for q in range(count):
            c = proposers[q]
            b = partner[c]
            if b >= 0 and partner[b] == c and epochs[c] != step + 1:
                a, b = min(b, c), max(b, c)
                epochs[a] = epochs[b] = step + 1
                pairs[merging] = a
                merging += 1
        # 6. Merge the pairs: lists, chains of members, boxes. Compact the lists when the arrays are full.
        step += 1
        for q in range(merging):
            a = pairs[q]
            b = partner[a]
            if top + length[a] + length[b] > capacity:
                top = _compact_lists(lists, root)
            top = _append(lists, a, b, top)
            root[b], following[last[a]], last[a] = a, b, last[b]
            sides[a] += sides[b]
            for k in range(points.shape[1]):
                low[a, k], high[a, k] = min(low[a, k], low[b, k]), max(high[a, k], high[b, k])
        # 7. The outline of a union is its boundary plus the remaining interfaces. The union and its
        #    neighbours propose again in the next round.
        count = 0
        for q in range(merging):
            a = pairs[q]
            stamps[1] += 1
            _renew_neighbours(a, lists, root, epochs, step, places, marks, stamps[1])
            outline[a] = sides[a]
            for h in range(start[a], start[a] + length[a]):
                outline[a] += shared[h]
            for h in range(start[a] - 1, start[a] + length[a]):
                c = a if h < start[a] else near[h]
                if listed[c] != step:
                    listed[c] = step
                    proposers[count] = c
                    count += 1
    for c in range(n):
        root[c] = root[root[c]]  # the smaller number comes first and is already resolved
    return root
