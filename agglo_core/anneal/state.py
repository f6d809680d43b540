"""What annealing knows of cells and of parts, and how a cell goes from one to another."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper
from agglo_core.compiled.ring_search import CROWD, REACH, connected

COLUMNS = 4
MEASURE, SURFACE, DIAMETER, COUNT = 0, 1, 2, 3
"""Columns of the sums of a part: measure, measure of its faces, diameter, number of cells."""


class Cells(NamedTuple):
    """Graph of the cells, their geometry, the vertices of each, and the cells that meet at each vertex."""

    indptr: Any
    indices: Any
    interface: Any
    measures: Any
    centroids: Any
    offsets: Any
    vertices: Any
    points: Any
    surfaces: Any
    radii: Any
    spans: Any
    meeting_offsets: Any
    meeting: Any


class Parts(NamedTuple):
    """Part of each cell; sums and the two vertices farthest apart of each part; its cells as a list."""

    labels: Any
    tally: Any
    ends: Any
    first: Any
    after: Any
    before: Any


class Work(NamedTuple):
    """Room for searches: cells and their roots, marks of cells, marks of vertices, vertices of a part."""

    queue: Any
    root: Any
    marks: Any
    seen: Any
    found: Any


@helper
def may_leave(i, p, q, cells, parts, work, stamp):
    """Whether part p stays connected near cell i without it; then the label of the cell is q."""
    filled, i = np.uint64(0), np.uint64(i)
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        j = np.uint32(cells.indices[h])
        work.queue[filled] = j  # no branch: it would be mispredicted half the time
        filled += np.uint64(parts.labels[j] == p)
    if filled == 0:
        return False
    parts.labels[i] = q
    search = (work.queue, work.root, work.marks)
    if filled > ONE and not connected(
        cells.indptr, cells.indices, parts.labels, p, search, filled, stamp, REACH, CROWD
    ):
        parts.labels[i] = p
        return False
    return True


@helper
def exchange(i, p, q, parts):
    """Move cell i from the list of part p to that of part q."""
    if parts.before[i] >= 0:
        parts.after[parts.before[i]] = parts.after[i]
    else:
        parts.first[p] = parts.after[i]
    if parts.after[i] >= 0:
        parts.before[parts.after[i]] = parts.before[i]
    parts.after[i], parts.before[i] = parts.first[q], -1
    if parts.first[q] >= 0:
        parts.before[parts.first[q]] = i
    parts.first[q] = i
