"""Kernels for aggregation: coupling strengths, greedy aggregates, label splitting, local bases.

A part is a range of consecutive unknowns. Couplings are a CSR over parts, without the diagonal.
"""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import kernel


@kernel
def couplings(indptr, indices, data, offsets, part_of):
    """Return the coupling strengths between parts as CSR, and the size (norm) per diagonal block.

    Part p has the rows ``offsets[p]:offsets[p + 1]``, and ``part_of`` is the part per row. For single
    unknowns, the coupling is −a_ij and the size a_ii, so positive entries couple negatively. For larger
    parts, both are Frobenius norms of blocks.
    """
    n = len(offsets) - 1
    scalar = np.all(offsets[1:] - offsets[:-1] == 1)
    graph = np.zeros(n + 1, np.int64)
    to = np.empty(len(indices), np.int32)
    weight = np.empty(len(indices))
    size = np.zeros(n)
    slot = np.full(n, -1, np.int64)
    m = 0
    # Sum the entries of a block in the slot of its part. Slots before ``start`` belong to earlier rows.
    for p in range(n):
        start = m
        for i in range(offsets[p], offsets[p + 1]):
            for k in range(indptr[i], indptr[i + 1]):
                q = part_of[indices[k]]
                w = -data[k] if scalar else data[k] ** 2
                if q == p:
                    size[p] += data[k] if scalar else w
                elif slot[q] >= start:
                    weight[slot[q]] += w
                else:
                    slot[q] = m
                    to[m] = q
                    weight[m] = w
                    m += 1
        # Take roots of the sums of squares.
        if not scalar:
            size[p] = np.sqrt(size[p])
            for k in range(start, m):
                weight[k] = np.sqrt(weight[k])
        graph[p + 1] = m
    return graph, to[:m].copy(), weight[:m].copy(), size


@kernel
def greedy_aggregates(graph, to, weight, size, theta, needless):
    """Aggregate the parts greedily by coupling strength.

    Returns the aggregate per part, −1 for parts without coarse unknown, and the aggregate count.

    A coupling w between i and j is strong if w > θ max(s_i, s_j), and i leans on j if w > θ s_i, with sizes
    s. A part that leans on no other part forms a separate aggregate, as it may have many neighbours that lean
    on it. Then each part with only free strong neighbours forms an aggregate with these. The remaining parts
    join the aggregate that they lean on most. A part with a coupling sum of at most ``needless`` times its
    size needs no coarse unknown.
    """
    # ``first`` is −1 for free parts, and −2 for parts without coarse unknown.
    n = len(graph) - 1
    first = np.full(n, -1, np.int64)
    count = 0
    # 1. Parts without coarse unknown, and parts that lean on no other part, which found an aggregate each.
    for i in range(n):
        total = 0.0
        most = 0.0
        for k in range(graph[i], graph[i + 1]):
            total += abs(weight[k])
            most = max(most, weight[k])
        if total <= needless * size[i]:
            first[i] = -2
        elif most <= theta * size[i]:
            first[i] = count
            count += 1
    # 2. A free part with strong neighbours, all of them free, founds an aggregate with these. Neighbours
    #    without coarse unknown do not count.
    for i in range(n):
        if first[i] != -1:
            continue
        free = False
        for k in range(graph[i], graph[i + 1]):
            j = to[k]
            if weight[k] > theta * max(size[i], size[j]) and first[j] != -2:
                free = first[j] == -1
                if not free:
                    break
        if free:
            first[i] = count
            for k in range(graph[i], graph[i + 1]):
                j = to[k]
                if weight[k] > theta * max(size[i], size[j]) and first[j] == -1:
                    first[j] = count
            count += 1
    # 3. Other free parts join the aggregate that they lean on most. Only aggregates from steps 1 and 2 are
    #    joined, so that no aggregate grows by more than one layer.
    labels = first.copy()
    for i in range(n):
        if first[i] == -1:
            most = theta * size[i]
            for k in range(graph[i], graph[i + 1]):
                if weight[k] > most and first[to[k]] >= 0:
                    most = weight[k]
                    labels[i] = first[to[k]]
    # 4. The remaining parts found aggregates with their free strong neighbours.
    for i in range(n):
        if labels[i] == -1:
            labels[i] = count
            for k in range(graph[i], graph[i + 1]):
                j = to[k]
                if labels[j] == -1 and weight[k] > theta * max(size[i], size[j]):
                    labels[j] = count
            count += 1
    return np.maximum(labels, -1), count


