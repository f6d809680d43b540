"""Geometry of blocks (independent sets of nodes): extents, sums, principal axes, weighted medians.

All blocks of a recursion depth are processed together. Sums use ``np.bincount`` and cumulated weights are
integers, so that the result for a block does not depend on other blocks, to the last bit.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.graph import Graph

TIE = 1e-7
"""Fraction of a block's extent below which differences count as zero; shifts by 1e6 diameters cause such
noise.
"""

# ratio of second moments above which fourth moments determine the axes: principal axes carry little shape
# information there (benchmarks/roads.py)
_ISOTROPIC = 0.9
_SHARE_BITS = 40  # bits of integer shares: the sum over 2**23 blocks fits into int64


def split_at_median(level: Graph, projection: Float, tie: Float, shares: Float | None = None) -> Int:
    """Bisect each block at the weighted median of ``projection``, or at another mass fraction.

    Projections closer than 1e-7 of their extent in the block count as equal; the ``tie`` columns, not the
    cell numbers, decide between them.

    Parameters
    ----------
    projection : (n,) float
    tie : (n, t) float
        Further coordinates, the most important first.
    shares : (B,) float, optional
        Share of each block's ``mass`` below the cut, instead of half the weight.

    Returns
    -------
    (n,) int64
        0 below the cut, 1 above; both occur in every block with at least two nodes.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.authoring import split_at_median
    >>> graph = samples.squares(2).graph
    >>> split_at_median(graph, graph.centroids[:, 0], graph.centroids)
    array([0, 1, 0, 1])
    """
    order = _order(level, projection, tie)
    # Integer weights below each node, in the order of the projection.
    amounts = integer_shares(level.weights if shares is None else level.mass, level.block_ids)[order]
    before = np.cumsum(amounts) - amounts
    starts = level.offsets[:-1]
    below = before - before[starts][level.block_ids]  # blocks keep their places in the order
    # A node is above if its midpoint lies above the cut; both sides stay non-empty.
    totals = np.bincount(level.block_ids, amounts, minlength=level.n_blocks)
    cut = totals if shares is None else np.floor(2.0 * shares * totals)
    upper = 2 * below + amounts > cut[level.block_ids]
    upper[level.offsets[1:] - 1] = True
    upper[starts] = False
    sides = np.empty(level.n, dtype=np.int64)
    sides[order] = upper
    return sides


def principal_frames(level: Graph) -> tuple[Float, Float]:
    """Compute principal axes of each block's weighted centroids, and the centroid coordinates in them.

    Axes with second moments within a factor 0.9 are rotated in their plane to the smallest fourth moments
    (along the sides of a square). Each axis points to its heavier tail (positive third moment), so that
    frames rotate with the mesh.

    Returns
    -------
    frames : (B, d, d) float
        Orthonormal rows, largest second moment first.
    coordinates : (n, d) float
        Relative to the block's centre of mass.

    Examples
    --------
    >>> from agglo_core.graph.blocks import principal_frames
    >>> frames, coordinates = principal_frames(agglo.samples.strip(4).graph)
    >>> np.abs(frames[0])
    array([[1., 0.],
           [0., 1.]])
    >>> np.abs(coordinates[:, 0])
    array([0.375, 0.125, 0.125, 0.375])
    """
    # Second moments about the centres of mass, and their eigenvectors.
    blocks = level.block_ids
    weights = block_shares(level.weights, blocks)
    centres = block_sums(level, weights[:, None] * level.centroids) / block_sums(level, weights[:, None])
    local = level.centroids - centres[blocks]
    moments = np.zeros((level.n_blocks, level.dim, level.dim))
    for i, j in combinations_with_replacement(
        range(level.dim), 2
    ):  # the lower triangles, all that eigh reads
        moments[:, j, i] = np.bincount(blocks, weights * local[:, j] * local[:, i], level.n_blocks)
    values, vectors = np.linalg.eigh(moments)
    values, frames = values[:, ::-1], np.swapaxes(vectors[:, :, ::-1], 1, 2)
    # Resolve nearly equal moments, then sort the axes and fix their signs.
    frames = _rotate_frames(level, weights, local, values, frames)
    coordinates = np.stack(
        [_coordinates_along(frames[:, k], blocks, local.T) for k in range(level.dim)], axis=1
    )
    seconds = block_sums(level, weights[:, None] * coordinates**2)
    order = np.argsort(-seconds, axis=1, kind="stable")
    signs = np.where(block_sums(level, weights[:, None] * coordinates**3) < 0, -1.0, 1.0)
    frames = np.take_along_axis(signs[:, :, None] * frames, order[:, :, None], axis=1)
    return frames, np.take_along_axis((signs[blocks] * coordinates), order[blocks], axis=1)


def block_extents(level: Graph, values: Float) -> Float:
    """Return the range (maximum minus minimum) per column ``(n, t)`` and block, ``(B, t)``.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.blocks import block_extents
    >>> level = samples.squares(4).graph.split([0] * 4 + [1] * 12)[0]
    >>> block_extents(level, level.centroids)
    array([[0.75, 0.  ],
           [0.75, 0.5 ]])
    """
    starts = level.offsets[:-1]
    high: Float = np.maximum.reduceat(values, starts, axis=0)
    return high - np.minimum.reduceat(values, starts, axis=0)


def _order(level: Graph, projection: Float, tie: Float) -> Int:
    """Sort each block's nodes by ``projection``, and equal nodes by the columns of ``tie``."""
    order = np.lexsort((projection, level.block_ids))
    blocks = level.block_ids
    differs = np.ones(level.n + 1, bool)  # True where a value differs from its predecessor
    extents = block_extents(level, projection[:, None])[:, 0]
    differs[1:-1] = (np.diff(projection[order]) > TIE * extents[blocks[1:]]) | (blocks[1:] != blocks[:-1])
    tied = np.flatnonzero(~(differs[:-1] & differs[1:]))
    if not len(tied) or not tie.shape[1]:
        return frozen_int(order)
    nodes, groups = order[tied], np.cumsum(differs[tied])
    widest = block_extents(level, tie).max(axis=1)[blocks[nodes]]
    ranks = [_ranks(values[nodes], groups, widest) for values in tie.T]
    order[tied] = nodes[np.lexsort((*ranks[::-1], groups))]
    return frozen_int(order)


