"""Pieces of a graph in place: records, and helpers that test their sides and part them.

A piece is a slice of a list of cells, ``cells[lo:hi]``, which rise. Each cell carries the ``tag`` of its
side: twice the first place of the piece on the left, twice the last place plus 1 on the right. So no two
pieces share a tag, and no graph is made for a piece. What costs time is the cut, not the piece.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.geometry import box, octagon
from agglo_core.compiled.ring_search import connected

HEAVY = 4.0  # mean weights: heavier cells are in every sample, and stand for themselves alone
# One over the share of the cells that are chosen for a sample. A larger value saves time, and lets a cut
# differ more from that of all cells.
SAMPLED = np.int64(8)
_ABOVE, _LEAST = np.float32(1.0001), np.float32(1e-18)  # what squares lose in single precision, with a margin
_RUN = 64  # successive cells, of which about an eighth should be chosen
# Bands of weight up to the mean weight, every eighth of which is chosen: cells whose weights differ by more
# than 1.2 % of the mean lie in different ones. Not a whole number, so that rounding does not decide on the
# mean weight itself.
_BANDS = 87.7


class Units(NamedTuple):
    """Powers of two that make lengths and weights of order 1, and which cells are a sample ``(n,)``."""

    length: Any
    weight: Any
    sample: Any


class PieceGraph(NamedTuple):
    """Dual graph of all cells, which no split changes.

    ``indptr, indices, interface`` are its CSR; ``centroids (n, d)``, ``measures`` and ``weights`` belong to
    the cells; ``reach (n,)`` is how far the furthest neighbour is, times ``units.length``.
    """

    indptr: Any
    indices: Any
    interface: Any
    centroids: Any
    measures: Any
    weights: Any
    reach: Any
    units: Any


class CellVertices(NamedTuple):
    """Vertices of the cells as a CSR, and their points, for exact diameters."""

    offsets: Any
    vertices: Any
    points: Any


class Pieces(NamedTuple):
    """Cells in the order of the pieces ``(n,)``, the tags of their sides ``(n,)`` and marks ``(n, 4)``.

    The marks say when a cell was last reached, from where, when it was seen, and when and in which place it
    was listed.
    """

    cells: Any
    tag: Any
    marks: Any


class Sides(NamedTuple):
    """Measures and numbers of cells of the left and the right side, and the normal of the cut."""

    measures: Any
    counts: Any
    normal: Any


class Workspace(NamedTuple):
    """Arrays for the refinement and the searches of a piece.

    ``boundary, now, later`` are lists of cells, ``queue, root`` those of a search, ``keys`` places along the
    cut; ``shared`` is what listed cells share with the other side and with their own ``(m, 2)``.
    """

    boundary: Any
    now: Any
    later: Any
    queue: Any
    root: Any
    keys: Any
    shared: Any


@helper(allocates=True)
def new_sides():
    """Sides with uninitialised arrays."""
    return Sides(np.empty(2), np.empty(2, np.int64), np.empty(3))


@helper
def side_tags(lo, hi):
    """Tags of the left and the right side of the piece ``lo:hi``."""
    return np.int64(2 * lo), np.int64(2 * hi - 1)


@helper(allocates=True)
def new_workspace(m):
    """Workspace of pieces of at most m cells."""
    size = m + 1
    return Workspace(
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size),
        np.empty((size, 2)),
    )


@kernel
def units_of(centroids, weights):
    """Units of lengths and weights, and a sample of the cells.

    Units are powers of two: digits of what is scaled do not depend on what else there is. The sample is
    the chosen cells (1) and the heavy ones (2); there is none ``(0,)`` if the weights are not spread enough.
    """
    # 1. Extent of the centroids and mean weight, and the powers of two that bring them to between 1/2 and 1.
    total, last = 0.0, centroids.shape[1] - 1
    x0, y0, z0, x1, y1, z1 = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for i in range(len(weights)):
        x, y, z = centroids[i, 0], centroids[i, 1], centroids[i, last]
        x0, y0, z0, x1, y1, z1 = min(x0, x), min(y0, y), min(z0, z), max(x1, x), max(y1, y), max(z1, z)
        total += weights[i]
    extent = max(0.0, x1 - x0, y1 - y0, z1 - z0)
    mean = total / len(weights)
    length, weight = math.ldexp(1.0, -math.frexp(extent)[1]), math.ldexp(1.0, -math.frexp(mean)[1])
    # 2. The sample. A run of successive cells, which mostly lie close together, is uneven if none of them is
    #    chosen or three times too many: a region of the mesh would have no say in a cut, or too much.
    bands = _BANDS / mean if mean > 0.0 else 0.0
    uneven, sample = 0, np.empty(len(weights), np.uint8)
    for start in range(0, len(weights), _RUN):
        count = 0
        for i in range(start, int(min(start + _RUN, len(weights)))):
            chosen = is_chosen(weights[i], bands)
            count += chosen
            sample[i] = 2 if weights[i] > HEAVY * mean else chosen
        uneven += not 0 < count < 3 * _RUN // SAMPLED
    spread = 1000 * uneven <= len(weights) // _RUN + 2000  # by chance one in some thousands is uneven
    return Units(length, weight, sample if spread else sample[:0])


@helper
def is_chosen(weight, bands):
    """Return whether a cell is one of those, about an eighth, that may stand for all of a large piece.

    It is decided by a digit of its weight, which neither its number nor a motion of the mesh changes. The
    weights must be spread, or cells of a region may be chosen all or none: where there are runs of cells with
    none, or too many, ``units_of`` returns no sample.
    """
    return np.int64(weight * bands) & (SAMPLED - 1) == 0


@kernel
def reach_of_cells(indptr, indices, centroids, length, reach):
    """Write the distance of each cell from the furthest of its neighbours, rounded up, to ``reach (n,)``.

    It is multiplied by ``length``, which makes the extent of the graph of order 1: single precision serves.
    """
    last = centroids.shape[1] - 1
    # 1. Squares, in single precision as soon as they are stored.
    for i in range(len(reach)):
        largest, x, y, z = 0.0, centroids[i, 0], centroids[i, 1], centroids[i, last]
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + 1])):
            j = np.uint32(indices[h])
            u, v = (centroids[j, 0] - x) * length, (centroids[j, 1] - y) * length
            square = u * u + v * v
            if last > 1:
                square += ((centroids[j, last] - z) * length) ** 2
            largest = max(largest, square)
        reach[i] = largest
    # 2. Their roots, rounded up: if they were too small, cells along a cut would be missed.
    for i in range(len(reach)):
        reach[i] = _ABOVE * np.sqrt(reach[i]) + _LEAST


@helper
def cells_beside(indptr, indices, tag, left, right, cells, m):
    """Keep those of ``cells[:m]`` that are adjacent to the other side of their piece, and return how many."""
    found = 0
    for k in range(m):
        i = np.uint32(cells[k])
        other = left + right - tag[i]
        beside = False
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[np.uint64(i) + ONE])):
            beside |= tag[np.uint32(indices[h])] == other  # no branch: it would be mispredicted
        cells[found] = i
        found += beside
    return found


@helper
def sides_connected(graph, pieces, lo, hi, edge, workspace, stamp):
    """Return whether both sides of a connected piece are connected.

    The boundary of the workspace lists the ``edge`` cells along the cut; ``stamp`` and the next one are not
    yet in the first column of the marks. Every component of a side touches the other side: if the cells along
    the cut are connected within their side, the side is. So mostly nothing far from the cut is looked at.
    """
    indptr, indices, tag = graph.indptr, graph.indices, pieces.tag
    queue, boundary = workspace.queue, workspace.boundary
    left, right = side_tags(lo, hi)
    whole, everything = True, np.int64(len(tag))
    # The search starts from all cells of the side along the cut at once, without bounds on how far it may go,
    # and ends as soon as they have met.
    for side in range(2):
        label = np.int32(right if side else left)  # one version of the search, as refinement calls it
        filled = np.int64(0)
        for c in range(edge):
            queue[filled] = boundary[c]
            filled += tag[boundary[c]] == label
        search = (queue, workspace.root, pieces.marks)
        whole &= connected(indptr, indices, tag, label, search, filled, stamp + side, everything, everything)
    return whole


@helper
def is_connected(graph, pieces, lo, hi, queue, stamp):
    """Return whether a small piece is connected.

    The ``stamp`` is not yet in the first column of the marks.
    """
    indptr, indices, tag, marks = graph.indptr, graph.indices, pieces.tag, pieces.marks
    # Breadth first from the first cell, over cells with its tag.
    first, done, filled = np.uint32(pieces.cells[lo]), np.uint64(0), ONE
    own, queue[0], marks[first, 0] = tag[first], first, stamp
    while done < filled:
        i = np.uint64(np.uint32(queue[done]))
        done += ONE
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint32(indices[h])
            last = marks[j, 0]
            fresh = (tag[j] == own) & (last != stamp)
            queue[filled] = j  # kept only if it is fresh; a branch would be mispredicted half the time
            filled += np.uint64(fresh)
            marks[j, 0] = stamp if fresh else last
    return np.int64(filled) == hi - lo


@helper
def side_measures(pieces, measures, lo, hi, out):
    """Write the measures of both sides of a piece to ``out``."""
    cells, tag = pieces.cells, pieces.tag
    out[0], out[1] = 0.0, 0.0
    for k in range(lo, hi):
        out[tag[cells[k]] & 1] += measures[cells[k]]


@helper
def part_list(pieces, lo, hi, spare):
    """Move the cells of the left side before the others, in order, and return where the others start."""
    cells, tag, middle, right = pieces.cells, pieces.tag, np.uint64(lo), np.uint64(0)
    # Each cell is written to both lists, and stays in the one whose end moves. That of the left side
    # overwrites only cells that were read.
    for k in range(np.uint64(lo), np.uint64(hi)):
        i = np.uint32(cells[k])
        on_right = np.uint64(tag[i] & 1)
        cells[middle] = i  # no branch: it would be mispredicted half the time
        spare[right] = i
        middle += ONE - on_right
        right += on_right
    for k in range(right):
        cells[middle + k] = spare[k]
    return np.int64(middle)


@helper
def quota_of_left(quota, measures, cells_left, cells_right):
    """Quota of the left side: its share by measure, rounded, at least 1 and at most its number of cells.

    A quota of 0, for pieces that are to meet a size, stays 0.
    """
    if quota == 0:
        return 0
    left, right = measures[0], measures[1]
    if not left + right > 0.0:
        left, right = float(cells_left), float(cells_right)
    # Both sides need a part, and a cell for each of their parts.
    least, most = max(1.0, quota - cells_right), min(quota - 1.0, float(cells_left))
    share = np.rint(quota * (left / (left + right)) - 1e-9)  # halves go down, whatever the rounding of sums
    return np.int64(min(max(share, least), most))


@helper
def narrowness(piece, shape, limit, ends):
    """Return 1 if no two vertices of a piece are further apart than ``limit``, 0 if two are, −1 if unknown.

    Bounds alone are compared: those of an octagon about the piece in 2-D, of a box in 3-D. The ``ends
    (3, d)`` are workspace for the centre of the piece, and the ends of its box.
    """
    centre = ends[0]
    if len(centre) == 2:
        lower, upper = octagon(piece, shape.offsets, shape.vertices, shape.points, limit, centre)
    else:
        low, high = ends[1], ends[2]
        lower, upper = box(piece, shape.offsets, shape.vertices, shape.points, low, high)
        for k in range(3):
            centre[k] = 0.5 * (low[k] + high[k])
    # Only bounds that are clear of rounding decide.
    if lower > limit * (1.0 + 1e-12):
        return 0
    return 1 if upper < limit * (1.0 - 1e-12) else -1
