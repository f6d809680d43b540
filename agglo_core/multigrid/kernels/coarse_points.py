"""Classical coarsening: choice of the coarse unknowns, and interpolation of the others from them.

Unknowns that stay on the coarse level are the C-points of the literature, those that go its F-points.
Matrices are CSR with sorted columns and a symmetric pattern. Unknown i depends on j if −a_ij is at least θ
times the largest −a_ik of its row: that entry is strong.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@kernel
def strong_entries(indptr, indices, data, theta, least):
    """Mark the strong entries of a matrix and the unknowns that need the coarse level.

    An unknown does not need it if Σ_j |a_ij| over j ≠ i is at most ``least`` times a_ii: it has no strong
    entries either.
    """
    n = len(indptr) - 1
    strong = np.zeros(len(indices), np.bool_)
    needy = np.zeros(n, np.bool_)
    for i in range(n):
        own = 0.0
        total = 0.0
        most = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                own = data[k]
            else:
                total += abs(data[k])
                most = max(most, -data[k])
        # Only negative entries can be strong: a row without any has most = 0 and depends on none.
        needy[i] = total > least * own
        if needy[i] and most > 0.0:
            for k in range(indptr[i], indptr[i + 1]):
                strong[k] = indices[k] != i and -data[k] >= theta * most
    return strong, needy


@kernel
def coarse_points(indptr, indices, strong, needy):
    """Choose the unknowns that stay on the coarse level (Ruge, Stüben 1987, both passes).

    First the free unknown on which most others depend stays, and those others go; what these depend on is
    then worth more. Second, of two unknowns that go, one of which depends on the other, the first must
    depend on one that stays and the other depends on; else one of them stays too. An unknown that needs the
    coarse level and depends on none stays.
    """
    start, dependent, worth = _dependents(indptr, indices, strong)
    stays = _independent(indptr, indices, strong, start, dependent, worth)
    _second_pass(indptr, indices, strong, stays)
    for i in range(len(stays)):
        stays[i] = stays[i] or (needy[i] and not strong[indptr[i] : indptr[i + 1]].any())
    return stays


@helper(allocates=True)
def _dependents(indptr, indices, strong):
    """Return the unknowns that depend on each, as CSR, and their numbers."""
    # The strong entries transposed, by a counting sort.
    n = len(indptr) - 1
    start = np.zeros(n + 1, np.int64)
    for k in range(len(indices)):
        start[indices[k] + 1] += strong[k]
    worth = start[1:].astype(np.int32)
    start = np.cumsum(start)
    fill = start[:-1].copy()
    dependent = np.empty(start[n], np.int32)
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            if strong[k]:
                dependent[fill[indices[k]]] = i
                fill[indices[k]] += 1
    return start, dependent, worth


@helper(allocates=True)
def _independent(indptr, indices, strong, start, dependent, worth):
    """Choose C-points by the first pass of Ruge and Stüben.

    ``worth (n,)`` is the number of free unknowns that depend on each, plus twice those that have gone; it is
    changed. Free unknowns of one worth are a doubly linked list, the last changed at its head.
    """
    # Each dependent raises a worth once at most, when it goes: 2 · top bounds all worths.
    n = len(worth)
    top = worth.max()
    head = np.full(2 * top + 2, -1, np.int32)
    before = np.full(n, -1, np.int32)
    after = np.full(n, -1, np.int32)
    free = np.ones(n, np.bool_)
    stays = np.zeros(n, np.bool_)
    for i in range(n - 1, -1, -1):
        _link(i, worth, head, before, after)
    # 1. A free unknown of the largest worth stays. Those of worth 0 are left: no F-point depends on them.
    while top > 0:
        i = head[top]
        if i < 0:
            top -= 1
            continue
        _unlink(i, worth, head, before, after)
        free[i] = False
        stays[i] = True
        # 2. The free unknowns j that depend on it go; what j depends on is worth one more, since j can still
        #    interpolate from it.
        for m in range(start[i], start[i + 1]):
            j = dependent[m]
            if not free[j]:
                continue
            _unlink(j, worth, head, before, after)
            free[j] = False
            for k in range(indptr[j], indptr[j + 1]):
                q = indices[k]
                if strong[k] and free[q]:
                    _unlink(q, worth, head, before, after)
                    worth[q] += 1
                    _link(q, worth, head, before, after)
                    top = max(top, worth[q])
        # 3. What i depends on is worth one less: i itself needs no interpolation.
        for k in range(indptr[i], indptr[i + 1]):
            q = indices[k]
            if strong[k] and free[q]:
                _unlink(q, worth, head, before, after)
                worth[q] -= 1
                _link(q, worth, head, before, after)
    return stays


@helper
def _link(i, worth, head, before, after):
    """Put i at the head of the list of its worth."""
    old = head[worth[i]]
    head[worth[i]] = i
    before[i] = -1
    after[i] = old
    if old >= 0:
        before[old] = i


@helper
def _unlink(i, worth, head, before, after):
    """Take i out of the list of its worth."""
    if before[i] >= 0:
        after[before[i]] = after[i]
    else:
        head[worth[i]] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]


@helper(allocates=True)
def _second_pass(indptr, indices, strong, stays):
    """Add C-points to ``stays`` until strongly coupled F-points share one (Ruge, Stüben, second pass).

    Each F-point i is looked at once, in order: ``mark[j] == i`` says that i can interpolate from j.
    """
    n = len(stays)
    mark = np.full(n, -1, np.int32)
    for i in range(n):
        if stays[i]:
            continue
        for k in range(indptr[i], indptr[i + 1]):
            if strong[k] and stays[indices[k]]:
                mark[indices[k]] = i
        # Each F-point j that i depends on must depend on a C-point of i. The first j that does not becomes a
        # candidate, counted as a C-point of i from here on, and stays unless there is a second one.
        candidate = -1
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if not strong[k] or stays[j] or mark[j] == i:
                continue
            shared = False
            for m in range(indptr[j], indptr[j + 1]):
                if strong[m] and mark[indices[m]] == i:
                    shared = True
                    break
            if shared:
                continue
            if candidate >= 0:  # a second one: i itself settles both
                candidate = i
                break
            candidate = j
            mark[j] = i
        if candidate >= 0:
            stays[candidate] = True


@kernel
def classical_weights(indptr, indices, data, strong, stays, number):
    """Return the classical interpolation as CSR ``graph, to, weight``.

    A C-point has the weight 1; an F-point takes from all C-points that it depends on. ``number`` is the
    coarse number of each C-point. For an F-point i with the set C_i of these C-points the weights are w_ij =
    −(a_ij + Σ_m a_im ā_mj / Σ_l∈C_i ā_ml) / d_i, j ∈ C_i, the first sum over the other strong entries, with ā
    the negative part of a. The diagonal d_i is a_ii plus all entries that are not strong, and plus a_im where
    the row of m is not coupled to C_i.
    """
    n = len(stays)
    graph = np.zeros(n + 1, np.int32)
    for i in range(n):
        size = 1 if stays[i] else 0
        for k in range(indptr[i], indptr[i + 1]):
            size += (not stays[i]) and strong[k] and stays[indices[k]]
        graph[i + 1] = graph[i] + size
    to = np.empty(graph[n], np.int32)
    weight = np.empty(graph[n])
    slot = np.full(n, -1, np.int32)
    for i in range(n):
        # 1. The entries of C_i. ``slot`` is the place of a C-point; those before ``first`` are of other rows.
        first = graph[i]
        if stays[i]:
            to[first] = number[i]
            weight[first] = 1.0
            continue
        end = first
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if strong[k] and stays[j]:
                slot[j] = end
                to[end] = number[j]
                weight[end] = data[k]
                end += 1
        # 2. All other entries, the diagonal one among them: distributed over C_i, or added to d_i.
        own = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if strong[k] and stays[j]:
                continue
            common = 0.0
            if strong[k]:
                for p in range(indptr[j], indptr[j + 1]):
                    if slot[indices[p]] >= first:
                        common += min(data[p], 0.0)
            if common < 0.0:
                for p in range(indptr[j], indptr[j + 1]):
                    if slot[indices[p]] >= first:
                        weight[slot[indices[p]]] += data[k] * min(data[p], 0.0) / common
            else:
                own += data[k]
        # 3. Divide by −d_i.
        total = 0.0
        for q in range(first, end):
            total -= weight[q]
        own = max(own, total)  # weights add up to 1 at most
        for q in range(first, end):
            weight[q] /= -own
    return graph, to, weight


@kernel
def coarse_first(indptr, indices, data, stays, place):
    """Permute a CSR symmetrically so that C-points come first.

    ``place[i]`` is the new number of i; the order within C-points and within F-points must be kept.
    """
    n = len(stays)
    graph = np.zeros(n + 1, indptr.dtype)
    for i in range(n):
        graph[place[i] + 1] = indptr[i + 1] - indptr[i]
    for i in range(n):
        graph[i + 1] += graph[i]
    columns = np.empty_like(indices)
    values = np.empty_like(data)
    for i in range(n):
        m = graph[place[i]]
        for wanted in (True, False):  # columns stay sorted
            for k in range(indptr[i], indptr[i + 1]):
                if stays[indices[k]] == wanted:
                    columns[m] = place[indices[k]]
                    values[m] = data[k]
                    m += 1
    return graph, columns, values
