"""Table row exchange between ranks: related rows are sent to one rank, which replies to the senders."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.errors import MeshError


class Meeting:
    """Table rows that this rank has received from all ranks for a joint evaluation.

    Parameters
    ----------
    ranks : Ranks
    to : (n,) int
        Destination rank per local row.
    *columns : (n, …) arrays
        Data to send, row by row.

    Attributes
    ----------
    columns : list of (m, …) arrays
        Received rows, in sender order.
    senders : (m,) int
        Sender per received row.
    """

    def __init__(self, ranks: Ranks, to: Int, *columns: NDArray[Any]) -> None:
        # Group the local rows by destination.
        self._ranks = ranks
        order = np.argsort(to, kind="stable")
        bounds = np.searchsorted(to[order], np.arange(ranks.size + 1))
        self._sent = {
            rank: frozen_int(order[bounds[rank] : bounds[rank + 1]])
            for rank in range(ranks.size)
            if bounds[rank] < bounds[rank + 1]
        }
        self._n = len(to)
        # Exchange, and keep the sender of each received row.
        came = ranks.exchanged({r: [each[rows] for each in columns] for r, rows in self._sent.items()})
        none = [each[:0] for each in columns]
        self.columns = [np.concatenate(each) for each in zip(none, *came.values(), strict=True)]
        counts = {rank: len(rows[0]) for rank, rows in came.items()}
        self.senders = frozen_int(np.repeat(np.array(list(counts), np.int64), list(counts.values())))

    def answered(self, *columns: NDArray[Any]) -> list[NDArray[Any]]:
        """Send a reply for each received row, and return the replies to the rows sent by this rank."""
        bounds = np.searchsorted(self.senders, np.arange(self._ranks.size + 1))
        parcels = {
            rank: [array[bounds[rank] : bounds[rank + 1]] for array in columns]
            for rank in range(self._ranks.size)
            if bounds[rank] < bounds[rank + 1]
        }
        arrivals = self._ranks.exchanged(parcels)
        results = [np.empty((self._n, *array.shape[1:]), array.dtype) for array in columns]
        for rank, rows in self._sent.items():
            for column, values in zip(results, arrivals[rank], strict=True):
                column[rows] = values
        return results


def rank_of_key(keys: UInt64, size: int) -> Int:
    """Assign uniformly distributed 64-bit keys to ranks, an equal interval of keys to each rank."""
    half = np.uint64(32)
    return frozen_int((keys >> half) * np.uint64(size) >> half)


def groups(*keys: NDArray[Any]) -> tuple[Int, Int]:
    """Group the rows with equal keys: return an order that sorts them, and the group offsets."""
    order = np.lexsort(keys)
    new = np.zeros(len(order), bool)
    new[:1] = True
    for key in keys:
        new[1:] |= key[order][1:] != key[order][:-1]
    return frozen_int(order), frozen_int(np.append(np.flatnonzero(new), len(order)))


def refuse_all(ranks: Ranks, fault: str | None) -> None:
    """Raise MeshError on all ranks if any rank reports a fault."""
    faults = [each for each in ranks.gathered(fault) if each is not None]
    if faults:
        raise MeshError(faults[0])
