"""Annealing for solvers: cells move at random, with ever fewer moves that increase inertia and interface.

A move changes only two parts' weights, centres and interfaces, so it takes about 30 ns.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.anneal.state import (
    COUNT,
    DIAMETER,
    MEASURE,
    Parts,
    Work,
    draw_loss,
    draw_move,
    exchange,
    may_leave,
    most_draws,
    share_seed,
)
from agglo_core.anneal.widths import widest, width_with_cell, width_without_cell
from agglo_core.compiled.compiling import ONE, helper, kernel

SIZE, CENTRE, _COLUMNS = 1, 4, 7
"""Columns of part size and centre, and number of columns. The weight uses the column of the measure."""


class Pursuit(NamedTuple):
    """Objective, inertia · J + interface · L plus size penalties, and bounds on width and size.

    Fields: cell weights and sizes ``(n,)``, factors for the inertia J and the interface L, the largest part
    width, the smallest and largest part size, and the unit for size deviations.
    """

    weights: Any
    sizes: Any
    inertia: Any
    interface: Any
    limit: Any
    least: Any
    most: Any
    unit: Any


@helper
def _square(i, p, cells, parts):
    """Return the squared distance from cell i to the centre of part p."""
    x = cells.centroids[i, 0] - parts.tally[p, CENTRE]
    y = cells.centroids[i, 1] - parts.tally[p, CENTRE + 1]
    z = cells.centroids[i, 2] - parts.tally[p, CENTRE + 2] if cells.centroids.shape[1] > 2 else 0.0
    return x * x + y * y + z * z


@helper
def _off(size, pursuit):
    """Return the squared deviation of a part size from its bounds, in units of ``pursuit.unit``."""
    off = max(max(size - pursuit.most, pursuit.least - size), 0.0) / pursuit.unit
    return off * off


@helper
def _change(i, p, q, cells, parts, pursuit, penalty):
    """Return the change in the objective when cell i moves from part p to part q."""
    w, cut, i = pursuit.weights[i], 0.0, np.uint64(i)
    home_mass, target_mass = parts.tally[p, MEASURE] - w, parts.tally[q, MEASURE] + w
    # 1. Inertia (Steiner): p loses w m / (m − w) |x − c|², q gains w m / (m + w) |x − c|², with the mass m
    #    and centre c of each part before the move.
    loss = _square(i, p, cells, parts) * parts.tally[p, MEASURE] / home_mass if home_mass > 0.0 else 0.0
    gain = _square(i, q, cells, parts) * parts.tally[q, MEASURE] / target_mass if target_mass > 0.0 else 0.0
    # 2. Interface: faces with p are added, faces with q are removed.
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        label, length = parts.labels[np.uint32(cells.indices[h])], cells.interface[h]
        cut += length if label == p else 0.0
        cut -= length if label == q else 0.0
    change = pursuit.inertia * w * (gain - loss) + pursuit.interface * cut
    # 3. Penalty: difference in the squared size deviations.
    if penalty > 0.0:
        home_size, target_size, size = parts.tally[p, SIZE], parts.tally[q, SIZE], pursuit.sizes[i]
        deviation = (
            _off(home_size - size, pursuit)
            - _off(home_size, pursuit)
            + _off(target_size + size, pursuit)
            - _off(target_size, pursuit)
        )
        change += penalty * deviation
    return change


@helper
def _take(i, p, sign, cells, parts, weights, sizes):
    """Update the sums of part p, which gains (sign 1) or loses (−1) cell i."""
    w = sign * weights[i]
    mass = parts.tally[p, MEASURE] + w
    step = w / mass if mass > 0.0 else 0.0
    for a in range(cells.centroids.shape[1]):
        parts.tally[p, CENTRE + a] += (cells.centroids[i, a] - parts.tally[p, CENTRE + a]) * step
    parts.tally[p, MEASURE] = mass
    parts.tally[p, SIZE] += sign * sizes[i]
    parts.tally[p, COUNT] += sign


@helper
def _move_cell(i, p, q, cells, parts, work, pursuit, stamp):
    """Move cell i from part p to q if p stays connected and q within the width limit.

    Returns True if the cell moved.
    """
    limited = pursuit.limit < np.inf
    target_width = (0.0, np.int32(-1), np.int32(-1))
    # 1. A part that was too wide before may stay so, but not become wider.
    if limited:
        target_width = width_with_cell(i, q, cells, parts)
        if target_width[0] > pursuit.limit and target_width[0] > parts.tally[q, DIAMETER]:
            return False
    # 2. Part p must stay connected. If so, the cell has label q from here on.
    if not may_leave(i, p, q, cells, parts, work, stamp):
        return False
    # 3. Update widths and cell lists, only if there is a limit.
    if limited:
        home_width = width_without_cell(p, cells, parts, work, stamp)
        exchange(i, p, q, parts)
        for part, width in ((p, home_width), (q, target_width)):
            parts.tally[part, DIAMETER], parts.ends[part, 0], parts.ends[part, 1] = width
    _take(i, p, -1.0, cells, parts, pursuit.weights, pursuit.sizes)
    _take(i, q, 1.0, cells, parts, pursuit.weights, pursuit.sizes)
    return True


@kernel(allocates=False)
def anneal_inertia(cells, parts, work, shares, start, stop, pursuit, rounds, seed, stamp):
    """Draw cells at random from groups of parts, and move them to adjacent parts if admissible.

    The groups are the shares ``start`` to ``stop`` − 1. A move is admissible if the objective increases by no
    more than the Metropolis criterion allows. No part is emptied or disconnected. No part becomes wider than
    the limit, or than before. Penalties apply to sizes beyond their bounds. Arguments and marks are as in
    ``anneal``.
    """
    moved, most = 0, most_draws(rounds)
    for s in range(start, stop):
        # 1. Random numbers and marks of this share.
        state, count = share_seed(seed, s), shares.starts[s + 1] - shares.starts[s]
        mark = stamp + most * shares.starts[s]
        for r in range(rounds.shape[1]):
            for _ in range(np.int64(rounds[2, r] * count)):
                mark += 1
                # 2. Draw a cell and its target part.
                state, i, p, q = draw_move(state, s, shares, cells, parts)
                if p == q:
                    continue
                # 3. Test the Metropolis criterion before the admissibility, because it is cheaper here.
                state, loss = draw_loss(state, rounds[0, r])
                if _change(i, p, q, cells, parts, pursuit, rounds[1, r]) <= -loss:
                    moved += _move_cell(i, p, q, cells, parts, work, pursuit, mark)
    return moved


@kernel
def solver_state(cells, weights, sizes, labels, count, limited):
    """Set up the arrays of the parts ``0..count−1``, with widths and lists if ``limited``, and workspace."""
    n, m = len(labels), (len(labels) if limited else 0)
    part_labels, tally, ends = (
        np.empty(n, np.int32),
        np.zeros((count, _COLUMNS)),
        np.full((count, 2), -1, np.int32),
    )
    first, after, before = np.full(count, -1, np.int32), np.empty(m, np.int32), np.full(m, -1, np.int32)
    parts = Parts(part_labels, tally, ends, first, after, before)
    # 1. Sums and cell lists, in reverse order, so that the lists ascend.
    for i in range(n - 1, -1, -1):
        p = labels[i]
        part_labels[i] = p
        _take(i, p, 1.0, cells, parts, weights, sizes)
        if limited:
            after[i] = first[p]
            if first[p] >= 0:
                before[first[p]] = i
            first[p] = i
    # 2. Workspace, and widths of all parts.
    marks, seen = np.full((n, 2), -1, np.int64), np.full(len(cells.points), -1, np.int64)
    vertex_list = np.empty(len(cells.points) + 1, np.int32)
    work = Work(np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), marks, seen, vertex_list)
    for p in range(count if limited else 0):
        tally[p, DIAMETER], ends[p, 0], ends[p, 1] = widest(p, cells, parts, work, -2 - p)
    return parts, work
