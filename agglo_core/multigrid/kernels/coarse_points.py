"""Classical coarsening: choice of coarse unknowns, and interpolation of the other unknowns.

Unknowns that stay on the coarse level are called C-points in the literature, the others F-points.
Matrices are CSR with sorted columns and symmetric pattern. Unknown i depends on j if −a_ij is at least θ
times the largest −a_ik of its row (at least ½ among large positive entries). Then entry (i, j) is strong.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel

_AMONG_POSITIVE = 0.5
"""Least θ of a row with large positive entries. Bilinear elements on stretched cells couple diagonal
neighbours by a quarter to a half of the largest coupling, and positive entries nearly cancel these
(benchmarks/linear.py)."""


@kernel
def strong_entries(indptr, indices, data, theta, least):
    """Mark the strong entries of a matrix, and the unknowns whose errors need the coarse level.

    An unknown with Σ_j≠i |a_ij| of at most ``least`` times a_ii does not need the coarse level, and has no
    strong entries. In a row with a positive entry of at least θ times the largest −a_ik, θ is at least ½.
    """
    n = len(indptr) - 1
    strong = np.zeros(len(indices), np.bool_)
    needy = np.zeros(n, np.bool_)
    for i in range(n):
        diagonal = 0.0
        total = 0.0
        most = 0.0
        positive = 0.0
        # Diagonal entry, sum of couplings, and largest negative and positive entry of the row.
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i:
                diagonal = data[k]
            else:
                total += abs(data[k])
                most = max(most, -data[k])
                positive = max(positive, data[k])
        # Only negative entries can be strong. A row without negative entries has most = 0, no dependence.
        needy[i] = total > least * diagonal
        if needy[i] and most > 0.0:
            limit = max(theta, _AMONG_POSITIVE) if positive >= theta * most else theta
            for k in range(indptr[i], indptr[i + 1]):
                strong[k] = indices[k] != i and -data[k] >= limit * most
    return strong, needy


@kernel
def coarse_points(indptr, indices, strong, needy):
    """Choose the unknowns that stay on the coarse level (Ruge, Stüben 1987, both passes).

    First pass: the free unknown with most dependents becomes a C-point, and its free dependents become
    F-points, which raises the worth of the unknowns that these depend on. Second pass: if an F-point depends
    on another F-point, both must depend on a common C-point, or else one becomes a C-point, too. An unknown
    that needs the coarse level and depends on no other becomes a C-point.
    """
    start, dependent, worth = _dependents(indptr, indices, strong)
    stays = _independent(indptr, indices, strong, start, dependent, worth)
    _second_pass(indptr, indices, strong, stays)
    for i in range(len(stays)):
        stays[i] = stays[i] or (needy[i] and not strong[indptr[i] : indptr[i + 1]].any())
    return stays


@helper(allocates=True)
def _dependents(indptr, indices, strong):
    """Return the unknowns that depend on each unknown as CSR, and their number for each unknown."""
    # Transpose the strong entries by a counting sort.
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
    """Choose coarse unknowns (C-points) by the first pass of Ruge and Stüben.

    ``worth (n,)`` is the number of free dependents plus twice the F-point dependents, and is modified. Free
    unknowns of equal worth form a doubly linked list with the last changed at the head.
    """
    # Each dependent raises a worth at most once, when it becomes an F-point: 2 · top bounds all worths.
    n = len(worth)
    top = worth.max()
    head = np.full(2 * top + 2, -1, np.int32)
    before = np.full(n, -1, np.int32)
    after = np.full(n, -1, np.int32)
    free = np.ones(n, np.bool_)
    stays = np.zeros(n, np.bool_)
    for i in range(n - 1, -1, -1):
        _link(i, worth, head, before, after)
    # 1. A free unknown with largest worth becomes a C-point. Unknowns of worth 0 are left, as no F-point
    #    depends on them.
    while top > 0:
        i = head[top]
        if i < 0:
            top -= 1
            continue
        _unlink(i, worth, head, before, after)
        free[i] = False
        stays[i] = True
        # 2. Its free dependents j become F-points. The unknowns that j depends on gain worth, since j can
        #    interpolate from them.
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
        # 3. The unknowns that i depends on lose worth, since i itself needs no interpolation.
        for k in range(indptr[i], indptr[i + 1]):
            q = indices[k]
            if strong[k] and free[q]:
                _unlink(q, worth, head, before, after)
                worth[q] -= 1
                _link(q, worth, head, before, after)
    return stays


@helper
def _link(i, worth, head, before, after):
    """Insert unknown i at the head of the list of unknowns with equal worth (priority)."""
    old = head[worth[i]]
    head[worth[i]] = i
    before[i] = -1
    after[i] = old
    if old >= 0:
        before[old] = i


@helper
def _unlink(i, worth, head, before, after):
    """Remove unknown i from the list of unknowns with equal worth (priority)."""
    if before[i] >= 0:
        after[before[i]] = after[i]
    else:
        head[worth[i]] = after[i]
    if after[i] >= 0:
        before[after[i]] = before[i]


@helper(allocates=True)
def _second_pass(indptr, indices, strong, stays):
    """Add coarse unknowns (C-points) to ``stays`` until strongly coupled other unknowns (F-points) share one.

    This is the second pass of Ruge and Stüben.

    Each F-point i is treated once, in order. ``mark[j] == i`` means that i can interpolate from j.
    """
    n = len(stays)
    mark = np.full(n, -1, np.int32)
    for i in range(n):
        if stays[i]:
            continue
        for k in range(indptr[i], indptr[i + 1]):
            if strong[k] and stays[indices[k]]:
                mark[indices[k]] = i
        # Each F-point j that i depends on must depend on a C-point of i. The first j that violates this
        # becomes a candidate, counts as C-point of i from here on, and stays unless there is a second
        # violation.
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
            if candidate >= 0:  # second violation: i itself becomes the C-point
                candidate = i
                break
            candidate = j
            mark[j] = i
        if candidate >= 0:
            stays[candidate] = True


@kernel
def classical_weights(indptr, indices, data, strong, stays, number):
    """Return the classical interpolation weights as a CSR matrix ``graph, to, weight``.

    A C-point has weight 1. An F-point interpolates from all C-points that it depends on. ``number`` is the
    coarse number per C-point. For an F-point i with its set C_i of C-points, the weights are w_ij =
    −(a_ij + Σ_m a_im ā_mj / Σ_l∈C_i ā_ml) / d_i for j ∈ C_i, with m over the other strong entries and ā the
    negative part of a. The diagonal d_i is a_ii plus all weak entries, plus a_im if row m is not coupled
    to C_i.
    """
    n = len(stays)
    # Count the weights per row.
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
        # 1. The entries of C_i. ``slot`` is the position of a C-point. Slots before ``first`` are outdated.
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
        # 2. All other entries, including the diagonal, are distributed over C_i or added to d_i.
        diagonal = 0.0
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
                diagonal += data[k]
        # 3. Divide by −d_i.
        total = 0.0
        for q in range(first, end):
            total -= weight[q]
        diagonal = max(diagonal, total)  # weights sum to at most 1
        for q in range(first, end):
            weight[q] /= -diagonal
    return graph, to, weight


@kernel
def coarse_first(indptr, indices, data, stays, place):
    """Permute a CSR matrix symmetrically so that coarse unknowns (C-points) come first.

    ``place[i]`` is the new number of i. The order within C-points and within F-points must be kept.
    """
    n = len(stays)
    graph = np.zeros(n + 1, indptr.dtype)
    # Row lengths in the new order.
    for i in range(n):
        graph[place[i] + 1] = indptr[i + 1] - indptr[i]
    for i in range(n):
        graph[i + 1] += graph[i]
    columns = np.empty_like(indices)
    values = np.empty_like(data)
    for i in range(n):
        # Copy the rows, C-points before F-points.
        m = graph[place[i]]
        for wanted in (True, False):  # keeps columns sorted
            for k in range(indptr[i], indptr[i + 1]):
                if stays[indices[k]] == wanted:
                    columns[m] = place[indices[k]]
                    values[m] = data[k]
                    m += 1
    return graph, columns, values
