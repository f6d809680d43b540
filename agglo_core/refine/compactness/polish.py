"""Sweeps of the k-way polish: prepare their arrays, and share the slices out to threads."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.refine.compactness.strips import slices, strip_order
from agglo_core.threads import mapped, thread_count

_SWEEPS = 12
"""Sweeps at most; a block that gains little is done earlier (``listed_cells`` in ``state.py``)."""

_FEW = 2_000
"""So few cells are looked at faster by one thread than by several."""


def swept(graph: Graph, labels: Int, block: Int, alpha: float, floor: float, limit: float) -> Int:
    """Labels ``(n,)`` after sweeps that lower inertia times interface to the power ``alpha`` in each block.

    No part is emptied or disconnected, none falls below ``floor`` times its measure, none gets wider than
    ``limit``.
    """
    from agglo_core.refine.compactness.part_order import part_places
    from agglo_core.refine.compactness.state import Cells, State, interface_cells, part_tally
    from agglo_core.refine.compactness.sweeps import sweep_all

    # 1. Sums of the parts, axes of the blocks, the objective and the boundary cells at the start.
    n, k, count = graph.n, len(block), int(block.max()) + 1
    geometry = graph.centroids, graph.weights, graph.mass
    parts, tally = part_tally(labels, k, *geometry, floor)
    axes, places = part_places(block, count, tally)
    cells = Cells(graph.indptr, graph.indices, graph.interface, *geometry, axes)
    blocks, due = interface_cells(cells, parts, tally, block, count)  # as yet neighbours' sums are near
    # 2. New numbers for the parts, in a geometric order: those of a block, and of a slice, are ranges.
    order = strip_order(tally, block, axes, places, graph.dim)
    rank = np.empty(k, np.int32)
    rank[order] = np.arange(k, dtype=np.int32)
    parts, tally = rank.take(parts), tally.take(order, axis=0)  # several times faster than indexing
    starts = frozen_int(np.searchsorted(block[order], np.arange(count + 1)))
    # 3. Two sets of slices for even and odd sweeps: one set ends in the middle of the slices of the other.
    by_turns = tuple(_slices(starts, shift, graph.dim) for shift in range(2))
    room = np.zeros((n, 2), np.int32), np.zeros(k + 1, np.int32), np.empty(n, np.int32)
    state = State(parts, tally, blocks, due, *room, np.zeros((count, 2)), np.ones(count, bool))
    how = alpha, limit, *_reach(graph, parts, k, limit)
    # 4. The sweeps; then the old numbers of the parts.
    if thread_count() == 1:
        sweep_all(cells, state, _work(n, k), *by_turns, _SWEEPS, *how)
    else:
        _swept_together(cells, state, by_turns, how)
    return frozen_int(order.take(parts))


def _swept_together(cells: Any, state: Any, by_turns: Any, how: tuple[Any, ...]) -> None:
    """The sweeps of ``sweep_all``, several slices at a time."""
    from agglo_core.refine.compactness.state import listed_cells
    from agglo_core.refine.compactness.sweeps import sweep_slices

    threads = thread_count()
    work = [_work(len(state.parts), len(state.tally)) for _ in range(threads)]
    for sweep in range(_SWEEPS):
        slices, before = by_turns[sweep % 2], by_turns[1 - sweep % 2]
        looked_at = listed_cells(state, work[0], sweep, before, how[0])
        if looked_at == 0:
            break
        ranges = _shares(slices.rows, state.first, threads if looked_at > _FEW else 1)

        def make(start: int, stop: int, own: Any, sweep: int = sweep, slices: Any = slices) -> None:
            sweep_slices(cells, state, own, slices, start, stop, sweep, *how)

        list(mapped(make, *zip(*ranges, strict=True), work[: len(ranges)]))


def _work(n: int, k: int) -> Any:
    from agglo_core.refine.compactness.state import Work

    return Work(np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.empty(n + 1), np.zeros(k))


def _slices(starts: Int, shift: int, dim: int) -> Any:
    from agglo_core.refine.compactness.state import Slices

    rows = slices(starts, shift, dim)
    return Slices(rows, np.zeros((len(rows), 2)))


def _reach(graph: Graph, parts: Any, k: int, limit: float) -> tuple[Any, Any]:
    """Lists, extents and vertices for tests of the widths of parts; empty if widths have no limit."""
    from agglo_core.refine.compactness.reach import Corners, Reach, cell_radii, part_lists

    centroids = graph.centroids
    if limit == np.inf:
        parts, k, centroids = parts[:0], 0, centroids[:0]
        shape = frozen_int([0]), frozen_index([]), graph.points
    else:
        shape = graph.vertex_offsets, graph.vertices, graph.points
    corners = Corners(*shape, centroids, cell_radii(*shape, centroids), *directions(graph.dim))
    extents = np.empty((k, len(corners.directions), 2))
    ends = np.empty(extents.shape, np.int32)
    first, after, before = part_lists(parts, k)
    far, looks = np.full(k, -1, np.int32), np.zeros(k, np.int64)
    return Reach(first, after, before, far, looks, extents, ends), corners


def _shares(rows: Int, first: Any, count: int) -> list[tuple[int, int]]:
    """The slices in at most ``count`` ranges with about as many cells to be looked at."""
    if count == 1 or len(rows) == 1:
        return [(0, len(rows))]
    cells = first[rows[:, 1]]
    cuts = np.searchsorted(cells, cells[-1] * np.arange(1, count) / count)
    ends = [0, *cuts.tolist(), len(rows)]
    return [(start, stop) for start, stop in pairwise(ends) if start < stop]


@cache
def directions(dim: int) -> tuple[Float, float]:
    """Unit vectors ``(D, dim)``, and the cosine of the largest angle that any direction makes with the next.

    In space they go through the corners, the middles of edges and of faces of a cube.
    """
    if dim == 2:
        angles = np.arange(8) * np.pi / 8
        return frozen_float(np.stack((np.cos(angles), np.sin(angles)), axis=1)), float(np.cos(np.pi / 16))
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1.0
    unit = frozen_float(steps / np.linalg.norm(steps, axis=1)[:, None])
    return unit, float(1.0 / np.sqrt(1.0 + (np.sqrt(2.0) - 1.0) ** 2 + (np.sqrt(3.0) - np.sqrt(2.0)) ** 2))
