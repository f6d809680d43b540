"""Spectral bisection: cut each block along its Fiedler vector, at the lowest normalised cut.

Sources: Fiedler, "A property of eigenvectors of nonnegative symmetric matrices" (1975); Shi and Malik,
"Normalized cuts and image segmentation" (2000) for the sweep over the sorted mode.
"""

from __future__ import annotations

from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agglo_core.authoring import Float, Graph, Int, OptionError, UInt64, split_at_median
from agglo_core.graph.blocks import (
    block_extents,
    block_ranks,
    block_shares,
    block_sums,
    integer_shares,
    principal_frames,
)
from agglo_spectral.modes import laplacian_modes

Flags = NDArray[np.bool_]

_TIE = 1e-9  # relative difference of normalised cuts that counts as a tie


class Spectral:
    """Bisect each block along the Fiedler vector of its graph Laplacian.

    If the lowest eigenvalues (nearly) agree, as on squares, the mode is arbitrary: directions spread from
    the block axes, eight in 2-D, are tried and the lowest normalised cut is kept.

    Parameters
    ----------
    split : {"ncut", "median"}
        Cut the sorted mode at the lowest normalised cut (interface over weight), or at the weighted median.
    weighted : bool
        Weigh edges by interface over distance and nodes by their weight; otherwise all weights are 1.
    balance : float in [0, 0.5]
        ``ncut`` leaves each side at least this fraction of the weight, if possible.
    degeneracy : float
        Eigenvalues within this relative distance from the lowest span the trial modes.
    dense_limit : int
        Blocks with at most this many nodes are solved densely, in batches.

    Raises
    ------
    OptionError
        If an option is outside these ranges.
    """

    def __init__(
        self,
        split: Literal["ncut", "median"] = "ncut",
        weighted: bool = True,
        balance: float = 0.25,
        degeneracy: float = 1.0,
        dense_limit: int = 64,
    ) -> None:
        if split not in ("ncut", "median"):
            raise OptionError(f"spectral: split must be 'ncut' or 'median', not {split!r}")
        if not 0 <= balance <= 0.5:
            raise OptionError(f"spectral: balance must lie in [0, 0.5], not {balance!r}")
        if not degeneracy >= 0:
            raise OptionError(f"spectral: degeneracy must not be negative, given {degeneracy!r}")
        if dense_limit < 16:
            raise OptionError(f"spectral: dense_limit must be at least 16, not {dense_limit!r}")
        self.split, self.weighted, self.balance = split, weighted, balance
        self.degeneracy, self.dense_limit = degeneracy, dense_limit

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Bisect each block, and return each node's side ``(n,)``, 0 or 1.

        Both sides occur in every block with at least two nodes. ``seeds`` are ignored.
        """
        return self.bisect_shares(level, seeds, None)

    def bisect_shares(self, level: Graph, seeds: UInt64, shares: Float | None) -> Int:
        """Bisect each block along its Fiedler vector, with the mass fraction ``shares (B,)`` on side 0."""
        # 1. Cut along the lowest mode
        values, modes = laplacian_modes(level, level.dim, self.weighted, self.dense_limit)
        coordinates = principal_frames(level)[1]
        near = np.isfinite(values) & (values <= (1 + self.degeneracy) * values[:, :1])
        sides, _ = self._cut(level, modes[:, 0], coordinates, shares)
        # 2. Blocks with several near-lowest modes: try directions in their span
        choice = near.sum(axis=1) > 1
        if choice.any():
            nodes = choice[level.block_ids]
            part, frame = level.take(np.flatnonzero(choice)), coordinates[nodes]
            basis = _align_basis(part, modes[nodes], near[choice], frame)
            part_shares = None if shares is None else shares[choice]
            sides[nodes] = self._best(part, basis, frame, sides[nodes], part_shares)
        return sides

    def _best(self, level: Graph, basis: Float, coordinates: Float, sides: Int, shares: Float | None) -> Int:
        """Return the sides by the mode in the span of ``basis`` with the lowest normalised cut.

        The given ``sides`` remain if no cut leaves weight on both.
        """
        best = np.full(level.n_blocks, np.inf)
        for direction in _directions(level.dim):
            trial, score = self._cut(level, (basis * direction).sum(axis=1), coordinates, shares)
            better = score < best * (1 - _TIE)
            best = np.where(better, score, best)
            sides = np.where(better[level.block_ids], trial, sides)
        return sides

    def _cut(self, level: Graph, mode: Float, coordinates: Float, shares: Float | None) -> tuple[Int, Float]:
        """Cut each block along one mode: sides ``(n,)`` and normalised cuts ``(B,)``."""
        # 1. Orient the mode by its third moment
        thirds = block_sums(level, (block_shares(level.weights, level.block_ids) * mode**3)[:, None])[:, 0]
        mode = np.where(thirds < 0, -1.0, 1.0)[level.block_ids] * mode
        # 2. Cut
        if self.split == "median" or shares is not None:
            sides = split_at_median(level, mode, coordinates, shares)
        else:
            sides, found = _sweep(level, mode, self.balance)
            if not found.all():  # one node outweighs the rest, or all values are equal
                sides = np.where(found[level.block_ids], sides, split_at_median(level, mode, coordinates))
        return sides, _normalised_cut(level, sides)


def _sweep(level: Graph, mode: Float, balance: float) -> tuple[Int, Flags]:
    """Cut each block between two mode values at the lowest normalised cut: sides ``(n,)``, success mask."""
    # 1. Sort the nodes of each block by mode
    blocks, starts, ends = level.block_ids, level.offsets[:-1], level.offsets[1:] - 1
    ranks = block_ranks(level, mode, block_extents(level, mode[:, None])[:, 0])
    order = np.lexsort((ranks, blocks))
    places = np.empty(level.n, dtype=np.int64)
    places[order] = np.arange(level.n)
    # 2. Weight below and interface crossing each place
    below = _running_sums(level, integer_shares(level.weights, blocks)[order])
    share = below / below[ends][blocks]
    crossing = _running_sums(level, _changes(level, places))
    # 3. Lowest cut between different values, within the balance
    last = np.append(ranks[order][1:] > ranks[order][:-1], False)
    allowed = last & (share >= balance - _TIE) & (share <= 1 - balance + _TIE)
    allowed[ends] = False
    scores = np.where(allowed, crossing / np.where(allowed, share * (1 - share), 1.0), np.inf)
    lowest = np.minimum.reduceat(scores, starts)
    good = np.flatnonzero(scores <= (lowest * (1 + _TIE))[blocks])
    cut = good[np.searchsorted(good, starts)]
    return (places > cut[blocks]).astype(np.int64), np.isfinite(lowest)


def _running_sums(level: Graph, values: Int) -> Int:
    """Return exact cumulative sums that restart in each block."""
    sums = np.cumsum(values)
    before = np.concatenate(([0], sums[level.offsets[1:-1] - 1]))
    return np.asarray(sums - before[level.block_ids])


def _changes(level: Graph, places: Int) -> Int:
    """Return the change of the interface when each node, in sorted order, joins the lower side."""
    owners = np.repeat(np.arange(level.n), np.diff(level.indptr))
    lengths = integer_shares(level.interface, level.block_ids[owners])
    signs = np.where(places[owners] < places[level.indices], 1, -1)
    changes = np.bincount(places[owners], signs * lengths, minlength=level.n)
    return changes.astype(np.int64)  # exact: bincount adds integers below 2**53


def _normalised_cut(level: Graph, sides: Int) -> Float:
    """Return the normalised cut ``(B,)``: interface times total weight over product of side weights."""
    owners = np.repeat(np.arange(level.n), np.diff(level.indptr))
    crossing = np.where(sides[owners] != sides[level.indices], level.interface, 0.0)
    cut = np.bincount(level.block_ids[owners], crossing, minlength=level.n_blocks) / 2
    share = block_sums(level, (block_shares(level.weights, level.block_ids) * sides)[:, None])[:, 0]
    spread = share * (1 - share)
    values: Float = np.divide(cut, spread, out=np.full(level.n_blocks, np.inf), where=spread > 0)
    return values


def _align_basis(level: Graph, modes: Float, near: Flags, coordinates: Float) -> Float:
    """Rotate the lowest modes to the orthonormal basis ``(n, d)`` closest to the linear functions.

    It is the orthogonal factor of the coordinate projections on the modes (Procrustes), independent of the
    numbering and the eigenvalue solver's basis.
    """
    modes = np.where(near[level.block_ids], modes, 0.0)
    masses = block_shares(level.weights, level.block_ids)[:, None, None]
    projections = block_sums(level, masses * modes[:, :, None] * coordinates[:, None, :])
    left, _, right = np.linalg.svd(projections)
    rank = np.arange(level.dim) < near.sum(axis=1)[:, None]
    rotation = (left * rank[:, None, :]) @ right
    return np.asarray((modes[:, :, None] * rotation[level.block_ids]).sum(axis=1))


def _directions(dim: int) -> Float:
    """Return trial directions, axes first: 8 in 2-D, in 3-D the 13 axes and diagonals of the cube."""
    if dim == 2:
        angles = np.pi * np.array([0, 4, 2, 6, 1, 3, 5, 7]) / 8
        return np.stack((np.cos(angles), np.sin(angles)), axis=1)
    halves = [step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]
    return np.array(sorted(halves, key=np.count_nonzero), dtype=float)
