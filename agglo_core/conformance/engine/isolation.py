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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from agglo_core.conformance.base.handing_over import environment, subject_from, task_of
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.engine.judging import Result, State, judge, laws_for
from agglo_core.conformance.laws import all_laws, laws_of
from agglo_core.errors import OptionError
from agglo_core.registry.containment import PLUGIN_FAILURES

_STOPS = 2  # number of timeouts after which the remaining laws are skipped
_START = 120.0  # CPU seconds to import the suite and the component, and to compile kernels
_START_ANOTHER = ("same_in_another_process",)  # laws that start a child process themselves

_POLL = 0.1  # wall-clock seconds between two looks at the clock of the child process
_IDLE = 0.02  # a process that used a smaller share of the time limit waits for something that never comes

Listen = Callable[[float], dict[str, Any]]
"""Return the next message of the child process; the argument is the limit in CPU seconds."""


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
    task, results, pending_laws = task_of(subject), list[Result](), list(names)
    for _ in range(_STOPS):
        try:
            # Start a child process; after a timeout or crash the next child continues with the laws left.
            with _other_process({**task, "laws": pending_laws}) as listen:
                listen(_START)
                pending_laws = listen(timeout)["laws"]
                while pending_laws:
                    starting = _START if pending_laws[0] in _START_ANOTHER else 0.0
                    results.append(Result(**listen(timeout + starting)))
                    pending_laws = pending_laws[1:]
            return results
        except _Stopped as stopped:
            results.append(_result(pending_laws[0] if pending_laws else "builds", "FAILS", str(stopped)))
            pending_laws = pending_laws[1:]
            if not pending_laws:
                return results
    return results + [
        _result(name, "not run", "the component had to be stopped twice") for name in pending_laws
    ]


@contextlib.contextmanager
def _other_process(task: Mapping[str, Any]) -> Iterator[Listen]:
    """Start a child process that tests the component described by ``task``.

    Yields a function that returns its messages. The child process is killed at the end.
    """
    command = [sys.executable, "-c", "from agglo_core.conformance.engine.isolation import main; main()"]
    lines: queue.Queue[str] = queue.Queue()
    with tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env=environment(),
        )

        # Wait for a message; silence and a dead process raise _Stopped.
        def next_message(seconds: float, timeout: float) -> dict[str, Any]:
            line = _next_line(lines, child.pid, seconds)
            if line is None:
                remedy = "look for a loop that may not terminate, or allow more time with --timeout"
                raise _Stopped(f"no answer after {timeout:g} CPU seconds: {remedy}")
            if not line:
                errors.seek(0)
                last = (errors.read().strip().splitlines() or ["it left no message"])[-1]
                raise _Stopped(f"the process died (exit code {child.wait()}): {last}")
            message: dict[str, Any] = json.loads(line)
            if "refused" in message:
                raise OptionError(message["refused"])
            return message

        # Return messages, and do not count the time of compilation.
        def listen(seconds: float) -> dict[str, Any]:
            seconds_left = seconds
            while True:
                start = _clock(child.pid)
                message = next_message(seconds_left, seconds)
                if "compiling" not in message:
                    return message
                seconds_left -= _clock(child.pid) - start
                if message["compiling"]:  # compilation is off the clock
                    next_message(_START, _START)

        # Send the task, read messages in a thread, and kill the process at the end.
        with child:
            threading.Thread(target=_read, args=(child.stdout, lines), daemon=True).start()
            try:
                _write(child.stdin, json.dumps(task))
                yield listen
            finally:
                child.kill()


def _write(stream: IO[str] | None, text: str) -> None:
    if stream is not None:
        with contextlib.suppress(BrokenPipeError), stream:  # a dead process: the reader reports it
            stream.write(text)


def _read(stream: IO[str], lines: queue.Queue[str]) -> None:
    """Put each line of a stream into a queue, and an empty string at the end."""
    for line in stream:
        lines.put(line)
    lines.put("")


def _next_line(lines: queue.Queue[str], pid: int, seconds: float) -> str | None:
    """Return the next line of a child process, or None if it uses up its CPU seconds.

    The result is also None if the child waits, with hardly any CPU time, for as many seconds.
    """
    began, started = time.monotonic(), _clock(pid)
    seen, seen_at = started, began
    while True:
        with contextlib.suppress(queue.Empty):
            return lines.get(timeout=_POLL)
        now, used = time.monotonic(), _clock(pid)
        if used - started > seconds:
            return None
        # Waiting for a lock or asleep: hardly any CPU time within one time limit.
        if now - seen_at > max(seconds, _POLL):
            if used - seen < _IDLE * (now - seen_at):
                return None
            seen, seen_at = used, now


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


def main() -> None:
    """Test the component described on stdin, and print each law's result as a line of JSON.

    Other output goes to stderr. The parent counts CPU seconds after the imports, except while numba compiles
    or loads kernels.
    """
    from agglo_core.conformance.engine.compilation import tell_of_compilation

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
        tell_of_compilation(lambda under_way: send_message(compiling=under_way))
        # Select the laws, then judge and report them one by one.
        try:
            laws = {law.name: law for law in laws_for(subject, task["laws"])}
        except OptionError as error:
            send_message(refused=str(error))
            return
        send_message(laws=list(laws))
        for law in laws.values():
            send_message(**asdict(judge(law, subject)))
