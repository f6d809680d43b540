"""Describe a set of cells by measure, widths and inertia, equal for all symmetries of the axes."""

from __future__ import annotations

import math
from functools import cache
from itertools import permutations, product
from typing import Final, NamedTuple

import numba
import numpy as np

from agglo_core.authoring import Float, Int

LANES: Final = 16  # length of the rows of widths and moments, constant for vector instructions
FAR: Final = np.float32(1e9)


class Setup(NamedTuple):
    """Constants of a dimension."""

    axes: Float  # (n_axes, dim) unit vectors, along which widths are measured and cuts are made
    symmetries: Int  # (n, n_axes) permutations of the axes by rotations and reflections
    bins: int  # intervals along an axis; cuts are between two of them
    certain: float  # a set of this largest width over h* has a diameter of at most h*
    inertia: float  # weight of the share of inertia between the sides, against parts
    share: float  # least share of the measure on a side, for pieces of 12 cells and more


class Sets(NamedTuple):
    """Sets of cells by rows, in units of h*."""

    sums: Float  # measure, first moments, second moments (rows of the upper triangle), number of cells
    high: Float  # extents along the axes
    low: Float


class Room(NamedTuple):
    """Workspace of one evaluation."""

    widths: Float
    inputs: Float
    covariance: Float
    hidden: Float
    last: Float


@cache
def setup_for(dim: int) -> Setup:
    """Return eight axes in 2-D, or edges, space diagonals and face diagonals of a cube in 3-D."""
    if dim == 2:
        angles = np.arange(8) * np.pi / 8
        axes = np.column_stack([np.cos(angles), np.sin(angles)])
        moves = [np.array([[x, -y * sign], [y, x * sign]]) for x, y in axes for sign in (1, -1)]
    else:
        signs = np.array(list(product((1, -1), repeat=3)), float)
        faces = [[0, 1, 1], [0, 1, -1], [1, 0, 1], [1, 0, -1], [1, 1, 0], [1, -1, 0]]
        axes = np.array([*np.eye(3), *signs[:4], *faces])
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        moves = [np.eye(3)[list(p)] * sign for p in permutations(range(3)) for sign in signs[:4]]
    symmetries = np.array([np.abs(axes @ move @ axes.T).argmax(axis=0) for move in moves])
    constants = (24, math.cos(np.pi / 16), 0.15, 0.1) if dim == 2 else (16, 0.86, 2.0, 0.2)
    return Setup(axes, symmetries, *constants)


@numba.njit(cache=True)
def new_room():
    """Return workspace for :func:`describe` and the network."""
    f = np.float32
    return Room(np.zeros(LANES, f), np.zeros(20, f), np.zeros((3, 3), f), np.zeros(16, f), np.zeros(16, f))


@numba.njit(cache=True)
def no_cells(n):
    """Return ``n`` sets without cells."""
    shape = n, LANES
    return Sets(np.zeros(shape, np.float32), np.full(shape, -FAR), np.full(shape, FAR))


@numba.njit(cache=True, fastmath=True)
def join(sets, t, more, k):
    """Add the cells of row ``k`` of ``more`` to row ``t``."""
    for a in range(LANES):
        sets.sums[t, a] += more.sums[k, a]
    for a in range(LANES):
        sets.high[t, a] = max(sets.high[t, a], more.high[k, a])
        sets.low[t, a] = min(sets.low[t, a], more.low[k, a])


@numba.njit(cache=True, fastmath=True)
def describe(sets, t, setup, room):
    """Write the inputs of the network for row ``t``, and return its largest width.

    The inputs are the log of the measure, the widths, the size of the cells, and roots of sums of principal
    minors of the covariance.
    """
    n_axes, dim = setup.axes.shape
    sums, widths, inputs, covariance = sets.sums[t], room.widths, room.inputs, room.covariance
    measure = sums[0]
    for a in range(LANES):
        widths[a] = sets.high[t, a] - sets.low[t, a]
    # Choose the order of axes whose widths are lexicographically largest.
    best, largest = 0, np.float32(0.0)
    for s in range(1, len(setup.symmetries)):
        for a in range(n_axes):
            gap = widths[setup.symmetries[s, a]] - widths[setup.symmetries[best, a]]
            if gap > 0:
                best = s
            if gap != 0:
                break
    for a in range(n_axes):
        inputs[1 + a] = widths[setup.symmetries[best, a]]
        largest = max(largest, widths[a])
    # Compute the covariance from the moments.
    second = 1 + dim
    for i in range(dim):
        for j in range(i, dim):
            covariance[i, j] = sums[second] / measure - sums[1 + i] * sums[1 + j] / measure**2
            second += 1
    # Sum its principal minors of orders 1, 2 and 3.
    trace, minors = covariance[0, 0], np.float32(0.0)
    for j in range(1, dim):
        trace += covariance[j, j]
        for i in range(j):
            minors += covariance[i, i] * covariance[j, j] - covariance[i, j] ** 2
    inputs[0] = math.log(measure)
    inputs[1 + n_axes] = (measure / sums[second]) ** (1 / dim)
    inputs[2 + n_axes] = math.sqrt(max(trace, 0.0))
    inputs[3 + n_axes] = math.sqrt(math.sqrt(max(minors, 0.0)))
    if dim == 3:
        xx, xy, xz = covariance[0, 0], covariance[0, 1], covariance[0, 2]
        yy, yz, zz = covariance[1, 1], covariance[1, 2], covariance[2, 2]
        determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        inputs[4 + n_axes] = max(determinant, 0.0) ** (1 / 6)
    return largest
