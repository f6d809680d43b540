"""Mesh pieces as slices of one cell list, with functions to test and separate their sides.

A piece is a slice of a cell list, ``cells[lo:hi]``, in ascending order. Each cell carries the ``tag`` of its
side: twice the first position of the piece on the left, and twice the last position plus 1 on the right. No
two pieces share a tag, and no piece needs a graph. The cost therefore depends on the cut, not on the piece.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper, kernel
from agglo_core.compiled.geometry import box, octagon
from agglo_core.compiled.ring_search import are_connected

# In mean weights: heavier cells are in every sample, and represent only themselves. A smaller value makes
# samples larger, a larger value makes them less accurate (benchmarks/partition.py).
HEAVY = 4.0
# One over the fraction of cells chosen for a sample, a power of two. A larger value saves time, but the cut
# may differ more from the cut with all cells (benchmarks/partition.py).
SAMPLED = np.int64(8)
_ABOVE, _LEAST = np.float32(1.0001), np.float32(1e-18)  # single-precision rounding, with a margin
# Run length in cells, of which about an eighth should be chosen. Shorter runs are uneven by chance more
# often, longer runs hide uneven regions (benchmarks/partition.py).
_RUN = 64
# Number of weight bands up to the mean weight, every eighth of which is chosen. Cells whose weights differ by
# more than 1.2 % of the mean lie in different bands. Not an integer, so that rounding does not decide for the
# mean weight itself. Fewer bands choose cells of similar weight together (benchmarks/partition.py).
_BANDS = 87.7


class Units(NamedTuple):
    """Powers of two that scale lengths and weights to order 1, and a mask of sampled cells ``(n,)``."""

    length: Any
    weight: Any
    sample: Any


class PieceGraph(NamedTuple):
    """Dual graph of all cells, unchanged by splits.

    ``indptr, indices, interface`` are its CSR. ``centroids (n, d)``, ``measures`` and ``weights`` are cell
    data. ``reach (n,)`` is the distance to the farthest neighbour times ``units.length``.
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
    """Vertices per cell as a CSR, and their coordinates, for exact diameters."""

    offsets: Any
    vertices: Any
    points: Any


class Pieces(NamedTuple):
    """Cells ordered by piece ``(n,)``, their side tags ``(n,)`` and search marks ``(n, 4)``.

    The marks are the stamp of the last search that reached a cell, the start of that search, the stamp of the
    last visit, and the position in the list of cells with a stamp.
    """

    cells: Any
    tag: Any
    marks: Any


class Sides(NamedTuple):
    """Measures and cell counts of the left and the right side, and the cut normal."""

    measures: Any
    counts: Any
    normal: Any


