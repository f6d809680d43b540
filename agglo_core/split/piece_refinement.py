"""Refine the two sides of a mesh piece: move cells along the cut until the interface is shortest."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.compiled.compiling import ONE, helper
from agglo_core.compiled.ring_search import keeps_whole
from agglo_core.compiled.sorting import sort_by_keys

# Maximum number of sweeps. Each sweep only visits cells whose neighbourhood has changed in the previous
# sweep, so late sweeps cost little (benchmarks/partition.py).
_SWEEPS = 10
_SEEN, _LISTED = np.int64(2), np.int64(3)  # columns of the marks; bare numbers are separate numba types
_TIE = 1e-9  # relative to the cell's interface: smaller gains are rounding


class Gains(NamedTuple):
    """Interface of each listed cell with the other side and with its own side, ``shared (m, 2)``.

    The row of cell i is ``marks[i, 3] − stamp``, negative for an unlisted cell.
    """

    shared: Any
    marks: Any
    stamp: Any


class Edges(NamedTuple):
    """Dual graph of all cells as a CSR, with the interfaces."""

    indptr: Any
    indices: Any
    interface: Any


class Balance(NamedTuple):
    """Measures and cell counts of both sides, changed by moves, and the smallest allowed measure."""

    measures: Any
    counts: Any
    least: Any


@helper
def _sum_up(edges, tag, i, left_tag, right_tag, shared, place):
    """Write the interface of cell i with the other side and with its own side to ``shared[place]``."""
    home, cut_length, home_length = np.int64(tag[i]), 0.0, 0.0
    other_tag = left_tag + right_tag - home
    for h in range(np.uint64(edges.indptr[i]), np.uint64(edges.indptr[i + ONE])):
        t, length = tag[np.uint32(edges.indices[h])], edges.interface[h]
        cut_length += length if t == other_tag else 0.0
        home_length += length if t == home else 0.0
    shared[place, 0], shared[place, 1] = cut_length, home_length


@helper
def _gain(gains, i):
    """Return the interface saved by moving the listed cell i, and the smallest gain above rounding."""
    place = gains.marks[i, _LISTED] - gains.stamp
    there, here = gains.shared[place, 0], gains.shared[place, 1]
    return there - here if there > 0.0 else -np.inf, _TIE * (there + here)


@helper
def _partner(edges, tag, i, home, gain, least, gains):
    """Return the neighbour with which cell i gains most in a joint move, or −1 if no pair gains.

    Unlisted cells are not adjacent to the other side: they lose at least their interface with cell i.
    """
    indptr, indices, interface = edges
    partner, best = np.int64(-1), least
    for h in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        j = np.uint64(np.uint32(indices[h]))
        if tag[j] != home:
            continue
        # 1. Joint gain: listed neighbours have stored sums, others lose their interface with the own side.
        place, pair_gain = gains.marks[j, _LISTED] - gains.stamp, gain + 2.0 * interface[h]
        if place >= 0:
            pair_gain += gains.shared[place, 0] - gains.shared[place, 1]
        elif gain + interface[h] <= best:
            continue
        else:
            for g in range(np.uint64(indptr[j]), np.uint64(indptr[j + ONE])):
                pair_gain -= interface[g] if tag[np.uint32(indices[g])] == home else 0.0
        # 2. Keep the best pair.
        if pair_gain > best:
            partner, best = np.int64(j), pair_gain
    return partner


@helper
def _leave(edges, measures, tag, i, home, target, balance, search, stamp):
    """Move cell i to the other side unless its own side would become disconnected, empty or too small."""
    s = home & 1  # right-side tags are odd
    if balance.counts[s] < 2 or balance.measures[s] - measures[i] < balance.least:
        return False
    if not keeps_whole(edges.indptr, edges.indices, tag, np.int64(i), search, stamp):
        return False
    _put(measures, tag, i, target, balance)
    return True


@helper
def _put(measures, tag, i, other, balance):
    tag[i] = other
    to = other & 1
    balance.measures[to] += measures[i]
    balance.measures[1 - to] -= measures[i]
    balance.counts[to] += 1
    balance.counts[1 - to] -= 1


@helper
def _collect_movers(edges, centroids, tag, gains, visits, m, pairs, normal, keys, movers):
    """List the cells whose move shortens the interface, sorted along the normal, and return their number."""
    n_movers = 0
    for c in range(m):
        i = np.uint64(visits[c])
        gain, least = _gain(gains, i)
        pays = gain > least
        if not pays and pairs and gain > -np.inf:
            pays = _partner(edges, tag, i, np.int64(tag[i]), gain, least, gains) >= 0
        if pays:
            movers[n_movers], keys[n_movers] = i, 0.0
            for k in range(centroids.shape[1]):
                keys[n_movers] += normal[k] * centroids[i, k]
            n_movers += 1
    sort_by_keys(movers, keys, n_movers)
    return n_movers


@helper
def _note_move(edges, tag, left_tag, right_tag, i, listed, visits, filled, gains, sweep):
    """Update the interface sums of cell i and its neighbours after a move, and list these cells.

    Returns the new list lengths. ``listed`` contains all cells with sums, ``visits`` the cells to visit in
    the next sweep.
    """
    edge, m = filled
    before = np.int64(edges.indptr[i]) - 1
    for h in range(before, np.int64(edges.indptr[i + ONE])):
        j = np.uint64(np.uint32(edges.indices[h])) if h > before else i
        if tag[j] != left_tag and tag[j] != right_tag:
            continue
        # 1. List a new cell, and update its sums.
        if gains.marks[j, _LISTED] < gains.stamp:
            gains.marks[j, _LISTED] = gains.stamp + edge
            listed[edge] = j
            edge += 1
        _sum_up(edges, tag, j, left_tag, right_tag, gains.shared, gains.marks[j, _LISTED] - gains.stamp)
        # 2. Visit the cell in the next sweep.
        if gains.marks[j, _SEEN] != sweep:
            gains.marks[j, _SEEN] = sweep
            visits[m] = j
            m += 1
    return edge, m


@helper
def refine_sides(graph, pieces, left_tag, right_tag, sides, floor, edge, workspace, stamp):
    """Move cells between two sides while that shortens their interface (paper, "adjust partition").

    Sweeps run along the cut normal: single cells until none pays, pairs of neighbours once, and single cells
    again. Neither side becomes disconnected or empty, or falls below ``floor`` times the smaller side's
    measure at entry.

    Parameters
    ----------
    graph : PieceGraph
    pieces : Pieces, changed
    left_tag, right_tag : int
        Side tags.
    sides : Sides, changed
    floor : float
    edge : int
        Number of cells in the workspace boundary: the cells adjacent to the other side. At the end the
        boundary also lists all cells that were adjacent to the other side at any time, and their neighbours.
    workspace : Workspace, changed
    stamp : int
        A number larger than any in the marks.

    Returns
    -------
    The final number of cells in the boundary, and the next unused stamp.
    """
    boundary, movers, visits, queue, root, keys, shared = workspace
    tag, marks, measures = pieces.tag, pieces.marks, graph.measures
    edges = Edges(graph.indptr, graph.indices, graph.interface)
    least = floor * min(sides.measures[0], sides.measures[1])
    balance = Balance(sides.measures, sides.counts, least)
    search, gains = (queue, root, marks), Gains(shared, marks, stamp)
    listing, m = stamp, edge
    # 1. Interface of each cut cell with both sides.
    for c in range(edge):
        i = np.uint64(boundary[c])
        visits[c], marks[i, _LISTED] = i, listing + c
        _sum_up(edges, tag, i, left_tag, right_tag, shared, c)
    pairs, pairs_tried = False, False
    for _ in range(_SWEEPS):
        # 2. Cells worth moving, in order of position along the normal, so that numbering does not matter.
        moves = _collect_movers(
            edges, graph.centroids, tag, gains, visits, m, pairs, sides.normal, keys, movers
        )
        stamp += 1
        sweep, m = stamp, np.int64(0)
        for c in range(moves):
            i = np.uint64(movers[c])
            home = np.int64(tag[i])
            target = left_tag + right_tag - home
            # 3. Earlier moves in the sweep may have changed the gain. A cell that loses alone may gain in a
            #    pair.
            gain, least_gain = _gain(gains, i)
            partner = np.int64(-1)
            if gain <= least_gain:
                if pairs and gain > -np.inf:
                    partner = _partner(edges, tag, i, home, gain, least_gain, gains)
                if partner < 0:
                    continue
            # 4. Move the cell, and undo the move if its partner cannot follow.
            stamp += 1
            if not _leave(edges, measures, tag, i, home, target, balance, search, stamp):
                continue
            if partner >= 0:
                stamp += 1
                j = np.uint64(partner)
                if not _leave(edges, measures, tag, j, home, target, balance, search, stamp):
                    _put(measures, tag, i, home, balance)
                    continue
                edge, m = _note_move(
                    edges, tag, left_tag, right_tag, j, boundary, visits, (edge, m), gains, sweep
                )
            edge, m = _note_move(
                edges, tag, left_tag, right_tag, i, boundary, visits, (edge, m), gains, sweep
            )
        # 5. The next sweep visits the changed cells. If there are none, it tries pairs over all listed cells
        #    once.
        if pairs:
            pairs = False
        elif m == 0 and not pairs_tried:
            pairs, pairs_tried, m = True, True, edge
            for c in range(edge):
                visits[c] = boundary[c]
        if m == 0:
            break
    return edge, max(stamp, listing + edge) + 1
