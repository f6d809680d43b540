"""Anneal 2-D parts with true inscribed circles instead of the measure-to-surface ratio."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

import numpy as np

from agglo_core.anneal.circles import (
    ACROSS,
    CENTRED,
    MOMENT,
    RADIUS,
    centre_of,
    centred_radius,
    circle_inside,
    outline,
    touches,
)
from agglo_core.anneal.state import (
    COUNT,
    DIAMETER,
    MEASURE,
    draw_loss,
    draw_move,
    exchange,
    may_leave,
    most_draws,
    share_seed,
)
from agglo_core.anneal.widths import width_with_cell, width_without_cell
from agglo_core.compiled.compiling import helper, kernel

_GROWTH = 1.3
"""Upper bound, almost always valid, on the growth factor of a circle radius when one cell joins.

A smaller factor rejects good moves unseen, a larger factor leads to more unsuccessful circle searches
(benchmarks/roundness.py).
"""

_WIDEST = 0.47
"""Upper bound, almost always valid, on the circle radius over the diameter (0.5 for a disc).

A smaller bound rejects good moves unseen, a larger bound costs more tests (benchmarks/roundness.py).
"""


@helper
def _score(width, radius, centred, params, penalty):
    """Return the score of a part from its width and the radii of its two circles.

    ``params`` is (size h, evenness, weights for both circle ratios). The circles are the largest
    inscribed circle, and the largest about the centroid.
    """
    size, evenness, round_, central = params
    excess = width / size - 1.0
    ratio = 2.0 * (round_ * radius + central * centred) / width if width > 0.0 else 0.0
    return evenness * min(width / size, 1.0) + ratio - (penalty * excess if excess > 0.0 else 0.0)


@helper
def _of_part(p, parts, circles, params, penalty):
    return _score(
        parts.tally[p, DIAMETER], circles.rings[p, RADIUS], circles.rings[p, CENTRED], params, penalty
    )


@helper
def _update_sums(i, p, sign, parts, cells, circles):
    """Add the cell to the sums of part p (sign 1), or subtract it (−1)."""
    parts.tally[p, MEASURE] += sign * cells.measures[i]
    parts.tally[p, COUNT] += sign
    for a in range(2):
        circles.rings[p, MOMENT + a] += sign * cells.measures[i] * cells.centroids[i, a]


@helper
def _swap(i, p, q, parts, cells, circles):
    """Update cell lists and sums for a move of cell i from part p to part q."""
    exchange(i, p, q, parts)
    _update_sums(i, p, -1.0, parts, cells, circles)
    _update_sums(i, q, 1.0, parts, cells, circles)


@helper
def _new_circle(p, changed, cells, parts, edges, circles):
    """Return the largest circle found inside part p, and the radius of the circle about its centroid.

    The old circle remains unless ``changed``. Returns radius, centre, and the other radius.
    """
    rings = circles.rings
    m = outline(p, parts, edges, circles)
    guess, centre = (rings[p, ACROSS], rings[p, ACROSS + 1]), centre_of(p, parts, circles)
    if changed:
        return circle_inside(p, m, guess, centre, cells, parts, circles.room)
    # The old circle is still the best, unless the circle about the new centroid is larger.
    centred = centred_radius(m, centre, circles.room)
    if centred > rings[p, RADIUS]:
        return circle_inside(p, m, guess, centre, cells, parts, circles.room)
    return rings[p, RADIUS], guess[0], guess[1], centred


@helper
def _write(p, width, circle, parts, circles):
    """Store the width and the circle of part p."""
    parts.tally[p, DIAMETER], parts.ends[p, 0], parts.ends[p, 1] = width
    for a in range(4):
        circles.rings[p, a] = circle[a]


@helper
def _try_move(i, p, q, least, params, penalty, cells, parts, edges, circles, work, stamp):
    """Move cell i from part p to part q unless the sum of their scores falls below ``least``.

    Returns True if the cell moved. Bounds come first: the circle of p does not grow, and the circle of q only
    grows if it touches an edge shared with the cell.
    """
    rings, size, evenness = circles.rings, params[0], params[1]
    # 1. Reject if the diameter penalty of q brings even the largest possible scores below ``least``.
    target_width = width_with_cell(i, q, cells, parts)
    excess, most = target_width[0] / size - 1.0, evenness + 2.0 * _WIDEST * (params[2] + params[3])
    if excess > 0.0 and 2.0 * most - penalty * excess < least:
        return False
    # 2. Part p must stay connected. If so, the cell has label q from here on.
    if not may_leave(i, p, q, cells, parts, work, stamp):
        return False
    home_width = width_without_cell(p, cells, parts, work, stamp)
    # 3. Bounds on both scores: p keeps its radius. The radius of q only grows, by a bounded factor, if an
    #    edge between q and the cell, which disappears, touches its circle.
    home_radius = rings[p, RADIUS]
    grows = touches(i, q, rings[q, ACROSS], rings[q, ACROSS + 1], 1.01 * rings[q, RADIUS], parts, edges)
    bound = min(_WIDEST * target_width[0], _GROWTH * rings[q, RADIUS]) if grows else rings[q, RADIUS]
    target_bound = _score(target_width[0], bound, bound, params, penalty)
    if _score(home_width[0], home_radius, home_radius, params, penalty) + target_bound < least:
        parts.labels[i] = p
        return False
    # 4. The circle of p changes if its centre may lie in the cell, or if an edge between p and the cell,
    #    which becomes an outer edge, intersects it.
    x, y = rings[p, ACROSS] - cells.centroids[i, 0], rings[p, ACROSS + 1] - cells.centroids[i, 1]
    shrinks = x * x + y * y < cells.radii[i] ** 2 or touches(
        i, p, rings[p, ACROSS], rings[p, ACROSS + 1], home_radius, parts, edges
    )
    # 5. Compute the circle of p, then the circle of q if both can still reach ``least`` with the bound on q.
    _swap(i, p, q, parts, cells, circles)
    home_circle = _new_circle(p, shrinks, cells, parts, edges, circles)
    score = _score(home_width[0], home_circle[0], home_circle[3], params, penalty)
    target_circle = home_circle
    if score + target_bound >= least:
        target_circle = _new_circle(q, grows, cells, parts, edges, circles)
        score += _score(target_width[0], target_circle[0], target_circle[3], params, penalty)
    else:
        score = -np.inf
    # 6. Metropolis criterion: undo the move, or store widths and circles.
    if not score >= least:
        parts.labels[i] = p
        _swap(i, q, p, parts, cells, circles)
        return False
    _write(p, home_width, home_circle, parts, circles)
    _write(q, target_width, target_circle, parts, circles)
    return True


@kernel(allocates=False)
def anneal_circles(cells, edges, parts, circles, work, shares, start, stop, params, rounds, seed, stamp):
    """Draw and move cells as ``anneal`` does, with scores from true circles, and count the moves."""
    moved, most = 0, most_draws(rounds)
    for s in range(start, stop):
        # 1. Random numbers and marks of this share.
        state, count = share_seed(seed, s), shares.starts[s + 1] - shares.starts[s]
        mark = stamp + most * shares.starts[s]
        for r in range(rounds.shape[1]):
            heat, penalty = rounds[0, r], rounds[1, r]
            for _ in range(np.int64(rounds[2, r] * count)):
                mark += 1
                # 2. Draw a cell and its target part.
                state, i, p, q = draw_move(state, s, shares, cells, parts)
                if p == q:
                    continue
                # 3. Smallest admissible sum of both scores: the sum before the move minus the Metropolis
                #    loss.
                state, loss = draw_loss(state, heat)
                least = _of_part(p, parts, circles, params, penalty) + _of_part(
                    q, parts, circles, params, penalty
                )
                arguments = cells, parts, edges, circles, work, mark
                moved += _try_move(i, p, q, least + loss, params, penalty, *arguments)
    return moved
