"""Cheapest cuts of a planar piece across given directions, near its mean."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import helper, scan_thresholds

__all__ = ["band_room", "band_sweep", "write_all_rows"]

_TIE = 1e-6  # of a bin: values that close to its end lie inside
_BAND = 0.45  # standard deviations either side of the mean in which a cut is sought
_BINS = 32


@helper(allocates=True)
def band_room(m, edges):
    """Work arrays for pieces of at most m cells: cells in the band, where their rows start and end; rows."""
    heads, lengths = np.empty(2 * edges, np.int32), np.empty(2 * edges)
    return np.empty(m, np.int32), np.empty(m, np.int32), np.empty(m, np.int32), heads, lengths


@helper
def _write_rows(graph, cells, lo, tag, marks, m, room):
    """Write neighbours within the piece, by their numbers, and interfaces of the m cells that are listed."""
    indptr, indices, interface = graph[0], graph[1], graph[2]
    listed, starts, stops, heads, lengths = room
    own, count = tag[cells[lo]], 0
    for c in range(m):
        k = listed[c]
        starts[k], i = count, cells[lo + k]
        for h in range(indptr[i], indptr[i + 1]):
            j = indices[h]
            heads[count], lengths[count] = marks[j, 1], interface[h]
            count += tag[j] == own  # no branch: it would be mispredicted
        stops[k] = count


@helper(reorder_sums=True)
def _fill_bins(n, x, y, p, q, low, rate, shares, bins):
    """Bins of the score p x + q y, −1 below the band and 32 above; share and moments of what is below."""
    area, sx, sy = 0.0, 0.0, 0.0
    for i in range(n):
        place = min(max((p * x[i] + q * y[i] - low) * rate - _TIE, -1.0), float(_BINS))
        below = shares[i] if place < 0.0 else 0.0
        bins[i] = np.int32(np.floor(place))
        area += below
        sx += below * x[i]
        sy += below * y[i]
    return area, sx, sy


@helper
def _list_band(n, bins, listed):
    m = 0
    for i in range(n):
        listed[m] = i
        m += np.uint32(bins[i]) < _BINS
    return m


@helper
def write_all_rows(graph, cells, lo, hi, tag, marks, room):
    """Write the rows of all cells of a piece, for any number of sweeps."""
    for k in range(hi - lo):
        room[0][k] = k
    _write_rows(graph, cells, lo, tag, marks, hi - lo, room)


@helper
def band_sweep(graph, cells, lo, hi, tag, marks, points, p, q, spread, written, room, bins, tally):
    """Cheapest threshold of p x + q y near its mean, as ``sweep_block`` does; only edges there count.

    The cells of the piece are tagged as on the left and numbered in the second column of the marks; the
    rows of all may be ``written`` already. Returns the cost, the last bin below, the lowest threshold and
    thresholds per unit.
    """
    local, shares, (scale, inertia, weight) = points
    n, low = hi - lo, -_BAND * spread
    rate = -0.5 * _BINS / low if low < 0.0 else 0.0
    area, sx, sy = _fill_bins(n, local[0], local[1], p, q, low, rate, shares, bins)
    m, cut = _list_band(n, bins, room[0]), 0.0
    if not written:
        _write_rows(graph, cells, lo, tag, marks, m, room)
    listed, starts, stops, heads, lengths = room
    for c in range(m):
        k, rise = listed[c], 0.0
        own = bins[k]
        for h in range(starts[k], stops[k]):
            other = bins[heads[h]]
            rise += lengths[h] * (np.int64(other > own) - np.int64(other < own))
            cut += lengths[h] * np.int64(other < 0)
        tally[own, 0] += shares[k] * local[0, k]
        tally[own, 1] += shares[k] * local[1, k]
        tally[own, 3] += shares[k]
        tally[own, 4] += rise
    best, last = scan_thresholds(tally, sx, sy, 0.0, area, cut, scale, inertia, weight)
    return best, last, low, rate
