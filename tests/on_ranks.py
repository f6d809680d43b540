"""Tests on several ranks: functions of test files, and the command line, under ``mpiexec``.

The ranks are processes of their own, more than there are cores if need be. Without mpi4py or an ``mpiexec``
such tests are skipped. What fails on a rank is shown with its traceback, and so is where each rank stands
when the time is up.
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
"""The command line, as ``python -c`` runs it."""
_GRACE = 0.5  # seconds in which other ranks may still say why they fail, before all are stopped
_AFTER = 60.0  # seconds for starting and stopping, beyond those of the work itself


class Ended(NamedTuple):
    """A command that ran on several ranks: exit code of mpiexec, what all ranks printed, how long it took."""

    code: int
    out: str
    err: str
    seconds: float


def on_ranks(size: int, function: Callable[..., T], *arguments: Any, seconds: float = 60.0) -> list[T]:
    """What ``function(*arguments)`` returns on each of ``size`` ranks, in their order.

    Parameters
    ----------
    size : int
    function : callable
        At the top of a test file, which each rank imports anew.
    *arguments : object
        As they can be pickled; so are the answers.
    seconds : float
        After which ranks that are still at work fail.
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
    """Run ``agglo`` with arguments, or a program of the test's own, on ``size`` ranks."""
    return ended(started(size, ["-c", program, *arguments], cwd=cwd), seconds)


def started(
    size: int,
    arguments: Sequence[str],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[str]:
    """``mpiexec -n size python ARGUMENTS``, still running; skips the test where there is no MPI."""
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
    """What became of it; fails if it does not end in time."""
    start = time.monotonic()
    try:
        out, err = running.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        running.send_signal(signal.SIGTERM)  # mpiexec hands it to the ranks
        try:
            out, err = running.communicate(timeout=5.0)
        except subprocess.TimeoutExpired:
            running.kill()
            out, err = running.communicate()
        raise AssertionError(f"still running after {seconds:.0f} s\n{out}{err}") from None
    return Ended(running.returncode, out, err, time.monotonic() - start)


def by_open_mpi() -> bool:
    """Whether the ``mpiexec`` that is found is Open MPI's, which ends other ranks by SIGTERM."""
    told = subprocess.run([_mpiexec(), "--version"], capture_output=True, text=True, check=False)
    return "Open MPI" in told.stdout or "OpenRTE" in told.stdout


_SURROUNDINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # more ranks than cores are a matter of course for MPICH; Open MPI wants to be told
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
    """One rank of :func:`on_ranks`."""
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
