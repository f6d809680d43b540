"""Cut pieces of a mesh where the estimated number of parts is least, and count the parts of recursions."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numba
import numpy as np

from agglo_core.authoring import Float, Graph, Int, OptionError, Target, frozen_int
from value_of_cuts.features import LANES, describe, join, new_room, no_cells, setup_for


class Cells(NamedTuple):
    """Cells of a mesh: centroids, measures, and their vertices as ragged rows of points."""

    centroids: Float
    measures: Float
    offsets: Int
    vertices: Int
    points: Float


class Network(NamedTuple):
    """Weights of the layers inputs → 16 → 16 → 1 in single precision, with leaky rectifiers (0.05)."""

    w1: Float
    b1: Float
    w2: Float
    b2: Float
    w3: Float
    b3: Float


class Policy(NamedTuple):
    """Rule for the choice of a cut."""

    h_star: float
    learned: bool  # whether costs are estimates of the network; without it, minus the inertia between
    noise: float  # relative, on costs


def cells_of(graph: Graph) -> Cells:
    """Return the arrays of a mesh's graph."""
    arrays = graph.centroids, graph.measures, graph.vertex_offsets, graph.vertices, graph.points
    return Cells(*(np.ascontiguousarray(each, float if each.dtype.kind == "f" else int) for each in arrays))


@numba.njit(cache=True, fastmath=True)
def logarithm(network, inputs, hidden, last):
    """Evaluate the network: the log of the number of parts."""
    hidden[:] = network.b1
    for k in range(len(network.w1)):
        for i in range(16):
            hidden[i] += inputs[k] * network.w1[k, i]
    last[:] = network.b2
    for k in range(16):
        value = max(hidden[k], np.float32(0.05) * hidden[k])
        for i in range(16):
            last[i] += value * network.w2[k, i]
    total = network.b3[0]
    for i in range(16):
        total += max(last[i], np.float32(0.05) * last[i]) * network.w3[i]
    return total


@numba.njit(cache=True, fastmath=True)
def parts_of(sets, t, setup, network, room):
    """Estimate the number of parts that row ``t`` becomes."""
    if describe(sets, t, setup, room) <= setup.certain:
        return 1.0
    return max(1.0, math.exp(min(logarithm(network, room.inputs, room.hidden, room.last), 9.0)))


@numba.njit(cache=True, fastmath=True)
def project(cells, members, axes, h_star):
    """Return coordinates along the axes and sets of one cell for ``members``, relative to the first one."""
    n, dim, f = len(members), cells.centroids.shape[1], np.float32
    at, sets = np.zeros((n, LANES), f), no_cells(n)
    origin, step, along = cells.centroids[members[0]], np.zeros(3, f), np.zeros((3, LANES), f)
    for i in range(dim):
        along[i, : len(axes)] = axes[:, i]
    for k in range(n):
        # Sums: measure, first and second moments, count.
        c, row, second = members[k], sets.sums[k], 1 + dim
        row[0] = cells.measures[c] / h_star**dim
        for i in range(dim):
            step[i] = (cells.centroids[c, i] - origin[i]) / h_star
        for i in range(dim):
            row[1 + i] = row[0] * step[i]
            for j in range(i, dim):
                row[second] = row[1 + i] * step[j]
                second += 1
            for a in range(LANES):
                at[k, a] += step[i] * along[i, a]
        row[second] = 1.0
        # Extents of the vertices.
        for p in range(cells.offsets[c], cells.offsets[c + 1]):
            for i in range(dim):
                step[i] = (cells.points[cells.vertices[p], i] - origin[i]) / h_star
            for a in range(LANES):
                z = step[0] * along[0, a] + step[1] * along[1, a] + step[2] * along[2, a]
                sets.high[k, a], sets.low[k, a] = max(sets.high[k, a], z), min(sets.low[k, a], z)
    return at, sets


@numba.njit(cache=True, fastmath=True)
def in_principal_frame(axes, cells, members):
    """Return ``axes`` relative to the principal axes of the cells ``members``."""
    dim = cells.centroids.shape[1]
    total, mean, covariance = 0.0, np.zeros(dim), np.zeros((dim, dim))
    for c in members:
        total += cells.measures[c]
        mean += cells.measures[c] * cells.centroids[c]
    for c in members:
        for i in range(dim):
            for j in range(dim):
                x, y = cells.centroids[c, i] - mean[i] / total, cells.centroids[c, j] - mean[j] / total
                covariance[i, j] += cells.measures[c] * x * y
    return axes @ np.linalg.eigh(covariance)[1].T


@numba.njit(cache=True, fastmath=True)
def inertia_between(left, right, whole, dim):
    """Return the share of the inertia that lies between the centroids of both sides."""
    gaps, traces, second = np.float32(0.0), np.float32(1e-30), 1 + dim
    for i in range(dim):
        gaps += (left[1 + i] / left[0] - right[1 + i] / right[0]) ** 2
        traces += whole[second] - whole[1 + i] ** 2 / whole[0]
        second += dim - i
    return left[0] * right[0] / whole[0] * gaps / traces


