"""Run whole commands in forks of a process that has already run each command once.

A forked command takes tenths of a second. Each fork has its own folder, limits and permissions, and may be
killed. The forked process runs this file, reads requests from stdin and writes answers, one JSON value per
line.
"""

from __future__ import annotations

import ctypes
import io
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NamedTuple

__all__ = ["COMMANDS", "Copies", "Ended", "drop_privileges"]

COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", "voronoi:n=60,seed=1", "--parts", "8,2", "-o", "out.vtu"),
    "solve": ("solve", "squares:n=4", "--parts", "4", "--no-cg", "-o", "out.vtu"),
    "mesh": ("mesh", "boxes:n=3", "-o", "out.foam"),
    "train": (
        *("train", "--preset", "paper", "--meshes", "4", "--epochs", "3"),
        *("--checkpoint", "checkpoint.safetensors", "--log", "log.txt", "-o", "out.safetensors"),
    ),
    "paper": ("paper", "runtime", "--quick", "--bisector", "coordinate", "-o", "out"),
}
"""Small commands for every subcommand that writes files."""


class Ended(NamedTuple):
    """Result of a fork.

    Attributes
    ----------
    code : int
        Exit code, or minus the signal.
    printed : str
        Output.
    changes : int
        Number of file changes.
    """

    code: int
    printed: str
    changes: int


class Copies:
    """Runs commands in forks of one process.

    Parameters
    ----------
    process : subprocess.Popen
        Process to fork, from :meth:`started`.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    @classmethod
    @contextmanager
    def started(cls) -> Iterator[Copies]:
        """Start the process, which ends with the block."""
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            "OMP_NUM_THREADS": "1",  # a fork does not inherit threads and would wait for them
        }
        command = [sys.executable, __file__]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        ) as process:
            yield cls(process)

    def run(
        self,
        command: Sequence[str],
        folder: Path,
        *,
        kill_at: int = 0,
        delay: float = 0.0,
        largest_file: int | None = None,
        privileged: bool = True,
    ) -> Ended:
        """Run a command in a folder.

        Parameters
        ----------
        command : sequence of str
            Arguments of ``agglo``.
        folder : Path
            Current folder of the fork.
        kill_at, delay : int, float
            Kill the fork (SIGKILL) ``delay`` seconds after the start of this file change in the folder.
            Changes are counted from 1: files opened for writing, renamed, removed and created.
        largest_file : int, optional
            Maximum file size in bytes, to simulate a full disk.
        privileged : bool
            Keep the right of root to write without permission.
        """
        request = {"command": command, "folder": str(folder), "kill_at": kill_at, "delay": delay}
        request |= {"largest_file": largest_file, "privileged": privileged}
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(request), file=self._process.stdin, flush=True)
        return Ended(*json.loads(self._process.stdout.readline()))


def _serve() -> None:
    """Run each command once, then serve requests in forks."""
    answers, sys.stdout = sys.stdout, sys.stderr
    from agglo_core.cli import main

    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        os.chdir(folder)
        for command in COMMANDS.values():
            with suppress(SystemExit), redirect_stderr(io.StringIO()):
                main(command)
        os.chdir("/")
    for line in sys.stdin:
        print(json.dumps(_copy(**json.loads(line))), file=answers, flush=True)


def _copy(kill_at: int, delay: float, **request: Any) -> Ended:
    receiving, sending = os.pipe()
    copy = os.fork()
    if copy == 0:
        try:
            os.close(receiving)
            _run(kill_at, sending, **request)
        finally:
            os._exit(99)  # unless the fork has ended already
    os.close(sending)
    with open(receiving) as stream:
        if kill_at and stream.readline():
            time.sleep(delay)
            os.kill(copy, signal.SIGKILL)
        printed = stream.read()
    code = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
    text, _, changes = printed.rpartition("\n")
    return Ended(code, text, int(changes or 0))


def _run(
    kill_at: int,
    answer: int,
    command: Sequence[str],
    folder: str,
    largest_file: int | None,
    privileged: bool,
) -> None:
    """Run a command in a fork.

    Write a line at change ``kill_at``, and the output at the end.
    """
    from agglo_core.cli import main

    os.chdir(folder)
    changes = 0

    def count(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal changes
        if _changes_files(event, arguments, folder):
            changes += 1
            if changes == kill_at:
                os.write(answer, b"now\n")

    # Count file changes, then set limits and permissions.
    sys.addaudithook(count)
    if largest_file is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, resource.RLIM_INFINITY))
    if not privileged:
        drop_privileges()
    # Run the command and report output, changes and exit code.
    printed, code = io.StringIO(), 0
    with redirect_stdout(printed), redirect_stderr(printed):
        try:
            main(list(command))
        except SystemExit as done:
            code = int(done.code or 0)
        except BaseException as error:
            printed.write(f"Traceback: {type(error).__name__}: {error}")
            code = 1
    os.write(answer, f"{printed.getvalue()}\n{changes}".encode(errors="replace"))
    os._exit(code)


def _changes_files(event: str, arguments: tuple[object, ...], folder: str) -> bool:
    """Return True if an audit event starts a file change in the folder."""
    if event == "open":
        flags = arguments[2]
        if not isinstance(flags, int) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
    elif event not in ("os.rename", "os.remove", "os.mkdir", "os.rmdir"):
        return False
    path = arguments[0]
    return isinstance(path, str | os.PathLike) and os.path.abspath(path).startswith(folder)


def drop_privileges() -> None:
    """Drop the capabilities that let root write without permission."""
    if os.geteuid() != 0:
        return
    header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # interface version 3, this thread
    none = (ctypes.c_uint32 * 6)()
    if ctypes.CDLL(None, use_errno=True).capset(header, none) != 0:
        raise OSError(ctypes.get_errno(), "the privileges of root cannot be dropped")


if __name__ == "__main__":
    _serve()
