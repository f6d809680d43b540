"""Count the connected components of agglomerates."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.compiled.compiling import helper, kernel


@helper
def _root(parent, i):
    """Return the root of cell i, and halve the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = np.uint64(parent[i])
    return i


@kernel
def count_components(face_cells, labels, count):
    """Return the number of components of each of the ``count`` parts, by union-find over the faces.

    A part begins with a component per cell. Each face that joins two of its components removes one.
    """
    parent, found = np.empty(len(labels), np.uint32), np.zeros(count, np.int64)
    for i in range(len(labels)):
        parent[i] = i
        found[labels[i]] += 1
    for f in range(len(face_cells)):
        if face_cells[f, 1] >= 0:
            a, b = np.uint64(face_cells[f, 0]), np.uint64(face_cells[f, 1])
            if labels[a] == labels[b]:
                a, b = _root(parent, a), _root(parent, b)
                if a != b:
                    parent[max(a, b)] = min(a, b)
                    found[labels[a]] -= 1
    return found