@numba.njit(cache=True, fastmath=True)
def cut(cells, members, setup, policy, network, side):
    """Write the side 0 or 1 of each of the cells ``members``: the cut of least cost over axes and thresholds.

    The cost is the estimated number of parts of both sides, less a multiple of the inertia between them.
    """
    n, dim, bins, room = len(members), cells.centroids.shape[1], setup.bins, new_room()
    count = dim * (dim + 3) // 2 + 1
    at, own = project(cells, members, in_principal_frame(setup.axes, cells, members), policy.h_star)
    least, side[:] = 1e18, np.arange(n) >= (n + 1) // 2  # if no cut is possible
    for a in range(len(setup.axes)):
        # Step 1: join the cells of each bin along the axis.
        start, stop = at[:, a].min(), at[:, a].max()
        bin_of = ((at[:, a] - start) * (0.9999 * bins / (stop - start + 1e-9))).astype(np.int64)
        below, above = no_cells(bins), no_cells(bins)
        for k in range(n):
            join(below, bin_of[k], own, k)
        # Step 2: join each bin with those above.
        for t in range(bins - 1, -1, -1):
            join(above, t, below, t)
            if t < bins - 1:
                join(above, t, above, t + 1)
        # Step 3: join each bin with those below, and compute the cost of the cut above it.
        for t in range(bins - 1):
            left, right, empty = below.sums[t], above.sums[t + 1], below.sums[t, count] == 0
            if t > 0:
                join(below, t, below, t - 1)
            if empty or right[count] == 0:
                continue
            if n >= 12 and min(left[0], right[0]) < setup.share * above.sums[0, 0]:
                continue
            cost = -inertia_between(left, right, above.sums[0], dim)
            if policy.learned:
                cost = setup.inertia * cost + parts_of(below, t, setup, network, room)
                if cost + 1.0 >= least and policy.noise == 0.0:
                    continue
                cost += parts_of(above, t + 1, setup, network, room)
            if policy.noise > 0.0:
                uniform = np.random.random()  # noqa: NPY002
                cost += policy.noise * abs(cost) * math.log(1e-12 - math.log(1e-12 + uniform))
            # Step 4: keep the cheapest cut.
            if cost < least:
                least, side[:] = cost, bin_of > t


@numba.njit(cache=True)
def fits(cells, members, h_star):
    """Return whether the diameter of the cells ``members`` is at most h*."""
    for c in members:
        for p in cells.vertices[cells.offsets[c] : cells.offsets[c + 1]]:
            for d in members:
                for q in cells.vertices[cells.offsets[d] : cells.offsets[d + 1]]:
                    square = 0.0
                    for i in range(cells.points.shape[1]):
                        square += (cells.points[p, i] - cells.points[q, i]) ** 2
                    if square > h_star**2 * (1.0 + 1e-9):
                        return False
    return True


@numba.njit(cache=True)
def recursion(cells, setup, frame, policy, network, seed):
    """Cut all pieces until they fit into h*.

    Returns the inputs of the network for each piece in the orthogonal ``frame``, its largest width, and the
    number of parts that it became. The first piece is the whole mesh. ``seed`` is that of the noise.
    """
    np.random.seed(seed)  # noqa: NPY002
    n, room, axes = len(cells.measures), new_room(), setup.axes @ frame
    inputs, widths = np.zeros((2 * n, 20), np.float32), np.zeros(2 * n, np.float32)
    parts, parent = np.zeros(2 * n, np.int64), np.full(2 * n, -1)
    order, side, pieces = np.arange(n), np.zeros(n, np.int64), 0
    stack = [(0, n, -1)]  # pieces: first and last cell in ``order``, and the piece that they were cut from
    while len(stack) > 0:
        start, stop, above = stack.pop()
        members, piece = order[start:stop].copy(), pieces
        parent[piece], pieces = above, pieces + 1
        # Describe the piece.
        own, whole = project(cells, members, axes, policy.h_star)[1], no_cells(1)
        for k in range(stop - start):
            join(whole, 0, own, k)
        widths[piece] = describe(whole, 0, setup, room)
        inputs[piece] = room.inputs
        # Count a part that fits in all pieces that it was cut from.
        if stop - start == 1 or (widths[piece] <= 1.0 and fits(cells, members, policy.h_star)):
            while piece >= 0:
                parts[piece] += 1
                piece = parent[piece]
            continue
        # Cut the piece and continue with both sides.
        half = side[start:stop]
        cut(cells, members, setup, policy, network, half)
        middle = start + np.sum(half == 0)
        order[start:middle], order[middle:stop] = members[half == 0], members[half == 1]
        stack.append((start, middle, piece))
        stack.append((middle, stop, piece))
    return inputs[:pieces], widths[:pieces], parts[:pieces]


@numba.njit(cache=True)
def cut_blocks(cells, offsets, setup, policy, network, side):
    """Cut each block of a level."""
    for b in range(len(offsets) - 1):
        if offsets[b + 1] - offsets[b] > 1:
            members = np.arange(offsets[b], offsets[b + 1])
            cut(cells, members, setup, policy, network, side[offsets[b] : offsets[b + 1]])


@dataclass(frozen=True)
class ValueBisector:
    """Bisector for runs by size: cuts where the estimated number of parts is least.

    ``seconds`` collects the CPU times of the calls.
    """

    network: Network
    h_star: float | None = None
    seconds: list[float] = field(default_factory=list)
    needs_points: ClassVar[bool] = True

    def for_target(self, target: Target) -> ValueBisector:
        """Return the bisector for the size of the target."""
        return replace(self, h_star=target.h_star)

    def bisect_level(self, level: Graph, seeds: Any) -> Int:
        """Return the side of each cell."""
        if self.h_star is None:
            raise OptionError("the value function is for a size: expected a target h_star, given none")
        start, side = time.process_time(), np.zeros(level.n, np.int64)
        own, offsets = setup_for(level.centroids.shape[1]), np.asarray(level.offsets, np.int64)
        cut_blocks(cells_of(level), offsets, own, Policy(self.h_star, True, 0.0), self.network, side)
        self.seconds.append(time.process_time() - start)
        return frozen_int(side)