def _ranks(values: Float, groups: Int, extents: Float) -> Int:
    """Return the rank of each value in its group.

    Values connected by a chain of tiny steps have equal ranks.
    """
    order = np.lexsort((values, groups))
    steps = np.diff(values[order]) > TIE * extents[1:]
    ranks = np.zeros(len(values), np.int64)
    ranks[order[1:]] = np.cumsum(steps)
    return ranks


def block_ranks(level: Graph, values: Float, extents: Float) -> Int:
    """Return the rank of each value in its block.

    Values connected by a chain of tiny steps have equal ranks.

    Examples
    --------
    >>> from agglo_core.graph.blocks import block_ranks
    >>> values = np.array([0.2, 0.1, 0.1 + 1e-9, 0.5])
    >>> block_ranks(agglo.samples.strip(4).graph, values, extents=np.array([0.4]))
    array([1, 0, 0, 2])
    """
    return _ranks(values, level.block_ids, extents[level.block_ids])


def block_sums(level: Graph, values: NDArray[np.float64]) -> Float:
    """Return the sum of ``values`` (n, …) over each block, (B, …).

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.graph.blocks import block_sums
    >>> level = samples.squares(4).graph.split([0] * 4 + [1] * 12)[0]
    >>> block_sums(level, level.measures)
    array([0.25, 0.75])
    """
    flat = values.reshape(level.n, -1)
    sums: Float = np.stack(
        [np.bincount(level.block_ids, c, minlength=level.n_blocks) for c in flat.T], axis=1
    )
    return sums.reshape(level.n_blocks, *values.shape[1:])


def block_shares(values: Float, blocks: Int) -> Float:
    """Return each value divided by the sum over its block ``(n,)``.

    If all values of a block are zero, the shares are equal.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.graph.blocks import block_shares
    >>> block_shares(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 1]))
    array([0.25, 0.75, 1.  ])
    """
    totals = np.bincount(blocks, values)[blocks]
    even = 1.0 / np.bincount(blocks)[blocks]
    shares: Float = np.divide(values, totals, out=even, where=totals > 0)
    return shares


def integer_shares(values: Float, blocks: Int) -> Int:
    """Return block shares as integers in units of 2**-40, so that all their sums are exact.

    Examples
    --------
    >>> from agglo_core.graph.blocks import integer_shares
    >>> integer_shares(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 1])) // 2**38
    array([1, 3, 4])
    """
    integers: Int = np.rint(block_shares(values, blocks) * 2.0**_SHARE_BITS).astype(np.int64)
    return integers


def _rotate_frames(level: Graph, weights: Float, local: Float, moments: Float, frames: Float) -> Float:
    """Rotate principal axes with nearly equal second moments to minimise the fourth moments.

    With z = x + iy, a rotation by θ gives x⁴ + y⁴ = (3|z|⁴ + Re z⁴ exp(−4iθ)) / 4, hence a closed formula for
    the angle per plane. In 3-D, sweeps over the three planes converge quadratically, like Jacobi rotations.
    """
    frames = frames.copy()
    planes = []
    for i, j in combinations(range(level.dim), 2):
        isotropic = moments[:, j] >= _ISOTROPIC * moments[:, i]
        nodes = np.flatnonzero(isotropic[level.block_ids])
        if len(nodes):
            columns = np.ascontiguousarray(local[nodes].T)
            planes.append((i, j, isotropic, level.block_ids[nodes], columns, weights[nodes]))
    for _ in range(1 if level.dim == 2 else 6):
        for i, j, isotropic, blocks, columns, mass in planes:
            x, y = (_coordinates_along(frames[:, k], blocks, columns) for k in (i, j))
            real, imaginary = x * x - y * y, 2.0 * (x * y)  # z²
            fourth = real * real - imaginary * imaginary, 2.0 * (real * imaginary)
            one, two = (np.bincount(blocks, mass * part, level.n_blocks) for part in fourth)
            angle = np.arctan2(-two, -one) / 4 * isotropic
            cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
            frames[:, i], frames[:, j] = (
                cos * frames[:, i] + sin * frames[:, j],
                cos * frames[:, j] - sin * frames[:, i],
            )
    return frames


def _coordinates_along(axes: Float, blocks: Int, columns: Float) -> Float:
    """Return each node's coordinate ``(n,)`` along its block axis ``(B, d)``, from ``columns (d, n)``."""
    coordinates: Float = axes[:, 0].take(blocks) * columns[0]
    for k in range(1, len(columns)):
        coordinates += axes[:, k].take(blocks) * columns[k]
    return coordinates
