"""Faces of polygons where no edge is out of the ordinary, by half-edges in buckets."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Index, Int, frozen_int
from agglo_core.mesh.counting_sort import counting_sort
from agglo_core.threads import mapped, over_ranges, ranges

_FEW_BUCKETS = 10  # of some 2,000 points


def plain_faces(offsets: Int, vertices: Int, n_points: int) -> tuple[Int, Int] | None:
    """Face vertices and face cells ``(n_faces, 2)`` of counter-clockwise loops, each below.

    None if an edge has more than two cells, two on the same side, or one cell on both sides. Faces come in
    the order in which the cells meet them.
    """
    n = len(vertices)
    if n > np.iinfo(np.int32).max:
        return None
    beyond = _beyond(offsets, vertices, n_points)
    return None if beyond is None else _numbered(offsets, vertices, beyond)


def _beyond(offsets: Int, vertices: Int, n_points: int) -> Index | None:
    """Cell beyond each half-edge: −1 outside, −2 at the later of two."""
    from agglo_core.mesh.kernels.pairing import BITS, pair_half_edges, to_buckets

    buckets = ((n_points - 1) >> BITS) + 1
    edges, beyond = np.empty((len(vertices), 4), np.int32), np.empty(len(vertices), np.int32)

    def put(start: int, stop: int, places: Int, only_count: bool) -> None:
        to_buckets(offsets[start : stop + 1], vertices, start, places, edges[:0] if only_count else edges)

    def pairs(start: int, stop: int) -> int:
        return int(pair_half_edges(edges, bounds[start : stop + 1], start, beyond))

    bounds = counting_sort(put, len(offsets) - 1, buckets)
    return None if min(over_ranges(pairs, buckets, few=_FEW_BUCKETS)) < 0 else beyond


def _numbered(offsets: Int, vertices: Int, beyond: Index) -> tuple[Int, Int]:
    """Face vertices and face cells."""
    from agglo_core.mesh.kernels.pairing import number_faces

    spans = ranges(len(offsets) - 1)

    def counted(start: int, stop: int) -> int:
        return int(np.count_nonzero(beyond[offsets[start] : offsets[stop]] >= -1))

    stops = np.cumsum(list(mapped(counted, *zip(*spans, strict=True)))).tolist()
    face_vertices, face_cells = np.empty((stops[-1], 2), np.int64), np.empty((stops[-1], 2), np.int64)

    def number(span: tuple[int, int], first: int, last: int) -> None:
        own = offsets[span[0] : span[1] + 1]
        number_faces(own, vertices, beyond, span[0], face_vertices[first:last], face_cells[first:last])

    list(mapped(number, spans, [0, *stops[:-1]], stops))
    return frozen_int(face_vertices), frozen_int(face_cells)
