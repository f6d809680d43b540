"""Collective operations of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from on_ranks import on_ranks

from agglo_core.distributed import Ranks


class _Nonblocking:
    """A communicator without the operations that wait."""

    def __init__(self, comm: Any) -> None:
        self._comm = comm

    def Dup(self) -> _Nonblocking:
        return self

    def __getattr__(self, name: str) -> Any:
        if not name.startswith(("Get_", "I")):
            raise AttributeError(f"{name} waits in a busy loop")
        return getattr(self._comm, name)


def values_of_all_operations() -> list[Any]:
    from mpi4py import MPI

    ranks = Ranks(_Nonblocking(MPI.COMM_WORLD))
    rank = ranks.rank
    ranks.meet()
    return [
        ranks.gathered("x" * 100 * rank or None),
        ranks.summed(0.1 * rank),
        ranks.largest(rank),
        ranks.reduced(np.array([[rank, -rank]]), "max").tolist(),
        ranks.from_first(np.arange(3) + rank).tolist(),
        ranks.exchanged({(rank + 1) % ranks.size: rank, rank: "own"}),
        ranks.exchanged({}),
    ]


@pytest.mark.parametrize("size", [1, 3])
def test_operations_give_the_values_of_all_ranks_without_a_busy_loop(size: int) -> None:
    last = size - 1
    for rank, values in enumerate(on_ranks(size, values_of_all_operations)):
        before = (rank - 1) % size
        assert values == [
            [None, "x" * 100, "x" * 200][:size],
            sum(0.1 * each for each in range(size)),
            last,
            [[last, 0]],
            [0, 1, 2],
            {0: "own"}
            if size == 1
            else {each: "own" if each == rank else before for each in sorted((rank, before))},
            {},
        ]