class Workspace(NamedTuple):
    """Workspace for the refinement and the searches in a piece.

    ``boundary, now, later`` are cell lists, ``queue, root`` belong to a search, and ``keys`` are positions
    along the cut. ``shared (m, 2)`` is the interface of listed cells with the other side and with their own
    side.
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
    """Allocate ``Sides`` with uninitialised arrays."""
    return Sides(np.empty(2), np.empty(2, np.int64), np.empty(3))


@helper
def side_tags(lo, hi):
    """Return the integer tags of cells on the left and the right side of the piece ``cells[lo:hi]``."""
    return np.int64(2 * lo), np.int64(2 * hi - 1)


@helper(allocates=True)
def new_workspace(m):
    """Allocate workspace for pieces with at most m cells."""
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
    """Return scale factors of lengths and weights, and a sample of the cells.

    Units are powers of two, so scaling preserves digits. The sample consists of the chosen cells (1) and the
    heavy cells (2). It is empty ``(0,)`` if the weights are not spread enough.
    """
    # 1. Extent of the centroids and mean weight, and the powers of two that scale them to between 1/2 and 1.
    total, last = 0.0, centroids.shape[1] - 1
    x0, y0, z0, x1, y1, z1 = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for i in range(len(weights)):
        x, y, z = centroids[i, 0], centroids[i, 1], centroids[i, last]
        x0, y0, z0, x1, y1, z1 = min(x0, x), min(y0, y), min(z0, z), max(x1, x), max(y1, y), max(z1, z)
        total += weights[i]
    extent = max(0.0, x1 - x0, y1 - y0, z1 - z0)
    mean = total / len(weights)
    length, weight = math.ldexp(1.0, -math.frexp(extent)[1]), math.ldexp(1.0, -math.frexp(mean)[1])
    # 2. The sample. A run of successive cells, usually close together, is uneven if none of its cells is
    #    chosen or three times too many. Such a mesh region would have too little or too much influence on a
    #    cut.
    bands = _BANDS / mean if mean > 0.0 else 0.0
    uneven, sample = 0, np.empty(len(weights), np.uint8)
    for start in range(0, len(weights), _RUN):
        count = 0
        for i in range(start, int(min(start + _RUN, len(weights)))):
            chosen = is_chosen(weights[i], bands)
            count += chosen
            sample[i] = 2 if weights[i] > HEAVY * mean else chosen
        uneven += not 0 < count < 3 * _RUN // SAMPLED
    spread = 1000 * uneven <= len(weights) // _RUN + 2000  # one in some thousand runs is uneven by chance
    return Units(length, weight, sample if spread else sample[:0])


@helper
def is_chosen(weight, bands):
    """Return True if a cell belongs to the sample, about an eighth of the cells.

    The sample may represent a large piece. A digit of the weight decides, which depends neither on the
    numbering nor on mesh motion. The weights must be spread, otherwise all or none of the cells in a region
    may be chosen. If there are runs with none or too many, ``units_of`` returns no sample.
    """
    return np.int64(weight * bands) & (SAMPLED - 1) == 0


@kernel
def reach_of_cells(indptr, indices, centroids, length, reach):
    """Write each cell's distance to its farthest neighbour, rounded up, to ``reach (n,)``.

    Distances are multiplied by ``length``, which scales the graph extent to order 1, so that single precision
    suffices.
    """
    last = centroids.shape[1] - 1
    # 1. Squares, stored in single precision.
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
    # 2. Square roots, rounded up, because smaller values would miss cells along a cut.
    for i in range(len(reach)):
        reach[i] = _ABOVE * np.sqrt(reach[i]) + _LEAST


@helper
def cells_beside(indptr, indices, tag, left_tag, right_tag, cells, m):
    """Keep the cells of ``cells[:m]`` adjacent to the other side, and return their number."""
    n_adjacent = 0
    for k in range(m):
        i = np.uint32(cells[k])
        other_tag = left_tag + right_tag - tag[i]
        is_adjacent = False
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[np.uint64(i) + ONE])):
            is_adjacent |= tag[np.uint32(indices[h])] == other_tag  # no branch: it would be mispredicted
        cells[n_adjacent] = i
        n_adjacent += is_adjacent
    return n_adjacent


@helper
def sides_connected(graph, pieces, lo, hi, edge, workspace, stamp):
    """Return True if both sides of a connected piece are connected.

    The workspace boundary lists the ``edge`` cells along the cut. ``stamp`` and the next stamp are not yet in
    the first column of the marks. Every component on a side touches the other side. A side is therefore
    connected if its cells along the cut are connected within the side. The search rarely leaves the cut's
    neighbourhood.
    """
    indptr, indices, tag = graph.indptr, graph.indices, pieces.tag
    queue, boundary = workspace.queue, workspace.boundary
    left_tag, right_tag = side_tags(lo, hi)
    whole, everything = True, np.int64(len(tag))
    # The search starts from all cut cells of the side at once, without a distance limit, and ends when they
    # have met.
    for side in range(2):
        # An int32 reuses the version compiled for the refinement.
        label = np.int32(right_tag if side else left_tag)
        filled = np.int64(0)
        for c in range(edge):
            queue[filled] = boundary[c]
            filled += tag[boundary[c]] == label
        search = (queue, workspace.root, pieces.marks)
        whole &= are_connected(
            indptr, indices, tag, label, search, filled, stamp + side, everything, everything
        )
    return whole


@helper
def is_connected(graph, pieces, lo, hi, queue, stamp):
    """Return True if a small piece is connected.

    The ``stamp`` is not yet in the first column of the marks.
    """
    indptr, indices, tag, marks = graph.indptr, graph.indices, pieces.tag, pieces.marks
    # Breadth-first search from the first cell, over cells with its tag.
    first, head, filled = np.uint32(pieces.cells[lo]), np.uint64(0), ONE
    piece_tag, queue[0], marks[first, 0] = tag[first], first, stamp
    while head < filled:
        i = np.uint64(np.uint32(queue[head]))
        head += ONE
        for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = np.uint32(indices[h])
            last = marks[j, 0]
            is_new = (tag[j] == piece_tag) & (last != stamp)
            queue[filled] = j  # kept only if new; a branch would be mispredicted half the time
            filled += np.uint64(is_new)
            marks[j, 0] = stamp if is_new else last
    return np.int64(filled) == hi - lo


@helper
def side_measures(pieces, measures, lo, hi, side_sums):
    """Write the measures of both sides of a piece to ``side_sums``."""
    cells, tag = pieces.cells, pieces.tag
    side_sums[0], side_sums[1] = 0.0, 0.0
    for k in range(lo, hi):
        side_sums[tag[cells[k]] & 1] += measures[cells[k]]


@helper
def part_list(pieces, lo, hi, spare):
    """Move the left side's cells before the others, in order, and return the start of the others."""
    cells, tag, middle, right = pieces.cells, pieces.tag, np.uint64(lo), np.uint64(0)
    # Write each cell to both lists, and advance only the list to which it belongs. The left list overwrites
    # only cells already read.
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
    """Return the left side's part count: its measure share, rounded, between 1 and its cell count.

    A quota of 0, for size goals, stays 0.
    """
    if quota == 0:
        return 0
    left_measure, right_measure = measures[0], measures[1]
    if not left_measure + right_measure > 0.0:
        left_measure, right_measure = float(cells_left), float(cells_right)
    # Both sides need at least one part, and a cell for each of their parts.
    least, most = max(1.0, quota - cells_right), min(quota - 1.0, float(cells_left))
    # Round halves down, despite rounding in the sums.
    share = np.rint(quota * (left_measure / (left_measure + right_measure)) - 1e-9)
    return np.int64(min(max(share, least), most))


@helper
def narrowness(piece, shape, limit, ends):
    """Return 1 if a piece has diameter at most ``limit``, 0 if not, −1 if bounds do not decide.

    Only bounds are compared: a surrounding octagon in 2-D, a box in 3-D. The ``ends (3, d)`` are workspace
    for the centre of the piece and the ends of its box.
    """
    centre = ends[0]
    if len(centre) == 2:
        lower, upper = octagon(piece, shape.offsets, shape.vertices, shape.points, limit, centre)
    else:
        low, high = ends[1], ends[2]
        lower, upper = box(piece, shape.offsets, shape.vertices, shape.points, low, high)
        for k in range(3):
            centre[k] = 0.5 * (low[k] + high[k])
    # Only bounds beyond rounding errors decide.
    if lower > limit * (1.0 + 1e-12):
        return 0
    return 1 if upper < limit * (1.0 - 1e-12) else -1
