"""Ranks: what the processes of a distributed run tell one another, and how they fail together.

Everything that is sent goes through here, so that it can be counted. Between two exchanges ranks work by
themselves, inside :meth:`Ranks.together`: an error on one of them is raised on all, and nobody waits for
someone who has left.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from agglo_core.errors import AggloError, OptionError

T = TypeVar("T")

_PAUSE, _LONGEST = 2e-5, 0.002  # seconds between looks at whether others have come: longer and longer
_TAG = 7411  # of messages from rank to rank; whoever shares the communicator has others


class RankError(AggloError, RuntimeError):
    """Something failed on another rank; the message says on which, and what.

    Examples
    --------
    >>> raise RankError("rank 1: FileError: piece_1.vtu: no such file")
    Traceback (most recent call last):
        ...
    agglo_core.distributed.communication.RankError: rank 1: FileError: piece_1.vtu: no such file
    """


@dataclass
class Traffic:
    """What this rank has sent to others: messages, and bytes in them.

    Examples
    --------
    >>> ranks = Ranks()
    >>> found = ranks.gathered(3.5)
    >>> ranks.traffic  # of one rank
    Traffic(messages=0, bytes=0)
    """

    messages: int = 0
    bytes: int = 0

    def __sub__(self, earlier: Traffic) -> Traffic:
        return Traffic(self.messages - earlier.messages, self.bytes - earlier.bytes)

    def __add__(self, other: Traffic) -> Traffic:
        return Traffic(self.messages + other.messages, self.bytes + other.bytes)


class Ranks:
    """The processes of a communicator of MPI.

    Parameters
    ----------
    comm : mpi4py communicator, optional
        By default ``MPI.COMM_WORLD``; it is duplicated, so that messages of others are not mixed up.

    Attributes
    ----------
    rank, size : int
        Number of this process, and how many there are.
    traffic : Traffic
        What this rank has sent so far.

    Raises
    ------
    OptionError
        If mpi4py is not installed.

    Examples
    --------
    >>> ranks = Ranks()  # under ``mpiexec -n 4 python script.py`` there are four
    >>> ranks.gathered(ranks.rank)
    [0]
    """

    def __init__(self, comm: Any = None) -> None:
        mpi = _mpi()
        self.comm: Any = (mpi.COMM_WORLD if comm is None else comm).Dup()
        self.rank: int = self.comm.Get_rank()
        self.size: int = self.comm.Get_size()
        self.traffic = Traffic()
        self._told = Traffic()

    def __repr__(self) -> str:
        return f"Ranks(rank {self.rank} of {self.size})"

    def gathered(self, value: T) -> list[T]:
        """What all ranks gave, in the order of the ranks, on every rank."""
        self._count(value, self.size - 1)
        self.meet()
        found: list[T] = self.comm.allgather(value)
        return found

    def summed(self, value: float) -> float:
        """Sum over the ranks, in their order: the same number on each of them."""
        return float(sum(self.gathered(value)))

    def largest(self, value: float) -> float:
        """Largest number that a rank gave."""
        return max(self.gathered(value))

    def reduced(self, values: NDArray[Any], how: Literal["sum", "min", "max"]) -> NDArray[Any]:
        """Arrays of one shape from all ranks, put together item by item: the same on each of them.

        Sums of integers do not depend on the ranks, those of reals in their last digits.
        """
        total = np.empty_like(values)
        self._count(values, 1 if self.size > 1 else 0)
        self.meet()
        self.comm.Allreduce(np.ascontiguousarray(values), total, op=getattr(_mpi(), how.upper()))
        return total

    def from_first(self, value: T) -> T:
        """What rank 0 gave, on every rank."""
        self._count(value, self.size - 1 if self.rank == 0 else 0)
        self.meet()
        found: T = self.comm.bcast(value, root=0)
        return found

    def exchanged(self, parcels: Mapping[int, T]) -> dict[int, T]:
        """What other ranks sent to this one, by sender: ``parcels`` are by receiver. All ranks must call it.

        What a rank sends to itself arrives as it is.
        """
        packed = {to: pickle.dumps(parcels[to], protocol=5) for to in parcels if to != self.rank}
        sizes = np.zeros(self.size, np.int64)
        for to, data in packed.items():
            sizes[to] = len(data)
            self._count(data, 1)
        coming = np.empty(self.size, np.int64)
        self._count(0, self.size - 1)
        self.meet()
        self.comm.Alltoall(sizes, coming)
        arriving = {int(rank): bytearray(int(coming[rank])) for rank in np.flatnonzero(coming)}
        waiting = [self.comm.Irecv(room, source=rank, tag=_TAG) for rank, room in arriving.items()]
        waiting += [self.comm.Isend(data, dest=to, tag=_TAG) for to, data in packed.items()]
        _mpi().Request.Waitall(waiting)
        found = {rank: pickle.loads(data) for rank, data in arriving.items()}
        if self.rank in parcels:
            found[self.rank] = parcels[self.rank]
        return {rank: found[rank] for rank in sorted(found)}

    def since_last(self) -> Traffic:
        """What this rank has sent since this was last asked."""
        sent = self.traffic - self._told
        self._told += sent
        return sent

    def meet(self) -> None:
        """Wait until all ranks are here, and leave the processor to them meanwhile.

        MPI itself waits in a loop. Everything in which ranks wait for one another begins with this.
        """
        if self.size == 1:
            return
        request, pause = self.comm.Ibarrier(), 0.0
        while not request.Test():
            time.sleep(pause)
            pause = min(pause + _PAUSE, _LONGEST)

    @contextmanager
    def together(self) -> Iterator[None]:
        """Work that each rank does by itself: if it fails on one, it fails on all.

        The rank on which it failed raises its own error, all others a :class:`RankError` with that message.
        Nothing may be sent inside.
        """
        failure: BaseException | None = None
        try:
            yield
        except BaseException as error:
            failure = error
        told = None if failure is None else f"{type(failure).__name__}: {failure}"
        failures = [(rank, each) for rank, each in enumerate(self.gathered(told)) if each is not None]
        if failure is not None:
            raise failure
        if failures:
            rank, message = failures[0]
            raise RankError(f"rank {rank}: {message}")

    def _count(self, value: Any, times: int) -> None:
        if times > 0:
            self.traffic.messages += times
            self.traffic.bytes += times * _weight(value)


def _weight(value: Any) -> int:
    if isinstance(value, bytes):
        return len(value)
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if isinstance(value, Mapping):
        return sum(8 + _weight(each) for each in value.values())
    if isinstance(value, list | tuple):
        return sum(_weight(each) for each in value)
    return 8


def _mpi() -> Any:
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise OptionError(
            f"distributed meshes need mpi4py and an MPI library ({error}): pip install 'agglo[mpi]'"
        ) from None
    return MPI
