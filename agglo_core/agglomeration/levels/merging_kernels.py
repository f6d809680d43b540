"""Merging of neighbouring parts, the roundest unions first, in rounds that look only at what has changed."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel
from agglo_core.compiled.geometry import distinct_vertices, largest_distance

_FINE = (
    2.0**40
)  # scores that agree to so many parts of 1 are equal, whatever the order their sums were made in


@helper
def _renewed(c, lists, root, grown, now, places, seen, stamp):
    """Replace the neighbours of part c that have merged by what they merged into, each once.

    ``lists`` have, for each part, a range (start, length) of neighbours, the interface shared with each, and
    whether their union fits: 1, 0, or −1 where that is not known.
    """
    near, shared, fits, start, length = lists
    kept = start[c]
    for h in range(start[c], start[c] + length[c]):
        r = near[h]
        while root[r] != r:
            r = root[r]
        if r == c:
            continue
        # 1. A union that did not fit never will: unions only become wider. One that did is unknown again
        #    once the neighbour has grown.
        fit = 0 if fits[h] == 0 else (-1 if grown[r] == now else fits[h])
        # 2. Several neighbours that are one part now: interfaces are added, and if one did not fit, neither
        #    do all. The list is written over itself.
        if seen[r] == stamp:
            g = places[r]
            shared[g] += shared[h]
            fits[g] = min(abs(fits[g]), abs(fit)) * -1
        else:
            seen[r], places[r] = stamp, kept
            near[kept], shared[kept], fits[kept] = r, shared[h], fit
            kept += 1
    length[c] = kept - start[c]


@helper(allocates=True)
def _boxes(vertex_offsets, vertices, points):
    """Lowest and highest coordinates of the vertices of each part."""
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
    # 2. If these do not decide, it is measured between the vertices of all members of both parts.
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
    """Find the neighbour in its block with which part c makes the roundest union that fits, or −1.

    Of equally round ones that of the larger numbers counts: of the smaller part, then of the larger one.
    This order is total, and both parts of a union see it alike.
    """
    near, shared, fits, start, length = lists
    best, partner, row, column = -1.0, -1, -1, -1
    for h in range(start[c], start[c] + length[c]):
        r = near[h]
        if owner[r] != owner[c] or fits[h] == 0:
            continue
        # 1. The share of both outlines that would become interior, rounded.
        score = np.rint(_FINE * shared[h] / (outline[c] + outline[r]))
        one, two = min(c, r), max(c, r)
        if score < best or (score == best and (one < row or (one == row and two < column))):
            continue
        # 2. Only a union that is the best so far is tested, as diameters cost most.
        if fits[h] < 0:
            stamps[0] += 1
            fits[h] = 1 if _union_fits(c, r, following, shapes, space, stamps[0], limit) else 0
        if fits[h]:
            best, partner, row, column = score, r, one, two
    return partner


@helper(allocates=True)
def _compacted(lists, root):
    """Move the lists of all parts that are left to the front; return where they end."""
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
    """Make one list of the neighbours of parts a and b, from ``top`` on; return where it ends.

    It is the list of part a from then on. Whether unions with it fit is unknown, unless one did not.
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
def merged_parts(indptr, indices, interface, boundary, owner, vertex_offsets, vertices, points, limit):
    """Least number ``(n,)`` of the parts that each part has merged with, by rounds of mutual proposals.

    Parts of different ``owner (n,)`` do not merge. In each round every part proposes to the neighbour with
    which it makes the roundest union (the share of both outlines that becomes interior) of diameter ``limit``
    at most; mutual proposals merge. Only parts that have merged and their neighbours can change their minds:
    a round looks at no others.
    """
    n = len(owner)
    # 1. Lists of neighbours, which grow to the right; members of a part as a chain (``following``,
    #    ``last``).
    room = 2 * len(indices)  # lists of merged parts go behind the others; all that are in use fill half of it
    near, shared, fits = np.empty(room, np.int64), np.empty(room), np.full(room, -1, np.int64)
    for h in range(len(indices)):
        near[h], shared[h] = indices[h], interface[h]
    start, length = indptr[:-1].astype(np.int64), np.empty(n, np.int64)
    root, following, last = np.arange(n), np.full(n, -1, np.int64), np.arange(n)
    outline, sides = np.empty(n), boundary.copy()
    # 2. Outlines: boundary of the domain plus interfaces. ``sides`` has the boundary alone.
    for c in range(n):
        length[c] = indptr[c + 1] - indptr[c]
        outline[c] = boundary[c]
        for h in range(indptr[c], indptr[c + 1]):
            outline[c] += interface[h]
    lists, top = (near, shared, fits, start, length), len(indices)
    # 3. Boxes of the parts, and work arrays of the diameters.
    low, high = _boxes(vertex_offsets, vertices, points)
    shapes = (vertex_offsets, vertices, points, low, high)
    space = (
        np.empty(n, np.int64),
        np.full(len(points), -1, np.int64),
        np.empty(len(points), np.int64),
        np.empty(points.shape[1]),
    )
    partner, grown, listed = np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    places, seen, stamps = np.empty(n, np.int64), np.full(n, -1, np.int64), np.zeros(2, np.int64)
    asked, pairs = np.arange(n), np.empty(n, np.int64)
    count, now = n, 0
    while count > 0:
        # 4. Each part asked proposes to a neighbour. Proposals of the others stand: nothing about them
        #    changed.
        for q in range(count):
            c = asked[q]
            stamps[1] += 1
            _renewed(c, lists, root, grown, now, places, seen, stamps[1])
            partner[c] = _partner(c, lists, outline, owner, following, shapes, space, stamps, limit)
        # 5. Mutual proposals become pairs, listed by their smaller number, each once.
        merging = 0
        for q in range(count):
            c = asked[q]
            b = partner[c]
            if b >= 0 and partner[b] == c and grown[c] != now + 1:
                a, b = min(b, c), max(b, c)
                grown[a] = grown[b] = now + 1
                pairs[merging] = a
                merging += 1
        # 6. Pairs merge: lists, chains of members, boxes. Space of old lists is won back once all is used.
        now += 1
        for q in range(merging):
            a = pairs[q]
            b = partner[a]
            if top + length[a] + length[b] > room:
                top = _compacted(lists, root)
            top = _append(lists, a, b, top)
            root[b], following[last[a]], last[a] = a, b, last[b]
            sides[a] += sides[b]
            for k in range(points.shape[1]):
                low[a, k], high[a, k] = min(low[a, k], low[b, k]), max(high[a, k], high[b, k])
        # 7. The outline of a union is its boundary plus the interfaces that are left. The union and its
        #    neighbours are asked in the next round.
        count = 0
        for q in range(merging):
            a = pairs[q]
            stamps[1] += 1
            _renewed(a, lists, root, grown, now, places, seen, stamps[1])
            outline[a] = sides[a]
            for h in range(start[a], start[a] + length[a]):
                outline[a] += shared[h]
            for h in range(start[a] - 1, start[a] + length[a]):
                c = a if h < start[a] else near[h]
                if listed[c] != now:
                    listed[c] = now
                    asked[count] = c
                    count += 1
    for c in range(n):
        root[c] = root[root[c]]  # what it merged into comes first, and is done
    return root