@kernel
def split_labels(graph, to, weight, size, theta, labels):
    """Split each set of parts with equal label into pieces connected by strong couplings.

    Couplings and strength are as in :func:`greedy_aggregates`. A part without strong coupling inside its
    label joins the piece in this label that it leans on most. Returns the piece per part, numbered by
    first part, and the piece count.
    """
    # 1. Connected pieces by depth-first search over strong couplings inside each label. ``alone`` marks parts
    #    without strong coupling.
    n = len(graph) - 1
    piece = np.full(n, -1, np.int64)
    alone = np.ones(n, np.bool_)
    stack = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if piece[i] >= 0:
            continue
        piece[i] = count
        stack[0] = i
        top = 1
        while top:
            top -= 1
            p = stack[top]
            for k in range(graph[p], graph[p + 1]):
                q = to[k]
                if labels[q] == labels[p] and weight[k] > theta * max(size[p], size[q]):
                    alone[p] = False
                    if piece[q] < 0:
                        piece[q] = count
                        stack[top] = q
                        top += 1
        count += 1
    # 2. Lone parts join a larger piece in their label, if they lean on any.
    final_piece = piece.copy()
    for i in range(n):
        most = theta * size[i]
        for k in range(graph[i], graph[i + 1]):
            j = to[k]
            if alone[i] and not alone[j] and labels[j] == labels[i] and weight[k] > most:
                most = weight[k]
                final_piece[i] = piece[j]
    # 3. Number the remaining pieces.
    number = np.full(count, -1, np.int64)
    count = 0
    for i in range(n):
        if number[final_piece[i]] < 0:
            number[final_piece[i]] = count
            count += 1
        final_piece[i] = number[final_piece[i]]
    return final_piece, count


@kernel
def split_weak(indptr, indices, data, offsets, part_of, graph, to, weight, size, least, vectors):
    """Return F, the matrix A without weak blocks, and (A − F) B for near-null vectors B.

    A and F are CSR ``indptr, indices, data``, and B are the ``vectors (n, k)``. A block is weak if its
    coupling is at most ``least`` times the size of its row part. ``graph, to, weight, size`` are the
    :func:`couplings` of A.
    """
    n = len(part_of)
    row_starts = np.zeros(n + 1, indptr.dtype)
    columns = np.empty_like(indices)
    values = np.empty_like(data)
    weak_action = np.zeros(vectors.shape)
    weak_for = np.full(len(offsets) - 1, -1, np.int64)
    m = 0
    for p in range(len(offsets) - 1):
        # Mark the parts with weak blocks in these rows. The diagonal block is not a coupling and stays.
        for k in range(graph[p], graph[p + 1]):
            if abs(weight[k]) <= least * size[p]:
                weak_for[to[k]] = p
        # Add entries in weak blocks to (A − F) B, and copy all others to F.
        for i in range(offsets[p], offsets[p + 1]):
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                if weak_for[part_of[j]] == p:
                    for c in range(vectors.shape[1]):
                        weak_action[i, c] += data[k] * vectors[j, c]
                else:
                    columns[m] = j
                    values[m] = data[k]
                    m += 1
            row_starts[i + 1] = m
    return row_starts, columns[:m].copy(), values[:m].copy(), weak_action


@kernel
def local_bases(starts, rows, vectors):
    """Orthonormalise the vectors B ``(n, k)`` on each aggregate, so that Q R = B there.

    Aggregate a has the unknowns ``rows[starts[a]:starts[a + 1]]``. Method: modified Gram–Schmidt, twice. A
    vector that depends on the previous vectors on an aggregate adds no column there. Returns Q ``(n, k)``, R
    ``(aggregates, k, k)``, and per aggregate the rank: the number of nonzero columns of Q and rows of R.
    """
    k = vectors.shape[1]
    Q = np.zeros(vectors.shape)
    R = np.zeros((len(starts) - 1, k, k))
    ranks = np.zeros(len(starts) - 1, np.int64)
    for a in range(len(starts) - 1):
        members = rows[starts[a] : starts[a + 1]]
        for c in range(k):
            # 1. Copy vector c to the next free column of Q. ``length`` is its squared norm.
            q = ranks[a]
            length = 0.0
            for i in members:
                Q[i, q] = vectors[i, c]
                length += vectors[i, c] ** 2
            # 2. Subtract the projections on previous columns. The second round removes rounding errors.
            for _ in range(2):
                for o in range(q):
                    projection = 0.0
                    for i in members:
                        projection += Q[i, o] * Q[i, q]
                    R[a, o, c] += projection
                    for i in members:
                        Q[i, q] -= projection * Q[i, o]
            # 3. A remainder below 1e-8 of the vector (1e-16 squared) is rounding and adds no column.
            remainder = 0.0
            for i in members:
                remainder += Q[i, q] ** 2
            if remainder > 1e-16 * length:
                R[a, q, c] = np.sqrt(remainder)
                for i in members:
                    Q[i, q] /= R[a, q, c]
                ranks[a] += 1
            else:
                for i in members:
                    Q[i, q] = 0.0
    return Q, R, ranks
