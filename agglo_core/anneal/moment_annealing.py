"""Annealing: cells move at random between adjacent parts, with ever fewer moves that worsen the parts.

The objective is the sum of part scores, to be maximised. A part's score is evenness · min(d/h, 1) + roundness
· ratio − penalty · max(d/h − 1, 0), with the exact diameter d and the size h. The ratio replaces the ratio
2r/d of an inscribed circle or ball, with r proportional to measure over surface.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.anneal.state import (
    COUNT,
    DIAMETER,
    MEASURE,
    SURFACE,
    draw_loss,
    draw_move,
    exchange,
    may_leave,
    most_draws,
    share_seed,
)
from agglo_core.anneal.widths import width_with_cell, width_without_cell
from agglo_core.compiled.compiling import ONE, helper, kernel


@helper
def _score(width, measure, surface, params, penalty):
    """Return the score of a part from its width, measure and surface.

    ``params`` is (size h, evenness, roundness, ratio of a part with unit sums).
    """
    size, evenness, round_, unit = params
    denominator, excess = surface * width, width / size - 1.0
    ratio = min(unit * measure / denominator, 1.0) if denominator > 0.0 else 0.0
    return evenness * min(width / size, 1.0) + round_ * ratio - (penalty * excess if excess > 0.0 else 0.0)


@helper
def _of_part(p, parts, params, penalty):
    return _score(parts.tally[p, DIAMETER], parts.tally[p, MEASURE], parts.tally[p, SURFACE], params, penalty)


@helper
def _shared_measures(i, p, q, cells, parts):
    """Return the measure of the faces between cell i and the parts p and q."""
    home_area, target_area, i = 0.0, 0.0, np.uint64(i)
    for h in range(np.uint64(cells.indptr[i]), np.uint64(cells.indptr[i + ONE])):
        label, length = parts.labels[np.uint32(cells.indices[h])], cells.interface[h]
        home_area += length if label == p else 0.0
        target_area += length if label == q else 0.0
    return home_area, target_area


@helper
def _put(i, p, q, widths, surfaces, cells, parts):
    """Move cell i from part p to part q, and set their new widths and surfaces."""
    exchange(i, p, q, parts)
    for part, sign, width, surface in ((p, -1.0, widths[0], surfaces[0]), (q, 1.0, widths[1], surfaces[1])):
        parts.tally[part, MEASURE] += sign * cells.measures[i]
        parts.tally[part, COUNT] += sign
        parts.tally[part, DIAMETER], parts.tally[part, SURFACE] = width[0], surface
        parts.ends[part, 0], parts.ends[part, 1] = width[1], width[2]


@helper
def _try_move(i, p, q, least, params, penalty, cells, parts, work, stamp):
    """Move cell i from part p to part q unless the sum of their scores falls below ``least``.

    Returns True if the cell moved.
    """
    # 1. Diameter of q with the cell. No score exceeds evenness + roundness: if the penalty of q alone brings
    #    the sum below ``least``, reject.
    target_width = width_with_cell(i, q, cells, parts)
    excess = target_width[0] / params[0] - 1.0
    if excess > 0.0 and 2.0 * (params[1] + params[2]) - penalty * excess < least:
        return False
    # 2. Part p must stay connected. If so, the cell has label q from here on.
    if not may_leave(i, p, q, cells, parts, work, stamp):
        return False
    # 3. The cell's faces with p become outer faces of p, its faces with q inner faces of q.
    home_area, target_area = _shared_measures(i, p, q, cells, parts)
    home_width = width_without_cell(p, cells, parts, work, stamp)
    measure, surface = cells.measures[i], cells.surfaces[i]
    surfaces = (
        parts.tally[p, SURFACE] - surface + 2.0 * home_area,
        parts.tally[q, SURFACE] + surface - 2.0 * target_area,
    )
    # 4. Metropolis criterion: accept if the new scores reach ``least``, reject NaN.
    after = _score(home_width[0], parts.tally[p, MEASURE] - measure, surfaces[0], params, penalty)
    after += _score(target_width[0], parts.tally[q, MEASURE] + measure, surfaces[1], params, penalty)
    if not after >= least:
        parts.labels[i] = p
        return False
    _put(i, p, q, (home_width, target_width), surfaces, cells, parts)
    return True


@kernel(allocates=False)
def anneal(cells, parts, work, shares, start, stop, params, rounds, seed, stamp):
    """Draw cells at random from groups of parts, and move them to adjacent parts if admissible.

    The groups are the shares ``start`` to ``stop`` − 1. ``rounds (3, R)`` are temperatures, penalties, and
    draws per cell. No part is emptied or disconnected. Returns the move count. Search marks are numbered
    from ``stamp``, with one number per draw of each cell over all rounds, and one more per round. The numbers
    must be unused in the workspace.
    """
    moved, most = 0, most_draws(rounds)
    for s in range(start, stop):
        # 1. Each share has its own random numbers and marks, so results do not depend on the number of
        #    threads.
        state, count = share_seed(seed, s), shares.starts[s + 1] - shares.starts[s]
        mark = stamp + most * shares.starts[s]
        for r in range(rounds.shape[1]):
            heat, penalty = rounds[0, r], rounds[1, r]
            for _ in range(np.int64(rounds[2, r] * count)):
                # 2. Draw a cell, and a neighbour whose part q it may join; p = q if no move is possible.
                mark += 1
                state, i, p, q = draw_move(state, s, shares, cells, parts)
                if p == q:
                    continue
                # 3. Draw the admissible loss at this temperature before evaluating the move, so that bounds
                #    can reject it early.
                state, loss = draw_loss(state, heat)
                least = _of_part(p, parts, params, penalty) + _of_part(q, parts, params, penalty) + loss
                moved += _try_move(i, p, q, least, params, penalty, cells, parts, work, mark)
    return moved
