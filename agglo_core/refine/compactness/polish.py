"""Sweeps that polish a k-way partition: prepare the arrays, and distribute part groups to threads."""

from __future__ import annotations

from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_index, frozen_int
from agglo_core.graph import Graph
from agglo_core.refine.compactness.strips import slices, strip_order
from agglo_core.threads import mapped, over_ranges, thread_count

_ROUNDS = {2: (0.5, 0.0, 2.5), 3: (2.0, 0.5, 0.5, 3.0)}
"""Exponents of the interface in the rounds, relative to that of the objective.

Each round visits all boundary cells again. A round with a small exponent makes parts compact, one with a
large exponent shortens their interface. Alternating rounds do both. More rounds leave parts more compact, and
take longer (benchmarks/polish.py).
"""

_FEW = 2_000
"""Number of listed cells up to which a sweep runs faster in one thread than in several
(benchmarks/threads.py)."""


def sweep_blocks(graph: Graph, labels: Int, block: Int, alpha: float, floor: float, limit: float) -> Int:
    """Move cells to lower inertia times interface^``alpha`` in each block, and return labels ``(n,)``.

    No part is emptied or disconnected, falls below ``floor`` times its measure, or becomes wider than
    ``limit``.
    """
    from agglo_core.refine.compactness.part_order import part_places
    from agglo_core.refine.compactness.state import Cells, State, interface_cells, part_tally
    from agglo_core.refine.compactness.sweeps import sweep_all

    # 1. Part sums, block axes, the objective, and the boundary cells at entry.
    n, k, count = graph.n, len(block), int(block.max()) + 1
    geometry = graph.centroids, graph.weights, graph.mass
    parts, tally = part_tally(labels, k, *geometry, floor)
    axes, places = part_places(block, count, tally)
    cells = Cells(graph.indptr, graph.indices, graph.interface, *geometry, axes)
    blocks, due = interface_cells(cells, parts, tally, block, count)  # before renumbering: better locality
    # 2. Renumber the parts in a geometric order, so that the parts of a block, and of a slice, are ranges.
    order = strip_order(tally, block, axes, places, graph.dim)
    rank = np.empty(k, np.int32)
    rank[order] = np.arange(k, dtype=np.int32)
    parts, tally = rank.take(parts), tally.take(order, axis=0)  # several times faster than indexing
    starts = frozen_int(np.searchsorted(block[order], np.arange(count + 1)))
    # 3. Two sets of slices for even and odd sweeps. Slices of one set end in the middle of slices of the
    #    other.
    by_turns = tuple(_slices(starts, shift, graph.dim) for shift in range(2))
    workspace = np.zeros((n, 2), np.int32), np.zeros(k + 1, np.int32), np.empty(n, np.int32)
    sorted_block, going = frozen_int(block[order]), np.ones(count, bool)
    gains, at_first = np.zeros((count, 2)), np.zeros(count)
    state = State(parts, sorted_block, tally, blocks, due, *workspace, gains, going, at_first)
    exponents = frozen_float([alpha * factor for factor in _ROUNDS[graph.dim]])
    entry, sweep_args = blocks.copy(), (limit, *_reach(graph, parts, k, limit))
    # 4. Run the sweeps, and restore the old part numbers.
    if thread_count() == 1:
        sweep_all(cells, state, _work(n, k), *by_turns, exponents, *sweep_args)
    else:
        _sweep_in_parallel(cells, state, by_turns, exponents, sweep_args)
    result = order.take(parts)
    # 5. Blocks whose objective has increased keep their labels.
    for each in by_turns:
        np.add.at(blocks, each.rows[:, 4], each.gains)  # the gains of the last sweep
    worse = _objective(blocks, alpha) > _objective(entry, alpha)
    if worse.any():
        kept = worse[block[labels]]
        result[kept] = labels[kept]
    return frozen_int(result)


def _objective(blocks: Any, alpha: float) -> Float:
    """Return J · L^α of each block, where the columns of ``blocks (B, 2)`` are J and L."""
    value: Float = np.maximum(blocks[:, 0], 0.0) * np.maximum(blocks[:, 1], 0.0) ** alpha
    return value


def _sweep_in_parallel(
    cells: Any, state: Any, by_turns: Any, exponents: Float, sweep_args: tuple[Any, ...]
) -> None:
    """Run the sweeps of ``sweep_all`` in several threads, each on some of the slices."""
    from agglo_core.refine.compactness.state import SWEEPS, list_due_cells, mark_boundary_cells
    from agglo_core.refine.compactness.sweeps import sweep_slices

    threads, n_listed = thread_count(), 0
    work = [_work(len(state.parts), len(state.tally)) for _ in range(threads)]
    for sweep in range(len(exponents) * SWEEPS):
        alpha, begins = exponents[sweep // SWEEPS], sweep % SWEEPS == 0
        slices, before = by_turns[sweep % 2], by_turns[1 - sweep % 2]
        if begins and sweep > 0:  # in the first round they are marked already
            mark = partial(mark_boundary_cells, cells, state, sweep)
            over_ranges(mark, len(state.parts))
        if begins or n_listed:
            n_listed = list_due_cells(cells, state, work[0], sweep, begins, before, alpha)
        if n_listed == 0:
            continue  # the round has ended
        ranges = _shares(slices.rows, state.first, threads if n_listed > _FEW else 1)

        def visit(
            start: int,
            stop: int,
            workspace: Any,
            slices: Any = slices,
            turn: tuple[int, float] = (sweep, alpha),
        ) -> None:
            sweep_slices(cells, state, workspace, slices, start, stop, *turn, *sweep_args)

        list(mapped(visit, *zip(*ranges, strict=True), work[: len(ranges)]))


def _work(n: int, k: int) -> Any:
    from agglo_core.refine.compactness.state import Work

    return Work(np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.empty(n + 1), np.zeros(k))


def _slices(starts: Int, shift: int, dim: int) -> Any:
    from agglo_core.refine.compactness.state import Slices

    rows = slices(starts, shift, dim)
    return Slices(rows, np.zeros((len(rows), 2)))


def _reach(graph: Graph, parts: Any, k: int, limit: float) -> tuple[Any, Any]:
    """Return the cell lists, part extents and vertices for width tests, all empty without a width limit."""
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
    """Divide the slices into at most ``count`` ranges with about equally many cells to visit."""
    if count == 1 or len(rows) == 1:
        return [(0, len(rows))]
    cells = first[rows[:, 1]]
    cuts = np.searchsorted(cells, cells[-1] * np.arange(1, count) / count)
    ends = [0, *cuts.tolist(), len(rows)]
    return [(start, stop) for start, stop in pairwise(ends) if start < stop]


@cache
def directions(dim: int) -> tuple[Float, float]:
    """Return unit vectors ``(D, dim)``, and the cosine of a direction's largest angle to the nearest one.

    In 3-D the vectors point to the corners, edge midpoints and face centres of a cube.
    """
    if dim == 2:
        angles = np.arange(8) * np.pi / 8
        return frozen_float(np.stack((np.cos(angles), np.sin(angles)), axis=1)), float(np.cos(np.pi / 16))
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1.0
    unit = frozen_float(steps / np.linalg.norm(steps, axis=1)[:, None])
    return unit, float(1.0 / np.sqrt(1.0 + (np.sqrt(2.0) - 1.0) ** 2 + (np.sqrt(3.0) - np.sqrt(2.0)) ** 2))
