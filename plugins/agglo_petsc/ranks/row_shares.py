"""One rank's share of a mesh and hierarchy known to all ranks: its rows, aggregates and patches.

Cells are renumbered, rank by rank, by the coarsest level's agglomerates, so that every agglomerate on
every level is on one rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agglo_core.authoring import Int, Patches, frozen_int
from agglo_petsc.levels.labels import nested_aggregates

_PARTS_PER_RANK = 4
"""Minimum number of parts per rank on a level: with fewer, shares of whole parts would be too unequal.
A larger value drops coarse levels earlier (benchmarks/petsc.py on four ranks)."""


@dataclass(frozen=True, eq=False)
class RowShare:
    """One rank's share of a mesh and hierarchy: cells, aggregates and patches.

    Attributes
    ----------
    cells : (own,) int
        Its cells, by their old numbers, in the new order.
    order : (n_cells,) int
        All cells in the new order, by their old numbers.
    aggregates : list of (own parts,) int
        For :func:`~agglo_petsc.levels.aggregates.aggregate_levels`.
    """

    cells: Int
    order: Int
    aggregates: list[Int]
    _numbers: list[Int]
    _owners: list[Int]
    _rank: int

    def patches(self, level: int, whole: Patches) -> Patches:
        """Return the patches of a level whose lowest part belongs to this rank."""
        parts = self._numbers[level][whole.parts]
        group = np.repeat(np.arange(len(whole)), np.diff(whole.offsets))
        least = np.full(len(whole), len(self._numbers[level]))
        np.minimum.at(least, group, parts)
        owner = np.empty(len(self._numbers[level]), np.int64)
        owner[self._numbers[level]] = self._owners[level]
        is_owned = owner[least] == self._rank
        sizes = np.diff(whole.offsets)[is_owned]
        offsets = np.concatenate(([0], np.cumsum(sizes)))
        return Patches(frozen_int(offsets), frozen_int(parts[is_owned[group]]))


def usable_levels(labels: Sequence[Int], ranks: int) -> list[Int]:
    """Return the finest level, and all others with enough parts for each rank."""
    if ranks == 1:
        return list(labels)
    return [each for k, each in enumerate(labels) if k == 0 or int(each.max()) + 1 >= _PARTS_PER_RANK * ranks]


def row_share(labels: Sequence[Int], n_cells: int, rank: int, ranks: int) -> RowShare:
    """Divide the cells between ranks along agglomerates, and return the share of ``rank``.

    Parameters
    ----------
    labels : sequence of (n_cells,) int
        Agglomerate of each cell, finest first, each nested in the next.
    n_cells : int
    rank, ranks : int

    Raises
    ------
    OptionError
        If levels are not nested.

    Examples
    --------
    >>> share = row_share([np.array([1, 1, 0, 0, 2, 2])], 6, rank=0, ranks=2)
    >>> share.cells.tolist(), [each.tolist() for each in share.aggregates]
    ([0, 1, 2, 3], [[1, 1, 0, 0]])
    """
    # 1. Owner of each part, from the coarsest level down
    ups = nested_aggregates(labels)
    top = labels[-1] if len(labels) else np.arange(n_cells)
    sizes = np.bincount(top)
    owner = np.minimum((np.cumsum(sizes) - 0.5 * sizes) * ranks // n_cells, ranks - 1).astype(np.int64)
    owners = [frozen_int(owner)]  # owners of the parts, from the coarsest level
    for parent_of in reversed(ups):
        owners.append(frozen_int(owners[-1][parent_of]))
    owners.reverse()
    # 2. Renumber the parts by owner
    orders = [np.argsort(values, kind="stable") for values in owners]
    numbers = [frozen_int(np.argsort(values)) for values in orders]
    # 3. Own parts and their aggregates
    own_parts = [order[owner[order] == rank] for order, owner in zip(orders, owners, strict=True)]
    aggregates = [frozen_int(numbers[k + 1][parent_of[own_parts[k]]]) for k, parent_of in enumerate(ups)]
    return RowShare(frozen_int(own_parts[0]), frozen_int(orders[0]), aggregates, numbers, owners, rank)
