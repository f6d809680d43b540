"""Run test functions and the command line on several MPI ranks under ``mpiexec``.

The ranks are separate processes, if necessary more than cores. Without mpi4py or ``mpiexec`` the tests are
skipped. Ranks that run functions are started once per test process: a function must restore what it changes.
A failure shows the traceback of its rank, a timeout the stack of each rank, and both end all ranks.
"""

from __future__ import annotations

import atexit
import faulthandler
import importlib
import importlib.util
import inspect
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Client, Connection, wait
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

__all__ = ["Ended", "by_open_mpi", "ended", "launch", "on_ranks", "started"]

T = TypeVar("T")

PROGRAM = "from agglo_core.cli import main; main()"
"""Command line as a program for ``python -c``."""
_GRACE = 0.5  # seconds in which other ranks may still report their failure, before all are stopped
_AFTER = 60.0  # seconds for start and stop, in addition to the work
_USUAL = 3  # ranks that most tests need


class Ended(NamedTuple):
    """Result of a command on several ranks: exit code of mpiexec, output, and duration in seconds."""

    code: int
    out: str
    err: str
    seconds: float


def on_ranks(size: int, function: Callable[..., T], *arguments: Any, seconds: float = 60.0) -> list[T]:
    """Return ``function(*arguments)`` from each of ``size`` ranks, in rank order.

    Parameters
    ----------
    size : int
        Number of ranks.
    function : callable
        Module-level function of a test file, which each rank imports.
    *arguments : object
        Picklable arguments; the answers are pickled too.
    seconds : float
        Time limit for each rank.
    """
    file = inspect.getsourcefile(function)
    task = size, file, function.__name__, pickle.dumps(arguments), seconds
    return _Pool.of(size).run(task)


class _Pool:
    """Ranks that run functions. A function on fewer ranks runs on the first ones."""

    current: ClassVar[_Pool | None] = None

    def __init__(self, size: int) -> None:
        self.size, self._temporary = size, tempfile.TemporaryDirectory(prefix="ranks-")
        self.folder = Path(self._temporary.name)
        with socket.socket(socket.AF_UNIX) as server, open(self.folder / "output", "w") as output:
            server.bind(str(self.folder / "socket"))
            server.listen(size)
            self.process = started(size, [__file__, self._temporary.name], output=output)
            server.settimeout(_AFTER)
            ranks = {}
            for _ in range(size):
                connection = Connection(server.accept()[0].detach())
                ranks[connection.recv()] = connection
        self.connections = [ranks[rank] for rank in range(size)]
        atexit.register(self.end)

    @classmethod
    def of(cls, size: int) -> _Pool:
        """Return the current ranks, replaced if they are too few."""
        if cls.current is not None and cls.current.size < size:
            cls.current.end()
        cls.current = cls.current or _Pool(max(size, _USUAL))
        return cls.current

    def run(self, task: tuple[Any, ...]) -> list[Any]:
        """Run a function and return its answers."""
        size, _, name, _, seconds = task
        waiting: dict[Any, int] = {}
        for rank, connection in enumerate(self.connections[:size]):
            connection.send(task)
            waiting[connection] = rank
        answers: dict[int, Any] = {}
        failures: dict[int, str] = {}
        until = time.monotonic() + seconds + _AFTER
        while waiting:
            ready: list[Any] = wait(list(waiting), max(until - time.monotonic(), 0.0))
            if not ready:
                break
            for each in ready:
                rank = waiting.pop(each)
                answer: bytes | None = None
                failure = ""
                with suppress(EOFError, OSError):  # a rank that has ended
                    answer, failure = each.recv()
                if answer is None:
                    failures[rank] = failure
                    until = min(until, time.monotonic() + _GRACE)
                else:
                    answers[rank] = pickle.loads(answer)
        if len(answers) == size:
            return [answers[rank] for rank in range(size)]
        self.process.terminate()  # mpiexec forwards it to the ranks
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0)
        for rank in range(size):
            failures[rank] = failures.get(rank) or (self.folder / f"stacks-{rank}").read_text()
        told = "\n".join(
            f"failure-{rank}:\n{failures[rank]}"
            for rank in sorted(failures, key=lambda rank: ("RankError" in failures[rank], rank))
            if failures[rank]
        )
        output = (self.folder / "output").read_text()
        self.end()
        raise AssertionError(f"{name} on {size} ranks:\n{told or output}")

    def end(self) -> None:
        """End all ranks."""
        _Pool.current = None
        atexit.unregister(self.end)
        for connection in self.connections:
            connection.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._temporary.cleanup()


