"""Dual graphs: from faces, renumbered, and split into connected components."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels import kernel

__all__ = ["child_order", "components", "dual_graph", "permute_graph", "take_rows"]


@kernel
def dual_graph(offsets, faces, face_cells, face_measures):
    """CSR of the cells that share faces, parallel faces summed, and each cell's exposed measure."""
    n = len(offsets) - 1
    indptr = np.zeros(n + 1, np.int64)
    indices = np.empty(len(faces), np.int32)
    interface = np.empty(len(faces))
    boundary = np.zeros(n)
    slot = np.full(n, -1, np.int64)  # where in this row a neighbour stands already
    m = 0
    for c in range(n):
        row = m
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            j = face_cells[f, 0] if face_cells[f, 1] == c else face_cells[f, 1]
            if j < 0:
                boundary[c] += face_measures[f]
            elif slot[j] >= row:
                interface[slot[j]] += face_measures[f]
            else:
                slot[j] = m
                indices[m] = j
                interface[m] = face_measures[f]
                m += 1
        indptr[c + 1] = m
    return indptr, indices[:m].copy(), interface[:m].copy(), boundary


@kernel
def permute_graph(indptr, indices, interface, labels, order):
    """CSR of the nodes ``order``, in that order, without edges between different labels."""
    position = np.full(len(indptr) - 1, -1, np.int32)
    room = 0
    for i in range(len(order)):
        position[order[i]] = i
        room += indptr[order[i] + 1] - indptr[order[i]]
    new_indptr = np.zeros(len(order) + 1, np.int64)
    new_indices = np.empty(room, np.int32)
    new_interface = np.empty(room)
    m = 0
    for i in range(len(order)):
        node = order[i]
        for h in range(indptr[node], indptr[node + 1]):
            j = indices[h]
            if position[j] >= 0 and labels[j] == labels[node]:
                new_indices[m] = position[j]
                new_interface[m] = interface[h]
                m += 1
        new_indptr[i + 1] = m
    return new_indptr, new_indices[:m], new_interface[:m]


@kernel
def take_rows(offsets, values, order):
    """Rows ``order`` of a CSR without weights: new offsets and values."""
    new_offsets = np.zeros(len(order) + 1, np.int64)
    for i in range(len(order)):
        new_offsets[i + 1] = new_offsets[i] + offsets[order[i] + 1] - offsets[order[i]]
    taken = np.empty(new_offsets[len(order)], np.int32)
    for i in range(len(order)):
        shift = offsets[order[i]] - new_offsets[i]
        for h in range(new_offsets[i], new_offsets[i + 1]):
            taken[h] = values[h + shift]
    return new_offsets, taken


@kernel
def child_order(offsets, sides):
    """Nodes with side 0 before side 1 in each block, order kept; and the offsets of the children."""
    order = np.empty(len(sides), np.int64)
    children = np.empty(2 * len(offsets) - 1, np.int64)
    for b in range(len(offsets) - 1):
        cursor = offsets[b]
        for side in range(2):
            children[2 * b + side] = cursor
            for i in range(offsets[b], offsets[b + 1]):
                if sides[i] == side:
                    order[cursor] = i
                    cursor += 1
    children[-1] = offsets[-1]
    return order, children


@kernel
def components(indptr, indices, labels):
    """Connected components of equal labels.

    Returns the component of each node, numbered by first node, and the nodes sorted by component
    with their offsets.
    """
    n = len(indptr) - 1
    component = np.full(n, -1, np.int64)
    queue = np.empty(n, np.int64)
    offsets = np.empty(n + 1, np.int64)
    offsets[0] = 0
    count, filled = 0, 0
    for seed in range(n):
        if component[seed] >= 0:
            continue
        component[seed] = count
        queue[filled] = seed
        done = filled
        filled += 1
        while done < filled:
            i = queue[done]
            done += 1
            for h in range(indptr[i], indptr[i + 1]):
                j = indices[h]
                if component[j] < 0 and labels[j] == labels[i]:
                    component[j] = count
                    queue[filled] = j
                    filled += 1
        count += 1
        offsets[count] = filled
    return component, queue, offsets[: count + 1].copy()
