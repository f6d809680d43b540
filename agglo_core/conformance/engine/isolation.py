"""Test a component in a child process, so that it is stopped and reported if it hangs or crashes.

Time limits count the CPU seconds of the child process, so that other load on the machine does not matter.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from numba.core.event import Listener, register

from agglo_core.conformance.base import Subject
from agglo_core.conformance.base.handing_over import environment, subject_from, task_of
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.engine.judging import Result, State, judge, laws_for
from agglo_core.conformance.laws import all_laws, laws_of
from agglo_core.errors import OptionError
from agglo_core.registry.containment import PLUGIN_FAILURES

_STOPS = 2  # number of timeouts after which the remaining laws are skipped
_START = 120.0  # CPU seconds to import the suite and the component
_START_ANOTHER = ("same_in_another_process",)  # laws that start a child process themselves

_POLL = 0.1  # wall-clock seconds between two looks at the clock of the child process
_IDLE = 0.02  # a process that uses a smaller share of a time limit waits for something that never comes


class _Stopped(Exception):
    """Exception for a timeout or crash of the child process."""


def judge_apart(subject: Subject, timeout: float, names: Sequence[str] = ()) -> list[Result]:
    """Test a component against its laws in child processes, with ``timeout`` CPU seconds per law.

    With ``names``, only against these laws. After the second timeout or crash the remaining laws are
    reported as not run.

    Raises
    ------
    OptionError
        If the component is an object, which another process cannot import, or needs an option; or if a law
        does not apply.
    """
    task, results, pending = task_of(subject), list[Result](), list(names)
    for _ in range(_STOPS):
        try:
            # Start a child process; after a timeout or crash the next child continues with the laws left.
            with _Child({**task, "laws": pending}) as child:
                child.listen(_START)
                pending = child.listen(timeout)["laws"]
                while pending:
                    starting = _START if pending[0] in _START_ANOTHER else 0.0
                    results.append(Result(**child.listen(timeout + starting)))
                    pending = pending[1:]
        except _Stopped as stopped:
            results.append(_result(pending[0] if pending else "builds", "FAILS", str(stopped)))
            pending = pending[1:]
        if not pending:
            return results
    return results + [_result(name, "not run", "the component had to be stopped twice") for name in pending]


class _Child(contextlib.AbstractContextManager["_Child"]):
    """Child process that tests the component described by ``task``, and is killed at the end."""

    def __init__(self, task: Mapping[str, Any]) -> None:
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed at the end)
        command = [sys.executable, "-c", "from agglo_core.conformance.engine.isolation import main; main()"]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self.errors}
        self.process = subprocess.Popen(command, text=True, env=environment(), **pipes)
        self.lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=_read, args=(self.process.stdout, self.lines), daemon=True).start()
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError), self.process.stdin as stdin:  # a dead process is reported
            stdin.write(json.dumps(task))

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.errors.close()

    def listen(self, limit: float) -> dict[str, Any]:
        """Return the next message, and raise _Stopped after ``limit`` CPU seconds or without any activity.

        Compilation does not count.
        """
        used, last, compiling = 0.0, _clock(self.process.pid), False
        window_start, used_before = time.monotonic(), 0.0
        while True:
            line = None
            with contextlib.suppress(queue.Empty):
                line = self.lines.get(timeout=_POLL)
            # CPU seconds since the last look, and in a window of one time limit.
            clock, now = _clock(self.process.pid), time.monotonic()
            used, last = used + (0.0 if compiling else clock - last), clock
            idle = now - window_start > limit and used - used_before < _IDLE * (now - window_start)
            if compiling or now - window_start > limit:
                window_start, used_before = now, used
            if line is None and (used > limit or idle) and not compiling:
                remedy = "look for a loop that may not terminate, or allow more time with --timeout"
                raise _Stopped(f"no answer after {limit:g} CPU seconds: {remedy}")
            if line == "":
                self.errors.seek(0)
                last_line = (self.errors.read().strip().splitlines() or ["it left no message"])[-1]
                raise _Stopped(f"the process died (exit code {self.process.wait()}): {last_line}")
            message: dict[str, Any] = json.loads(line) if line else {}
            if "refused" in message:
                raise OptionError(message["refused"])
            compiling = message.get("compiling", compiling)
            if message and "compiling" not in message:
                return message


def _read(stream: IO[str], lines: queue.Queue[str]) -> None:
    """Put each line of a stream into a queue, and an empty string at the end."""
    for line in stream:
        lines.put(line)
    lines.put("")


def _clock(pid: int) -> float:
    """Return the CPU seconds of a process and its finished children, or the wall clock without ``/proc``."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return time.monotonic()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _result(name: str, state: State, message: str) -> Result:
    law = next(law for law in all_laws() if law.name == name)
    return Result(law.name, law.sentence, state, message, 0.0, law.promise)


class _Compilation(Listener):
    """Listener that sends messages when numba starts and ends to compile or load kernels."""

    def __init__(self, send: Any) -> None:
        self.send, self.depth = send, 0

    def on_start(self, event: object) -> None:
        """Count the start of a compilation, which may be nested in another."""
        self.depth += 1
        if self.depth == 1:
            self.send(compiling=True)

    def on_end(self, event: object) -> None:
        """Count the end of a compilation."""
        self.depth -= 1
        if self.depth == 0:
            self.send(compiling=False)


def main() -> None:
    """Test the component described on stdin, and print each law's result as a line of JSON.

    Other output goes to stderr. The parent counts CPU seconds after the imports, except while numba compiles
    or loads kernels.
    """
    # Keep stdout for messages and redirect everything else to stderr.
    with os.fdopen(os.dup(1), "w") as stdout:
        os.dup2(2, 1)
        lock = threading.Lock()

        def send_message(**message: Any) -> None:
            with lock:
                stdout.write(json.dumps(message) + "\n")
                stdout.flush()

        # Import the component and the suite before the clock starts.
        task = json.loads(sys.stdin.read())
        laws_of(task["kind"])
        subject = subject_from(task)
        with contextlib.suppress(*PLUGIN_FAILURES):  # reported by the law builds
            _ = subject.target
        own_components().build("bisector", "inertial")
        send_message(ready=True)
        register("numba:compiler_lock", _Compilation(send_message))  # type: ignore[no-untyped-call]
        # Select the laws, then judge and report them one by one.
        try:
            laws = {law.name: law for law in laws_for(subject, task["laws"])}
        except OptionError as error:
            send_message(refused=str(error))
            return
        send_message(laws=list(laws))
        for law in laws.values():
            send_message(**asdict(judge(law, subject)))