def launch(size: int, *arguments: str, cwd: Path, program: str = PROGRAM, seconds: float = 60.0) -> Ended:
    """Run ``agglo`` with arguments, or another program, on ``size`` ranks."""
    return ended(started(size, ["-c", program, *arguments], cwd=cwd), seconds)


def started(
    size: int,
    arguments: Sequence[str],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    output: Any = subprocess.PIPE,
) -> subprocess.Popen[str]:
    """Start ``mpiexec -n size python ARGUMENTS``, or skip the test without MPI."""
    return subprocess.Popen(
        [_mpiexec(), "-n", str(size), sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, **_SURROUNDINGS, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        | dict(environment or {}),
        stdout=output,
        stderr=output,
        text=True,
    )


def ended(running: subprocess.Popen[str], seconds: float) -> Ended:
    """Wait for the result, and fail after ``seconds``."""
    start = time.monotonic()
    try:
        out, err = running.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        running.send_signal(signal.SIGTERM)  # mpiexec forwards it to the ranks
        try:
            out, err = running.communicate(timeout=5.0)
        except subprocess.TimeoutExpired:
            running.kill()
            out, err = running.communicate()
        raise AssertionError(f"still running after {seconds:.0f} s\n{out}{err}") from None
    return Ended(running.returncode, out, err, time.monotonic() - start)


def by_open_mpi() -> bool:
    """Return True if ``mpiexec`` belongs to Open MPI, which ends other ranks by SIGTERM."""
    told = subprocess.run([_mpiexec(), "--version"], capture_output=True, text=True, check=False)
    return "Open MPI" in told.stdout or "OpenRTE" in told.stdout


_SURROUNDINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # allow more ranks than cores in Open MPI, as MPICH always does
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}


def _mpiexec() -> str:
    import pytest

    if importlib.util.find_spec("mpi4py") is None:
        pytest.skip("mpi4py is not installed: pip install 'agglo[mpi]'")
    own = Path(sys.executable).parent / "mpiexec"
    found = str(own) if own.exists() else shutil.which("mpiexec")
    if found is None:
        pytest.skip("there is no mpiexec: pip install 'agglo[mpi]'")
    return found


def _serve(name: str) -> None:
    """Run on one rank the functions that :class:`_Pool` sends."""
    from mpi4py import MPI

    world, folder, communicators = MPI.COMM_WORLD, Path(name), {}
    connection = Client(str(folder / "socket"), family="AF_UNIX")
    connection.send(world.rank)
    with open(folder / f"stacks-{world.rank}", "w") as stacks, suppress(EOFError):
        while True:
            size, file, function, arguments, seconds = connection.recv()
            if size not in communicators:
                communicators[size] = world.Create_group(world.group.Incl(range(size)))
            # functions take the ranks that run them for all there are
            MPI.COMM_WORLD = communicators[size]  # type: ignore[misc]
            faulthandler.dump_traceback_later(seconds, exit=True, file=stacks)
            answer, failure = None, ""
            try:
                sys.path.insert(0, str(Path(file).parent))
                module = importlib.import_module(Path(file).stem)
                answer = pickle.dumps(getattr(module, function)(*pickle.loads(arguments)))
            except BaseException:
                failure = traceback.format_exc()
            faulthandler.cancel_dump_traceback_later()
            del sys.path[0]
            connection.send((answer, failure))


if __name__ == "__main__":
    _serve(sys.argv[1])
