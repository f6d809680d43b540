"""Compiled inputs of the 2-D network: principal frame, moments and cell raster of a piece."""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from agglo_core.authoring import helper, kernel
from agglo_core.compiled.frames import centre_block, largest_block, planar_frame

# The network is trained on rasters with these numbers: others require new training (benchmarks/gnn.py
# bisection quality).
_CELLS_PER_BIN = 20  # on average; fewer cells per bin give more, and more ragged, bins
_FEWEST, _MOST = 9, 160  # target range for occupied bins: more take network time (benchmarks/gnn.py)
_MOST_BINS = 1024  # workspace size in bins, including empty bins: long or branched pieces get wider bins
_TIE = 1e-6  # bin widths: closer values count as inside


@helper(reorder_sums=True)
def _moments(n, u, v, shares, moments):
    """Compute the moments with orders 2, 3 and 4: (20 11 02), (30 21 12 03), (40 31 22 13 04).

    The first index refers to u.
    """
    a, b, c, d, e, f, g, h, k, p, q, r = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        uu, uv, vv, w = u[i] * u[i], u[i] * v[i], v[i] * v[i], shares[i]
        a += w * uu
        b += w * uv
        c += w * vv
        d += w * uu * u[i]
        e += w * uu * v[i]
        f += w * vv * u[i]
        g += w * vv * v[i]
        h += w * uu * uu
        k += w * uu * uv
        p += w * uu * vv
        q += w * uv * vv
        r += w * vv * vv
    moments[0], moments[1], moments[2], moments[3], moments[4], moments[5] = a, b, c, d, e, f
    moments[6], moments[7], moments[8], moments[9], moments[10], moments[11] = g, h, k, p, q, r


@helper
def to_frame(n, local, shares, inertia, uv, features):
    """Write coordinates and moments of a piece in its principal frame, and return the frame's rows.

    The frame consists of principal axes, the longer first, each pointing to its heavier tail, scaled so
    that a square becomes [−1, 1]². ``uv (2, m)`` receives the coordinates, ``features (13,)`` the moments
    of :func:`_moments` and 3 / √n; ``inertia`` is taken about the centre of mass, per weight.
    """
    # 1. The principal axis. The inertia of [−1, 1]² is 2/3.
    cos, sin, _, _, _ = planar_frame(n, local[0], local[1], shares)
    size = np.sqrt(2.0 / 3.0 / inertia)
    cos, sin = cos * size, sin * size
    for i in range(n):
        uv[0, i] = cos * local[0, i] + sin * local[1, i]
        uv[1, i] = cos * local[1, i] - sin * local[0, i]
    # 2. Choose the longer axis, and the signs of the third moments ⟨u³⟩, ⟨v³⟩: the frame may be a
    # reflection.
    _moments(n, uv[0], uv[1], shares, features)
    swap = features[2] > features[0] * (1.0 + 1e-9)
    ux, uy, vx, vy = cos, sin, -sin, cos
    thirds = features[3], features[6]
    if swap:
        ux, uy, vx, vy = vx, vy, ux, uy
        thirds = features[6], features[3]
    if thirds[0] < 0.0:
        ux, uy = -ux, -uy
    if thirds[1] < 0.0:
        vx, vy = -vx, -vy
    # 3. Coordinates and moments in the final frame, and the piece size in cells.
    for i in range(n):
        uv[0, i] = ux * local[0, i] + uy * local[1, i]
        uv[1, i] = vx * local[0, i] + vy * local[1, i]
    _moments(n, uv[0], uv[1], shares, features)
    features[12] = 3.0 / np.sqrt(n)
    return ux, uy, vx, vy


@helper
def _bin_of(value, rate, half):
    """Return the bin index of a value, with ``half`` for 0 and symmetric bins about it."""
    steps = int(abs(value) * rate + 0.5 - _TIE)
    return half + (steps if value > 0.0 else -steps)


