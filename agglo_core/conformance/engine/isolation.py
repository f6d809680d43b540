"""Laws in another process, so that a component that hangs or crashes can be stopped and named."""

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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import IO, Any

from agglo_core.conformance.base.handing_over import environment, subject_from, task_of
from agglo_core.conformance.base.own_components import own_components
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.engine.judging import Result, judge, laws_for
from agglo_core.conformance.laws import all_laws, laws_of
from agglo_core.errors import OptionError
from agglo_core.registry.containment import PLUGIN_FAILURES

_STOPS = 2  # laws that may time out before the rest is skipped
_START = 120.0  # seconds for a new process to import the suite and the component, and for numba to compile
_START_ANOTHER = ("same_in_another_process",)  # laws that start a process themselves

Listen = Callable[[float], dict[str, Any]]
"""Returns the next message of the other process; the argument is the timeout in seconds."""


class _Stopped(Exception):
    """The other process hung or died; the message says how."""


def judge_apart(subject: Subject, timeout: float) -> list[Result]:
    """Results of all laws, each stopped after ``timeout`` seconds; after two such the rest is not run.

    Raises
    ------
    OptionError
        If the component is an object, which no other process can have, or needs an option.
    """
    task, results, left = task_of(subject), list[Result](), list[str]()
    for _ in range(_STOPS):
        try:
            with _other_process({**task, "laws": left}) as listen:
                listen(_START)
                left = listen(timeout)["laws"]
                while left:
                    starting = _START if left[0] in _START_ANOTHER else 0.0
                    results.append(Result(**listen(timeout + starting)))
                    left = left[1:]
            return results
        except _Stopped as stopped:
            results.append(_failed(left[0] if left else "builds", str(stopped)))
            left = left[1:]
            if not left:
                return results
    return results + [_failed(name, "not run: the component had to be stopped twice") for name in left]


@contextlib.contextmanager
def _other_process(task: Mapping[str, Any]) -> Iterator[Listen]:
    """A process that judges ``task``, as a function that gives its messages; killed at the end."""
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

        def next_message(seconds: float, allowed: float) -> dict[str, Any]:
            try:
                line = lines.get(timeout=max(seconds, 0.0))
            except queue.Empty:
                remedy = "look for a loop that need not end, or allow more time with --timeout"
                raise _Stopped(f"no answer after {allowed:g} seconds: {remedy}") from None
            if not line:
                errors.seek(0)
                last = (errors.read().strip().splitlines() or ["it left no message"])[-1]
                raise _Stopped(f"the process died (exit code {child.wait()}): {last}")
            said: dict[str, Any] = json.loads(line)
            if "refused" in said:
                raise OptionError(said["refused"])
            return said

        def listen(seconds: float) -> dict[str, Any]:
            left = seconds
            while True:
                start = time.monotonic()
                said = next_message(left, seconds)
                if "compiling" not in said:
                    return said
                left -= time.monotonic() - start
                if said["compiling"]:  # off the clock, to the message that it is done
                    next_message(_START, _START)

        with child:
            threading.Thread(target=_read, args=(child.stdout, lines), daemon=True).start()
            try:
                _write(child.stdin, json.dumps(task))
                yield listen
            finally:
                child.kill()


def _write(stream: IO[str] | None, text: str) -> None:
    if stream is not None:
        with contextlib.suppress(BrokenPipeError), stream:  # it died at once: the reader notices
            stream.write(text)


def _read(stream: IO[str], lines: queue.Queue[str]) -> None:
    """Hand on each line; an empty one after the last."""
    for line in stream:
        lines.put(line)
    lines.put("")


def _failed(name: str, message: str) -> Result:
    law = next(law for law in all_laws() if law.name == name)
    return Result(law.name, law.sentence, False, message, 0.0, law.promise)


def main() -> None:
    """Judge what stdin describes, one JSON line for each law; whatever else is printed goes to stderr.

    The clock of the one who listens starts when the component and what the suite needs are imported, and
    stands still while numba compiles or loads kernels.
    """
    from agglo_core.conformance.engine.compilation import tell_of_compilation

    with os.fdopen(os.dup(1), "w") as out:
        os.dup2(2, 1)
        lock = threading.Lock()

        def say(**said: Any) -> None:
            with lock:
                out.write(json.dumps(said) + "\n")
                out.flush()

        task = json.loads(sys.stdin.read())
        laws_of(task["kind"])
        subject = subject_from(task)
        with contextlib.suppress(*PLUGIN_FAILURES):  # the law builds says why
            _ = subject.target
        own_components().build("bisector", "inertial")
        say(ready=True)
        tell_of_compilation(lambda under_way: say(compiling=under_way))
        try:
            laws = {law.name: law for law in laws_for(subject)}
        except OptionError as error:
            say(refused=str(error))
            return
        say(laws=task["laws"] or list(laws))
        for name in task["laws"] or laws:
            say(**asdict(judge(laws[name], subject)))
