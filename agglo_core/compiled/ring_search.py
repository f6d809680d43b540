"""Local connectivity test: breadth-first searches from several cells, ring by ring, until all have met."""

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import ONE, helper

# Visited cells after which neighbours count as locally disconnected, so that a cell may not leave its part.
# Larger allows more moves, and costs longer searches (benchmarks/polish.py).
REACH = np.int64(64)
# Neighbour count above which rings do not grow, because too many searches would read them: quadratic time
# around such a cell (benchmarks/pathologies.py, hub).
CROWD = np.int64(256)


@helper
def are_connected(indptr, indices, labels, label, search, filled, stamp, reach, crowd):
    """Return True if searches within part ``label`` connect the first ``filled`` cells of the queue.

    Complete rings of cells are grown around all of them simultaneously until they meet. The search ends
    between rings, so that its result does not depend on the order of the cells, after more than ``reach``
    visited cells, or after all cells. Rings do not grow from cells with more than ``crowd`` neighbours.

    Parameters
    ----------
    search : queue (n,), root (n,), marks (n, 2 or more) int, changed
        Workspace. The first two marks of a cell are the stamp of the last search that reached it, and its
        start cell.
    stamp : int
        Not yet in the first column of the marks.
    """
    queue, root, marks = search
    # 1. Each start cell is a tree in a union-find structure. The number of trees is
    #    ``missing_joins`` + 1.
    for k in range(filled):
        start = np.uint32(queue[k])
        marks[start, 0], marks[start, 1], root[k] = stamp, k, k
    missing_joins, head, filled = np.int64(filled) - 1, np.uint64(0), np.uint64(filled)
    while missing_joins > 0 and head < filled <= np.uint64(reach):
        # 2. Grow one ring: the neighbours with this label of all cells up to ``ring``. The search ends as
        #    soon as all trees have met.
        ring = filled
        while missing_joins > 0 and head < ring:
            node = np.uint64(np.uint32(queue[head]))
            head += ONE
            if indptr[node + ONE] - indptr[node] > crowd:
                continue
            for h in range(np.uint64(indptr[node]), np.uint64(indptr[node + ONE])):
                j = np.uint32(indices[h])
                if labels[j] != label:
                    continue
                # 3. A new cell joins the tree that reached it.
                if marks[j, 0] != stamp:
                    marks[j, 0], marks[j, 1] = stamp, marks[node, 1]
                    queue[filled] = j
                    filled += ONE
                    continue
                # 4. At a cell reached before, join both trees if they differ.
                tree_a, tree_b = np.uint32(marks[node, 1]), np.uint32(marks[j, 1])
                while root[tree_a] != tree_a:
                    tree_a = np.uint32(root[tree_a])
                while root[tree_b] != tree_b:
                    tree_b = np.uint32(root[tree_b])
                if tree_a != tree_b:
                    root[tree_a] = tree_b
                    missing_joins -= 1
    return missing_joins <= 0


@helper
def keeps_whole(indptr, indices, labels, i, search, stamp):
    """Return True if the neighbours of cell i in its part stay locally connected when i is removed."""
    label, queue, filled = labels[i], search[0], np.int64(0)
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
        j = np.uint32(indices[h])
        queue[filled] = j  # kept only if the label matches; a branch would be mispredicted half the time
        filled += labels[j] == label
    if filled < 2:
        return True
    labels[i] = -1  # hide the cell from the search
    whole = are_connected(indptr, indices, labels, label, search, filled, stamp, REACH, CROWD)
    labels[i] = label
    return whole
