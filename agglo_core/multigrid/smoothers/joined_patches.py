"""Patches that do not overlap: cells that strong couplings join, up to a number of cells each."""

from __future__ import annotations

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.patch_search import united
from agglo_core.problems import Patches


def joined_patches(pairs: Int, n_parts: int, *, most: int = 8) -> Patches:
    """Groups of parts, made by uniting pairs in their order as long as no group has more than ``most``.

    Given the pairs of strongly coupled parts, the strongest first, block Gauss–Seidel over the groups does
    what vertex patches do where the cells of a mesh are flat (lines through boundary layers, bundles of
    slivers), in little more time than Gauss–Seidel over single parts: each part is in one group.

    Parameters
    ----------
    pairs : (m, 2) int
    n_parts : int
    most : int

    Returns
    -------
    Patches
        Groups by their smallest parts, which ascend; a part in no pair is a group of its own.

    Raises
    ------
    OptionError
        If a pair holds a number below 0 or above ``n_parts`` − 1.

    Examples
    --------
    >>> import numpy as np
    >>> groups = joined_patches(np.array([[3, 4], [0, 1], [1, 3]]), 5, most=3)
    >>> [groups.parts[a:b].tolist() for a, b in zip(groups.offsets, groups.offsets[1:])]
    [[0, 1], [2], [3, 4]]
    """
    pairs = frozen_int(pairs)
    if pairs.size and (pairs.min() < 0 or pairs.max() >= n_parts):
        raise OptionError(f"pairs hold {pairs.min()} to {pairs.max()}; there are parts 0 to {n_parts - 1}")
    offsets, parts = united(pairs, n_parts, most)
    return Patches(frozen_int(offsets), frozen_int(parts))
