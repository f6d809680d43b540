"""Meetings: rows of many ranks that belong together come together on one rank, and answers go back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.errors import MeshError


class Meeting:
    """Rows that ranks have sent to this one.

    Parameters
    ----------
    ranks : Ranks
    to : (n,) int
        Rank that each row of this one goes to.
    *columns : (n, …) arrays
        What is sent, row by row.

    Attributes
    ----------
    columns : list of (m, …) arrays
        The rows that have come here, in the order of the ranks they are from.
    senders : (m,) int
        The rank that each is from.
    """

    def __init__(self, ranks: Ranks, to: Int, *columns: NDArray[Any]) -> None:
        self._ranks = ranks
        order = np.argsort(to, kind="stable")
        bounds = np.searchsorted(to[order], np.arange(ranks.size + 1))
        self._sent = {
            rank: frozen_int(order[bounds[rank] : bounds[rank + 1]])
            for rank in range(ranks.size)
            if bounds[rank] < bounds[rank + 1]
        }
        self._n = len(to)
        came = ranks.exchanged({r: [each[rows] for each in columns] for r, rows in self._sent.items()})
        none = [each[:0] for each in columns]
        self.columns = [np.concatenate(each) for each in zip(none, *came.values(), strict=True)]
        counts = {rank: len(rows[0]) for rank, rows in came.items()}
        self.senders = frozen_int(np.repeat(np.array(list(counts), np.int64), list(counts.values())))

    def answered(self, *columns: NDArray[Any]) -> list[NDArray[Any]]:
        """What the ranks to which this one sent its rows say of each ``(n, …)``; here: of each that came."""
        bounds = np.searchsorted(self.senders, np.arange(self._ranks.size + 1))
        back = {
            rank: [each[bounds[rank] : bounds[rank + 1]] for each in columns]
            for rank in range(self._ranks.size)
            if bounds[rank] < bounds[rank + 1]
        }
        came = self._ranks.exchanged(back)
        found = [np.empty((self._n, *each.shape[1:]), each.dtype) for each in columns]
        for rank, rows in self._sent.items():
            for column, values in zip(found, came[rank], strict=True):
                column[rows] = values
        return found


def rank_of_key(keys: UInt64, size: int) -> Int:
    """Rank for well-spread keys: equal stretches of all 64-bit numbers, in the order of the ranks."""
    half = np.uint64(32)
    return frozen_int((keys >> half) * np.uint64(size) >> half)


def groups(*keys: NDArray[Any]) -> tuple[Int, Int]:
    """Rows sorted by the keys, the last one first; and where each group of equal ones begins, and the end."""
    order = np.lexsort(keys)
    new = np.zeros(len(order), bool)
    new[:1] = True
    for key in keys:
        new[1:] |= key[order][1:] != key[order][:-1]
    return frozen_int(order), frozen_int(np.append(np.flatnonzero(new), len(order)))


def refuse_all(ranks: Ranks, fault: str | None) -> None:
    """Raise MeshError on all ranks if one of them has found a fault."""
    faults = [each for each in ranks.gathered(fault) if each is not None]
    if faults:
        raise MeshError(faults[0])
