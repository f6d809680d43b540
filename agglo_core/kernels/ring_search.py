"""Searches from several cells at once, ring by ring, until they have met: whether cells are connected."""

from __future__ import annotations

import numpy as np

from agglo_core.kernels.compiling import helper

__all__ = ["CROWD", "REACH", "connected", "keeps_whole"]

REACH = np.int64(64)  # cells visited before two neighbours count as not connected around a cell
CROWD = np.int64(256)  # neighbours from which on rings do not grow from a cell: all would read them


@helper
def connected(indptr, indices, labels, own, search, filled, stamp, reach, crowd):
    """Whether the first ``filled`` cells of the queue, labelled ``own``, are connected among such cells.

    Complete rings of cells are grown around all of them at once until they meet; the search ends between
    rings, so that its outcome does not depend on the order of the cells, once more than ``reach`` cells were
    visited, or all. Rings do not grow from cells with more than ``crowd`` neighbours.

    Parameters
    ----------
    search : queue (n,), root (n,), marks (n, 2 or more) int, changed
        Work arrays; the first two marks of a cell say when it was last reached, and from which of the cells.
    stamp : int
        Not yet in the first column of the marks.
    """
    queue, root, marks = search
    for k in range(filled):
        marks[queue[k], 0], marks[queue[k], 1], root[k] = stamp, k, k
    apart, done = filled - 1, 0
    while apart > 0 and done < filled <= reach:
        ring = filled
        while apart > 0 and done < ring:
            node = queue[done]
            done += 1
            if indptr[node + 1] - indptr[node] > crowd:
                continue
            for h in range(indptr[node], indptr[node + 1]):
                j = indices[h]
                if labels[j] != own:
                    continue
                if marks[j, 0] != stamp:
                    marks[j, 0], marks[j, 1] = stamp, marks[node, 1]
                    queue[filled] = j
                    filled += 1
                    continue
                one, other = marks[node, 1], marks[j, 1]
                while root[one] != one:
                    one = root[one]
                while root[other] != other:
                    other = root[other]
                if one != other:
                    root[one] = other
                    apart -= 1
    return apart <= 0


@helper
def keeps_whole(indptr, indices, labels, i, search, stamp):
    """Whether the neighbours of cell i with its label stay connected near it once it has left."""
    own, queue, filled = labels[i], search[0], np.int64(0)
    for h in range(indptr[i], indptr[i + 1]):
        if labels[indices[h]] == own:
            queue[filled] = indices[h]
            filled += 1
    if filled < 2:
        return True
    labels[i] = -1  # out of the way
    whole = connected(indptr, indices, labels, own, search, filled, stamp, REACH, CROWD)
    labels[i] = own
    return whole