@helper
def fill_raster(n, uv, shares, grid, place, nodes, near, areas):
    """Bin the cells of a piece symmetrically about its centre, and return the number of occupied bins.

    Fills ``nodes (:, 4)`` for each bin: position u, v, area over the mean − 1 (at most 3), fraction of its
    four sides without neighbour; ``near (:, 4)``: the neighbours, −1 for none; ``areas``: shares.
    """
    # 1. Bin width: a square with area 4 gets the target number of bins. In long or branched pieces many
    # bins are empty, and wider bins keep them within the workspace.
    reach_u, reach_v = 0.0, 0.0
    for i in range(n):
        reach_u, reach_v = max(reach_u, abs(uv[0, i])), max(reach_v, abs(uv[1, i]))
    rate = 0.5 * np.sqrt(min(max(n / _CELLS_PER_BIN, _FEWEST), _MOST))
    while (2.0 * reach_u * rate + 2.0) * (2.0 * reach_v * rate + 2.0) > _MOST_BINS:
        rate *= 0.9
    half_u, half_v = int(reach_u * rate + 0.5), int(reach_v * rate + 0.5)
    wide, high = 2 * half_u + 1, 2 * half_v + 1
    # 2. Share and first moments of each bin.
    for g in range(wide * high):
        grid[g, 0] = 0.0
        grid[g, 1] = 0.0
        grid[g, 2] = 0.0
    for i in range(n):
        g = _bin_of(uv[0, i], rate, half_u) * high + _bin_of(uv[1, i], rate, half_v)
        grid[g, 0] += shares[i]
        grid[g, 1] += shares[i] * uv[0, i]
        grid[g, 2] += shares[i] * uv[1, i]
    # 3. Number the occupied bins; their positions are the centres of mass of their cells.
    count = 0
    for g in range(wide * high):
        place[g] = -1
        if grid[g, 0] > 0.0:
            place[g] = count
            areas[count] = grid[g, 0]
            nodes[count, 0], nodes[count, 1] = grid[g, 1] / grid[g, 0], grid[g, 2] / grid[g, 0]
            count += 1
    # 4. Neighbours on four sides, and the features that depend on the number of bins or neighbours.
    for g in range(wide * high):
        a = place[g]
        if a < 0:
            continue
        row, column = g // high, g % high
        near[a, 0] = place[g - high] if row > 0 else -1
        near[a, 1] = place[g + high] if row < wide - 1 else -1
        near[a, 2] = place[g - 1] if column > 0 else -1
        near[a, 3] = place[g + 1] if column < high - 1 else -1
        missing = 0
        for k in range(4):
            missing += near[a, k] < 0
        nodes[a, 2] = min(areas[a] * count - 1.0, 3.0)
        nodes[a, 3] = 0.25 * missing
    return count


class Raster(NamedTuple):
    """Occupied bins of a piece, and the piece features ``(13,)``.

    For each bin ``nodes`` are the features, ``near`` the neighbours and ``areas`` the shares. ``grid`` and
    ``place`` are workspace for all bins.
    """

    grid: Any
    place: Any
    nodes: Any
    near: Any
    areas: Any
    features: Any


@helper(allocates=True)
def new_raster(largest):
    """Allocate the raster for one piece at a time."""
    bins = min(_MOST_BINS, largest)
    return Raster(
        np.empty((_MOST_BINS, 3)),
        np.empty(_MOST_BINS, np.int32),
        np.empty((bins, 4)),
        np.empty((bins, 4), np.int32),
        np.empty(bins),
        np.empty(13),
    )


@kernel
def describe(offsets, centroids, weights, measures):
    """Compute the network inputs for each block in a 2-D graph.

    Returns the offsets of the raster bins ``(B + 1,)``, their features ``(N, 4)``, neighbours ``(N, 4)``
    (numbered within the block, −1 for none) and shares ``(N,)``, the block features ``(B, 13)``, and the
    cells in their frames ``(n, 2)`` with their shares ``(n,)``.
    """
    largest, total = largest_block(offsets), len(weights)
    local, uv, shares = np.empty((3, largest)), np.empty((2, largest)), np.empty(largest)
    grid, place, nodes, near, areas, features = new_raster(largest)
    node_offsets = np.zeros(len(offsets), np.int64)
    all_nodes, all_near, all_areas = np.empty((total, 4)), np.empty((total, 4), np.int32), np.empty(total)
    all_features = np.empty((len(offsets) - 1, 13))
    cells, cell_shares = np.empty((total, 2)), np.empty(total)
    for b in range(len(offsets) - 1):
        start, n, at = offsets[b], offsets[b + 1] - offsets[b], node_offsets[b]
        # Frame and raster of each block, appended to the earlier blocks.
        _, inertia, _ = centre_block(start, n, centroids, weights, measures, local, shares)
        to_frame(n, local, shares, inertia, uv, features)
        count = fill_raster(n, uv, shares, grid, place, nodes, near, areas)
        node_offsets[b + 1] = at + count
        for i in range(count):
            all_areas[at + i] = areas[i]
            for k in range(4):
                all_nodes[at + i, k], all_near[at + i, k] = nodes[i, k], near[i, k]
        for k in range(len(features)):
            all_features[b, k] = features[k]
        for i in range(n):
            cells[start + i, 0], cells[start + i, 1] = uv[0, i], uv[1, i]
            cell_shares[start + i] = shares[i]
    used = node_offsets[-1]
    return node_offsets, all_nodes[:used], all_near[:used], all_areas[:used], all_features, cells, cell_shares
