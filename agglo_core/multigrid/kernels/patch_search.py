"""Patches of a mesh: distinct sets of parts around its vertices, with no set inside another."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def parts_at_vertices(cell_offsets, cell_vertices, vertex_groups, labels, n_groups, n_parts, most):
    """Collect the distinct sets of 2 to ``most`` parts around a vertex or vertex group, as CSR.

    Cell c has the vertices ``cell_vertices[cell_offsets[c]:cell_offsets[c + 1]]`` and the part ``labels[c]``.
    ``vertex_groups`` is the group per vertex. Parts ascend within sets, and sets follow their first
    group.
    """
    # 1. Parts of the cells around each group, with repetitions, by counting sort.
    starts = np.zeros(n_groups + 1, np.int64)
    for h in range(len(cell_vertices)):
        starts[vertex_groups[cell_vertices[h]] + 1] += 1
    for g in range(n_groups):
        starts[g + 1] += starts[g]
    around = np.empty(len(cell_vertices), np.int32)
    cursor = starts[:-1].copy()
    for c in range(len(cell_offsets) - 1):
        for h in range(cell_offsets[c], cell_offsets[c + 1]):
            g = vertex_groups[cell_vertices[h]]
            around[cursor[g]] = labels[c]
            cursor[g] += 1

    offsets = np.zeros(n_groups + 1, np.int64)
    parts = np.empty(len(cell_vertices), np.int32)
    latest = np.full(n_parts, -1, np.int64)  # last set that begins with a part,
    previous = np.empty(n_groups, np.int64)  # and the previous set
    count, filled = 0, 0
    for g in range(n_groups):
        # 2. Distinct parts around the group, insertion-sorted into the free end of ``parts``.
        size = 0
        for h in range(starts[g], starts[g + 1]):
            part = around[h]
            at = filled + size
            while at > filled and parts[at - 1] > part:
                at -= 1
            if at > filled and parts[at - 1] == part:
                continue
            for k in range(filled + size, at, -1):
                parts[k] = parts[k - 1]
            parts[at] = part
            size += 1
        # 3. A single part is no patch, and more than ``most`` parts would need a large dense matrix.
        if size < 2 or size > most:
            continue
        # 4. Compare with previous sets that begin with the same part. A repeated set is overwritten by the
        #    next, as ``filled`` stays.
        first = parts[filled]
        candidate = latest[first]
        while candidate >= 0:
            start = offsets[candidate]
            matches = offsets[candidate + 1] - start == size
            k = 1
            while matches and k < size:
                matches = parts[start + k] == parts[filled + k]
                k += 1
            if matches:
                break
            candidate = previous[candidate]
        if candidate < 0:
            previous[count] = latest[first]
            latest[first] = count
            count += 1
            filled += size
            offsets[count] = filled
    return offsets[: count + 1].copy(), parts[:filled].copy()


@helper
def _comes_before(parts, offsets, s, t):
    """Return True if set s precedes set t in lexicographic order."""
    sizes = offsets[s + 1] - offsets[s], offsets[t + 1] - offsets[t]
    for k in range(min(sizes[0], sizes[1])):
        a, b = parts[offsets[s] + k], parts[offsets[t] + k]
        if a != b:
            return a < b
    return sizes[0] < sizes[1]


@kernel
def without_contained(offsets, parts, n_parts):
    """Drop sets contained in larger sets, and add a set for each part that is in no set.

    Sets are CSR, distinct, with ascending parts, also in the result. The set order is lexicographic.
    """
    # 1. The sets that contain each part.
    count = len(offsets) - 1
    starts = np.zeros(n_parts + 1, np.int64)
    for h in range(len(parts)):
        starts[parts[h] + 1] += 1
    for p in range(n_parts):
        starts[p + 1] += starts[p]
    holders = np.empty(len(parts), np.int64)
    cursor = starts[:-1].copy()
    for s in range(count):
        for h in range(offsets[s], offsets[s + 1]):
            holders[cursor[parts[h]]] = s
            cursor[parts[h]] += 1

    first_of = np.full(n_parts, -1, np.int64)  # remaining sets, linked by smallest part
    following = np.empty(count, np.int64)
    n_sets, n_members = 0, 0
    for s in range(count):
        # 2. A larger set that contains s also contains its rarest part: compare only sets with this part.
        rare = parts[offsets[s]]
        for h in range(offsets[s] + 1, offsets[s + 1]):
            if starts[parts[h] + 1] - starts[parts[h]] < starts[rare + 1] - starts[rare]:
                rare = parts[h]
        size = offsets[s + 1] - offsets[s]
        contained = False
        for i in range(starts[rare], starts[rare + 1]):
            t = holders[i]
            if offsets[t + 1] - offsets[t] <= size:
                continue
            # Both ascend: one pass, stopped when t has fewer members left than s needs.
            h, k = offsets[s], offsets[t]
            while h < offsets[s + 1] and offsets[t + 1] - k >= offsets[s + 1] - h:
                if parts[h] == parts[k]:
                    h += 1
                k += 1
            if h == offsets[s + 1]:
                contained = True
                break
        if contained:
            continue
        # 3. Insert s into the ascending list for its smallest part.
        first = parts[offsets[s]]
        before, after = -1, first_of[first]
        while after >= 0 and _comes_before(parts, offsets, after, s):
            before, after = after, following[after]
        following[s] = after
        if before < 0:
            first_of[first] = s
        else:
            following[before] = s
        n_sets += 1
        n_members += size

    # 4. For each part write its list of sets, or the part itself if it is in no set.
    alone = 0
    for p in range(n_parts):
        alone += starts[p] == starts[p + 1]
    new_offsets = np.zeros(n_sets + alone + 1, np.int64)
    new_parts = np.empty(n_members + alone, np.int32)
    n_sets, n_members = 0, 0
    for p in range(n_parts):
        if starts[p] == starts[p + 1]:
            new_parts[n_members] = p
            n_members += 1
            n_sets += 1
            new_offsets[n_sets] = n_members
        s = first_of[p]
        while s >= 0:
            for h in range(offsets[s], offsets[s + 1]):
                new_parts[n_members] = parts[h]
                n_members += 1
            n_sets += 1
            new_offsets[n_sets] = n_members
            s = following[s]
    return new_offsets, new_parts


@kernel
def unite_pairs(pairs, n_parts, most):
    """Merge parts into sets of at most ``most`` parts by uniting ``pairs (m, 2)`` in order.

    A pair with a larger union is skipped. Returns the sets as CSR, sorted by smallest part.
    """
    # 1. Sets are trees with the smallest part as root. Paths are halved during searches.
    above = np.arange(n_parts)  # towards the smallest part of a set
    size = np.ones(n_parts, np.int64)
    for h in range(len(pairs)):
        a, b = pairs[h, 0], pairs[h, 1]
        while above[a] != a:
            above[a] = above[above[a]]
            a = above[a]
        while above[b] != b:
            above[b] = above[above[b]]
            b = above[b]
        if a != b and size[a] + size[b] <= most:
            a, b = min(a, b), max(a, b)
            above[b] = a
            size[a] += size[b]
    # 2. Number the sets by their roots. Roots come before all other parts, and parents before children.
    number = np.empty(n_parts, np.int64)
    offsets = np.zeros(n_parts + 1, np.int64)
    count = 0
    for p in range(n_parts):
        if above[p] == p:
            number[p] = count
            count += 1
            offsets[count] = offsets[count - 1] + size[p]
        else:
            number[p] = number[above[p]]
    # 3. Parts by set, ascending.
    cursor = offsets[:count].copy()
    parts = np.empty(n_parts, np.int32)
    for p in range(n_parts):
        parts[cursor[number[p]]] = p
        cursor[number[p]] += 1
    return offsets[: count + 1].copy(), parts
