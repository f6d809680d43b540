"""Run test functions and the command line on several MPI ranks under ``mpiexec``.

The ranks are separate processes, if necessary more than cores. Without mpi4py or ``mpiexec`` the tests are
skipped. A failure shows the traceback of its rank, and a timeout shows the stack of each rank.
"""

from __future__ import annotations

import faulthandler
import importlib
import importlib.util
import inspect
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

__all__ = ["Ended", "by_open_mpi", "ended", "launch", "on_ranks", "started"]

T = TypeVar("T")

PROGRAM = "from agglo_core.cli import main; main()"
"""Command line as a program for ``python -c``."""
_GRACE = 0.5  # seconds in which other ranks may still report their failure, before all are stopped
_AFTER = 60.0  # seconds for start and stop, in addition to the work


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
    assert file is not None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arguments").write_bytes(pickle.dumps(arguments))
        done = ended(started(size, [__file__, file, function.__name__, name, str(seconds)]), seconds + _AFTER)
        failures = sorted(
            folder.glob("failure-*"), key=lambda path: ("RankError" in path.read_text(), path.name)
        )
        told = "\n".join(f"{path.name}:\n{path.read_text()}" for path in failures if path.read_text())
        assert done.code == 0, f"{function.__name__} on {size} ranks:\n{told or done.out + done.err}"
        return [pickle.loads((folder / f"answer-{rank}").read_bytes()) for rank in range(size)]


def launch(size: int, *arguments: str, cwd: Path, program: str = PROGRAM, seconds: float = 60.0) -> Ended:
    """Run ``agglo`` with arguments, or another program, on ``size`` ranks."""
    return ended(started(size, ["-c", program, *arguments], cwd=cwd), seconds)


def started(
    size: int,
    arguments: Sequence[str],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[str]:
    """Start ``mpiexec -n size python ARGUMENTS``, or skip the test without MPI."""
    return subprocess.Popen(
        [_mpiexec(), "-n", str(size), sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, **_SURROUNDINGS, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        | dict(environment or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
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


def _work(file: str, name: str, folder: str, seconds: str) -> None:
    """Run one rank of :func:`on_ranks`."""
    from mpi4py import MPI

    rank, home = MPI.COMM_WORLD.rank, Path(folder)
    with open(home / f"failure-{rank}", "w") as failure:
        try:
            sys.path.insert(0, str(Path(file).parent))
            module = importlib.import_module(Path(file).stem)
            faulthandler.dump_traceback_later(float(seconds), exit=True, file=failure)
            arguments = pickle.loads((home / "arguments").read_bytes())
            (home / f"answer-{rank}").write_bytes(pickle.dumps(getattr(module, name)(*arguments)))
        except BaseException:
            failure.write(traceback.format_exc())
            failure.flush()
            time.sleep(_GRACE)
            MPI.COMM_WORLD.Abort(1)
        faulthandler.cancel_dump_traceback_later()


if __name__ == "__main__":
    _work(*sys.argv[1:])
