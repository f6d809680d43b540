"""MPI communication between ranks. An error on one rank becomes an error on all.

All messages pass through this module and are counted. Between two exchanges, each rank works alone inside
:meth:`Ranks.together`: an error on any rank is raised on all ranks, so no rank waits for a failed rank.
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

# first and longest interval between two tests for arrived messages, in seconds; longer: less processor
# time, longer waits
# (benchmarks/distributed_mesh.py)
_PAUSE, _LONGEST = 2e-5, 0.002
_TAG = 7411  # message tag, unlike tags of other users of the communicator


class RankError(AggloError, RuntimeError):
    """Error on this rank because another rank failed. The message names that rank and its error.

    Examples
    --------
    >>> raise RankError("rank 1: FileError: piece_1.vtu: no such file")
    Traceback (most recent call last):
        ...
    agglo_core.distributed.communication.RankError: rank 1: FileError: piece_1.vtu: no such file
    """


@dataclass
class Traffic:
    """Number of messages and bytes that this rank has sent.

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
    """Processes in an MPI communicator.

    Parameters
    ----------
    comm : mpi4py communicator, optional
        Default: ``MPI.COMM_WORLD``. The communicator is duplicated to separate messages from other users.

    Attributes
    ----------
    rank, size : int
        Number of this process, and number of processes.
    traffic : Traffic
        Messages and bytes sent so far.

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
        """Collect all ranks' values, in rank order, on every rank (allgather)."""
        self._count(value, self.size - 1)
        packed = pickle.dumps(value, protocol=5)
        sizes = np.empty(self.size, np.int64)
        _wait(self.comm.Iallgather(np.array([len(packed)], np.int64), sizes))
        received = bytearray(int(sizes.sum()))
        _wait(self.comm.Iallgatherv(packed, (received, sizes)))
        stops, view = np.cumsum(sizes), memoryview(received)
        return [pickle.loads(view[stop - size : stop]) for size, stop in zip(sizes, stops, strict=True)]

    def summed(self, value: float) -> float:
        """Sum a value over all ranks, in rank order, so that the result is equal on all of them."""
        return float(sum(self.gathered(value)))

    def largest(self, value: float) -> float:
        """Return the largest value over all ranks."""
        return max(self.gathered(value))

    def reduced(self, values: NDArray[Any], how: Literal["sum", "min", "max"]) -> NDArray[Any]:
        """Reduce arrays of equal shape entry by entry over all ranks (allreduce).

        Integer sums do not depend on the distribution, real sums differ in the last digits.
        """
        total = np.empty_like(values)
        self._count(values, 1 if self.size > 1 else 0)
        _wait(self.comm.Iallreduce(np.ascontiguousarray(values), total, op=getattr(_mpi(), how.upper())))
        return total

    def from_first(self, value: T) -> T:
        """Return rank 0's value on every rank (broadcast)."""
        self._count(value, self.size - 1 if self.rank == 0 else 0)
        packed = pickle.dumps(value, protocol=5) if self.rank == 0 else b""
        size = np.array([len(packed)], np.int64)
        _wait(self.comm.Ibcast(size, root=0))
        received = bytearray(packed) if self.rank == 0 else bytearray(int(size[0]))
        _wait(self.comm.Ibcast(received, root=0))
        found: T = pickle.loads(received)
        return found

    def exchanged(self, parcels: Mapping[int, T]) -> dict[int, T]:
        """Send ``parcels`` (by receiving rank), and return the received parcels by sending rank. Collective.

        A parcel to the sending rank itself arrives unchanged.
        """
        # Announce the sizes, so that every rank can allocate its receive buffers.
        packed = {to: pickle.dumps(parcels[to], protocol=5) for to in parcels if to != self.rank}
        sizes = np.zeros(self.size, np.int64)
        for to, data in packed.items():
            sizes[to] = len(data)
            self._count(data, 1)
        receive_sizes = np.empty(self.size, np.int64)
        self._count(0, self.size - 1)
        _wait(self.comm.Ialltoall(sizes, receive_sizes))
        # Exchange the pickled parcels.
        buffers = {int(rank): bytearray(int(receive_sizes[rank])) for rank in np.flatnonzero(receive_sizes)}
        requests = [self.comm.Irecv(buffer, source=rank, tag=_TAG) for rank, buffer in buffers.items()]
        requests += [self.comm.Isend(data, dest=to, tag=_TAG) for to, data in packed.items()]
        for request in requests:
            _wait(request)
        result = {rank: pickle.loads(data) for rank, data in buffers.items()}
        if self.rank in parcels:
            result[self.rank] = parcels[self.rank]
        return {rank: result[rank] for rank in sorted(result)}

    def since_last(self) -> Traffic:
        """Return the number of messages and bytes that this rank has sent since the previous call."""
        sent = self.traffic - self._told
        self._told += sent
        return sent

    def meet(self) -> None:
        """Wait until all ranks arrive (barrier)."""
        _wait(self.comm.Ibarrier())

    @contextmanager
    def together(self) -> Iterator[None]:
        """Context for code without communication: if it fails on one rank, it fails on all ranks.

        The failing rank raises its own error, all others a :class:`RankError` with its message. The body must
        not communicate.
        """
        failure: BaseException | None = None
        try:
            yield
        except BaseException as error:
            failure = error
        message = None if failure is None else f"{type(failure).__name__}: {failure}"
        failures = [(rank, each) for rank, each in enumerate(self.gathered(message)) if each is not None]
        if failure is not None:
            raise failure
        if failures:
            rank, message = failures[0]
            raise RankError(f"rank {rank}: {message}")

    def _count(self, value: Any, times: int) -> None:
        if times > 0:
            self.traffic.messages += times
            self.traffic.bytes += times * _weight(value)


def _wait(request: Any) -> None:
    """Wait for messages without occupying the processor. MPI itself would wait in a busy loop."""
    pause = 0.0
    while not request.Test():
        time.sleep(pause)
        pause = min(pause + _PAUSE, _LONGEST)


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
