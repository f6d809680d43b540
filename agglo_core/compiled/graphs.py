"""Dual graphs of meshes: construction from faces, renumbering, and connected components."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.prefetching import prefetch

_AHEAD = np.int64(16)
"""Number of rows prefetched ahead (benchmarks/partition.py)."""


@helper
def find_root(parent, i):
    """Return the root of node i in a union-find forest, halving the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def dual_graph(offsets, faces, face_cells, face_measures):
    """Return the CSR graph of cells that share faces, with interface measures, and the boundary measures.

    ``offsets`` and ``faces`` list the faces of each cell. ``face_cells (f, 2)`` are the two cells of a face,
    −1 for none.
    """
    n = len(offsets) - 1
    indptr = np.zeros(n + 1, np.int64)
    indices = np.empty(len(faces), np.int32)
    interface = np.empty(len(faces))
    boundary = np.zeros(n)
    slot = np.full(n, -1, np.int64)  # position of a neighbour in the current row
    m = 0
    for c in range(n):
        row = m
        for h in range(offsets[c], offsets[c + 1]):
            f = faces[h]
            # Adjacent cell. None: a boundary face. Already in the row: another common face. Slots from
            # earlier rows lie before the current row, so they need not be cleared.
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
def permute_graph(indptr, indices, interface, order, offsets, new_indptr, new_indices, new_interface):
    """Write the subgraph on the nodes ``order``, renumbered in that order, as CSR.

    Block b consists of ``offsets[b]:offsets[b + 1]``. Edges between blocks, and to omitted nodes, are
    dropped. Returns the number of remaining entries, or −1 if ``order`` has full length but repeats a node.
    Otherwise the arrays must have room for all edges of these nodes.
    """
    n, missing, m = len(indptr) - 1, 0, np.uint64(0)
    position = np.full(n, -1, np.int32)
    # 1. New number of each node, −1 for omitted nodes.
    for i in range(np.uint64(len(order))):
        node = np.uint64(np.uint32(order[i]))
        position[node] = i
    for k in range(n):
        missing += position[k] < 0
    if len(order) == n and missing > 0:
        return np.int64(-1)
    # 2. All nodes in one block: no edge is dropped, so rows are copied, and their entries renumbered in a
    #    second pass.
    whole = len(order) == n and len(offsets) == 2
    new_indptr[0] = 0
    last = np.int64(len(order)) - 1
    for i in range(np.uint64(len(order) if whole else 0)):
        prefetch(indptr, order[min(np.int64(i) + 2 * _AHEAD, last)])
        coming = np.uint64(np.uint32(order[min(np.int64(i) + _AHEAD, last)]))
        for end in (np.uint64(indptr[coming]), np.uint64(indptr[coming + ONE])):
            prefetch(indices, end)
            prefetch(interface, end)
        node = np.uint64(np.uint32(order[i]))
        for h in range(np.uint64(indptr[node]), np.uint64(indptr[node + ONE])):
            new_indices[m], new_interface[m] = indices[h], interface[h]
            m += ONE
        new_indptr[i + ONE] = m
    for h in range(m):
        new_indices[h] = position[np.uint32(new_indices[h])]
    # 3. Otherwise keep an edge only if its other end is in the block.
    for b in range(0 if whole else len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        for i in range(start, stop):
            node = np.uint64(order[i])
            for h in range(np.uint64(indptr[node]), np.uint64(indptr[node + ONE])):
                j = position[np.uint32(indices[h])]
                new_indices[m] = j
                new_interface[m] = interface[h]
                m += np.uint64((start <= j) & (j < stop))  # no branch: it would be mispredicted
            new_indptr[i + 1] = m
    return np.int64(m)


@kernel
def take_rows(offsets, values, order):
    """Return the rows ``order`` of an unweighted CSR structure: offsets and column indices."""
    new_offsets = np.zeros(len(order) + 1, np.int64)
    for i in range(len(order)):
        row = np.uint64(order[i])
        new_offsets[i + 1] = new_offsets[i] + offsets[row + ONE] - offsets[row]
    row_values = np.empty(new_offsets[len(order)], np.int32)
    m = np.uint64(0)
    for i in range(len(order)):
        row = np.uint64(order[i])
        for h in range(np.uint64(offsets[row]), np.uint64(offsets[row + ONE])):
            row_values[m] = values[h]
            m += ONE
    return new_offsets, row_values


@kernel
def list_blocks(labels, block_labels, count):
    """List the cells with each of the labels ``block_labels``, label by label, and return the offsets.

    There are ``count`` labels in total.
    """
    place, offsets = np.full(count, len(block_labels), np.int32), np.zeros(len(block_labels) + 1, np.int64)
    following, total = np.zeros(len(block_labels) + 1, np.int64), 0
    # 1. Counting sort: cell counts of the listed labels; all other labels share a last entry.
    for b in range(len(block_labels)):
        place[block_labels[b]] = b
    for i in range(len(labels)):
        following[np.uint32(place[np.uint64(labels[i])])] += 1
    # 2. Convert counts to offsets.
    for b in range(len(block_labels)):
        size = following[b]
        offsets[b], following[b] = total, total
        total += size
    offsets[len(block_labels)], following[len(block_labels)] = total, total
    # 3. Write each cell to the next position of its label, cells of other labels to the position behind.
    cells = np.empty(total + 1, np.int32)
    for i in range(len(labels)):
        block = np.uint32(place[np.uint64(labels[i])])
        cells[np.uint64(following[block])] = i
        following[block] += block < len(block_labels)
    return cells[:total], offsets


@kernel
def number_as_met(values, count):
    """Renumber integers below ``count`` by first occurrence, and return the old numbers in that order."""
    number, order = np.full(count, -1, np.int32), np.empty(count + 1, np.int64)
    renumbered, n_distinct = np.empty(len(values), np.int32), np.uint64(0)
    for h in range(len(values)):
        v = np.uint32(values[h])
        entry = number[v]
        new_number = np.int32(n_distinct) if entry < 0 else entry
        order[n_distinct] = v  # kept only if new; a branch would be mispredicted
        n_distinct += np.uint64(entry < 0)
        number[v], renumbered[h] = new_number, new_number
    return renumbered, order[:n_distinct]


@kernel
def child_order(offsets, sides):
    """Order the nodes of each bisected block by side, stably, and return the offsets of the halves."""
    order = np.empty(len(sides), np.int64)
    children = np.empty(2 * len(offsets) - 1, np.int64)
    for b in range(len(offsets) - 1):
        start, stop = offsets[b], offsets[b + 1]
        n_right = np.int64(0)
        for i in range(start, stop):
            n_right += sides[i]
        # The right child starts at the end minus its node count.
        p_left, p_right = start, stop - n_right
        children[2 * b], children[2 * b + 1] = p_left, p_right
        for i in range(start, stop):
            order[p_right if sides[i] else p_left] = i  # no branch: it would be mispredicted half the time
            p_left += 1 - sides[i]
            p_right += sides[i]
    children[-1] = offsets[-1]
    return order, children


@helper
def flood(seed, indptr, indices, open_labels, nodes, filled):
    """Append to a list all nodes connected with ``seed`` through nodes of its label (breadth-first search).

    Returns the new list length. ``open_labels`` contains labels, −1 for listed nodes. The first ``filled``
    entries in ``nodes (n + 1,)`` are in use.
    """
    label, head, last = open_labels[seed], np.uint64(filled), np.uint64(filled)
    open_labels[seed], nodes[last] = -1, seed
    last += ONE
    while head < last:
        i = np.uint64(np.uint32(nodes[head]))
        head += ONE
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint32(indices[h])
            is_new = open_labels[j] == label
            nodes[last] = j  # kept only if new; a branch would be mispredicted half the time
            open_labels[j] = -1 if is_new else open_labels[j]
            last += np.uint64(is_new)
    return np.int64(last)


@kernel
def components(indptr, indices, labels):
    """List the connected components of nodes with equal, non-negative labels, ordered by first node.

    Returns the nodes component by component, and the component offsets.
    """
    n = len(indptr) - 1
    open_labels = labels.copy()
    nodes = np.empty(n + 1, np.int32)
    offsets = np.empty(n + 1, np.int64)
    offsets[0] = 0
    count, filled = 0, 0
    for seed in range(n):
        if open_labels[seed] >= 0:
            filled = flood(seed, indptr, indices, open_labels, nodes, filled)
            count += 1
            offsets[count] = filled
    return nodes[:n], offsets[: count + 1].copy()


@kernel
def broken_blocks(offsets, indptr, indices, labels):
    """Mark the blocks ``(B,)`` that contain a disconnected part.

    There are no edges between blocks.
    """
    n, highest = len(labels), -1
    open_labels, nodes = np.empty(n, np.int32), np.empty(n + 1, np.int32)
    for i in range(n):  # labels.max() takes half a second to compile
        open_labels[i] = labels[i]
        highest = max(highest, labels[i])
    # Flood each component. ``last_block`` is the last block that contained a part: a second component is a
    # fault.
    last_block = np.full(highest + 1, -1, np.int64)
    broken = np.empty(len(offsets) - 1, np.bool_)
    for b in range(len(broken)):
        broken[b] = False
        for seed in range(offsets[b], offsets[b + 1]):
            label = open_labels[seed]
            if label >= 0:
                broken[b] |= last_block[label] == b  # a second component of its part
                last_block[label] = b
                flood(seed, indptr, indices, open_labels, nodes, 0)
    return broken


@helper
def join_before(i, first, indptr, indices, labels, parent):
    """Join node i with its neighbours j of equal label, ``first`` ≤ j < i (union-find).

    Returns the number of components joined with it, and whether such a neighbour lies before the first.
    """
    label, root, n_joined, beyond = labels[i], np.int32(i), 0, False
    parent[i] = root
    for h in range(indptr[i], indptr[i + 1]):
        j = indices[h]
        before = (j < i) & (labels[j] == label)
        beyond |= before & (j < first)
        tree = parent[j] if before & (j >= first) else root  # a branch would be mispredicted half the time
        if tree == root:
            continue
        # Join the neighbour's tree with the node's tree. The smaller number becomes the root, so that results
        # do not depend on the order of neighbours.
        while parent[tree] != tree:
            tree = parent[tree]
        if tree != root:
            root, child = min(root, tree), max(root, tree)
            parent[child] = root
            n_joined += 1
    parent[i] = root
    return n_joined, beyond
