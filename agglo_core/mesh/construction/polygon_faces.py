"""Build the faces of a 2-D mesh by pairing half-edges, in buckets or, for unusual edges, one by one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from agglo_core.arrays import Index, Int, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import warn_of_overlaps
from agglo_core.mesh.counting_sort import counting_sort
from agglo_core.threads import mapped, over_ranges, ranges

# minimum buckets per range of a thread, of about 2,000 points each (benchmarks/threads.py --cells 50000)
_FEW_BUCKETS = 10


def polygon_faces(
    offsets: Int, vertices: Int, used: Int, own: Int, *, weak: bool, strict: bool
) -> tuple[Int, Int, int]:
    """Pair the half-edges of counter-clockwise cells into faces.

    Parameters
    ----------
    offsets, vertices : int
        Vertices per cell as CSR.
    used, own : int
        Point and cell numbers in messages.
    weak : bool
        Accept a cell that traverses an edge twice.
    strict : bool
        Reject two cells on the same side of an edge.

    Returns
    -------
    face_vertices, face_cells : (n_faces, 2) int
        In the order in which the cells meet the faces.
    overlaps : int
        Number of cell pairs on the same side of an edge.

    Raises
    ------
    MeshError
        For more than two cells at an edge, duplicate cells, or a cell that has an edge twice.
    """
    from agglo_core.mesh.kernels.faces import match_half_edges

    # Ordinary edges are paired in parallel, unusual edges with complete checks.
    faces = plain_faces(offsets, vertices, len(used))
    if faces is not None:
        return *faces, 0
    face_vertices, face_cells, double, (a, b, *cells) = match_half_edges(offsets, vertices, len(used))
    if a >= 0:
        _refuse_duplicates(offsets, vertices, own, combinations(cells, 2))
        named = ", ".join(str(own[cell]) for cell in sorted(cells))
        raise MeshError(
            f"the face between points {used[a]} and {used[b]} has more than two cells: cells {named}"
        )
    if weak:  # an agglomerate of two overlapping cells traverses their common edge twice
        double = double[double[:, 0] != double[:, 1]]
    _refuse_duplicates(offsets, vertices, own, double.tolist())
    for first, second in double.tolist():
        if strict:
            raise MeshError(
                f"cells {own[first]} and {own[second]} overlap: both lie on the same side of an edge"
            )
    warn_of_overlaps(frozen_int(own[double]))
    return frozen_int(face_vertices), frozen_int(face_cells), len(double)


def _refuse_duplicates(offsets: Int, vertices: Int, numbers: Int, pairs: Iterable[Sequence[int]]) -> None:
    """Raise MeshError if two cells of a pair have equal vertices, or a cell has an edge twice."""
    for first, second in pairs:
        if first == second:
            raise MeshError(f"cell {numbers[first]}: a repeated vertex (it traverses an edge twice)")
        a, b = (np.sort(vertices[offsets[c] : offsets[c + 1]]) for c in (first, second))
        if np.array_equal(a, b):
            raise MeshError(
                f"cells {numbers[first]} and {numbers[second]} are duplicates: they have the same vertices"
            )


def plain_faces(offsets: Int, vertices: Int, n_points: int) -> tuple[Int, Int] | None:
    """Return the vertices and the cells of all faces, ``(n_faces, 2)`` each, for counter-clockwise cells.

    Return None if an edge has more than two cells, two on the same side, or one cell on both sides. Faces are
    in the order in which the cells meet them.
    """
    n = len(vertices)
    if n > np.iinfo(np.int32).max:
        return None
    beyond = _cells_across(offsets, vertices, n_points)
    return None if beyond is None else _collect_faces(offsets, vertices, beyond)


def _cells_across(offsets: Int, vertices: Int, n_points: int) -> Index | None:
    """Return the cell across each half-edge: −1 outside, −2 if it is the second of its face."""
    from agglo_core.mesh.kernels.pairing import BITS, pair_half_edges, to_buckets

    buckets = ((n_points - 1) >> BITS) + 1
    edges, beyond = np.empty((len(vertices), 4), np.int32), np.empty(len(vertices), np.int32)

    def put(start: int, stop: int, places: Int, only_count: bool) -> None:
        to_buckets(offsets[start : stop + 1], vertices, start, places, edges[:0] if only_count else edges)

    def pairs(start: int, stop: int) -> int:
        return int(pair_half_edges(edges, bounds[start : stop + 1], start, beyond))

    bounds = counting_sort(put, len(offsets) - 1, buckets)
    return None if min(over_ranges(pairs, buckets, few=_FEW_BUCKETS)) < 0 else beyond


def _collect_faces(offsets: Int, vertices: Int, beyond: Index) -> tuple[Int, Int]:
    """Number the faces, and return their vertices and cells, from the cells across half-edges."""
    from agglo_core.mesh.kernels.pairing import number_faces

    spans = ranges(len(offsets) - 1)

    # Each thread numbers the faces of a cell range, after the faces of the ranges before.
    def counted(start: int, stop: int) -> int:
        return int(np.count_nonzero(beyond[offsets[start] : offsets[stop]] >= -1))

    stops = np.cumsum(list(mapped(counted, *zip(*spans, strict=True)))).tolist()
    face_vertices, face_cells = np.empty((stops[-1], 2), np.int64), np.empty((stops[-1], 2), np.int64)

    def number(span: tuple[int, int], first: int, last: int) -> None:
        own = offsets[span[0] : span[1] + 1]
        number_faces(own, vertices, beyond, span[0], face_vertices[first:last], face_cells[first:last])

    list(mapped(number, spans, [0, *stops[:-1]], stops))
    return frozen_int(face_vertices), frozen_int(face_cells)
