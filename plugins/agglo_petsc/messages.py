"""Exchange of arrays and error messages between ranks during set-up."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from agglo_core.authoring import Int, OptionError, frozen_int

T = TypeVar("T")


def agree(comm: Any, wrong: str) -> None:
    """Raise OptionError on all ranks if any rank has an error message, to avoid a deadlock.

    Parameters
    ----------
    comm : petsc4py.PETSc.Comm
    wrong : str
        Error message on this rank, or empty.
    """
    messages = comm.tompi4py().allgather(wrong)
    first = next((rank for rank, message in enumerate(messages) if message), None)
    if first is not None:
        raise OptionError(messages[first] if len(messages) == 1 else f"rank {first}: {messages[first]}")


def exchange_parcels(comm: Any, parcels: Mapping[int, T]) -> dict[int, T]:
    """Send one object to each rank, and return the received objects by increasing rank. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    parcels : mapping of rank to object
        Objects for other ranks and this rank; None is nothing.
    """
    found = comm.alltoall([parcels.get(rank) for rank in range(comm.size)])
    return {rank: each for rank, each in enumerate(found) if each is not None}


def by_owner(ids: Int, starts: Int) -> dict[int, Int]:
    """Group increasing ids by the rank that owns them, where rank r owns ``starts[r]:starts[r + 1]``.

    Examples
    --------
    >>> {rank: each.tolist() for rank, each in by_owner(np.array([1, 2, 7]), np.array([0, 2, 2, 8])).items()}
    {0: [1], 2: [2, 7]}
    """
    ends = np.searchsorted(ids, starts)
    return {
        rank: frozen_int(ids[first:last])
        for rank, (first, last) in enumerate(pairwise(ends.tolist()))
        if last > first
    }
