"""Notification when kernels are compiled, help by other processes, and the time that compilation takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from subprocess import Popen

from numba.core.event import Listener, install_listener


@contextmanager
def watch_compilation(notify: Callable[[], None], *, ahead: bool = False) -> Iterator[None]:
    """Context in which ``notify`` is called when numba first compiles something.

    Kernels on disk are loaded, not compiled. With ``ahead``, other processes then compile the kernels that a
    run in 2-D needs last, until the context ends. A process that needs a kernel waits for the process that
    compiles it.
    """
    workers: list[Popen[bytes]] = []

    def start() -> None:
        notify()
        if ahead:
            from agglo_core.compiled.ahead_of_time import start_workers

            workers.extend(start_workers())

    try:
        with install_listener("numba:compile", _Once(start)):
            yield
    finally:
        for worker in workers:
            worker.terminate()
        for worker in workers:
            worker.wait()


class _Once(Listener):
    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify, self._started = notify, False

    def on_start(self, event: object) -> None:
        """Handle the start of a compilation, called by numba."""
        if not self._started:
            self._started = True
            self._notify()

    def on_end(self, event: object) -> None:
        """Do nothing at the end of a compilation, called by numba."""


class CompilationTime(Listener):
    """Seconds in which numba compiled or loaded kernels.

    Attributes
    ----------
    seconds, cpu_seconds : float
        Wall time and CPU time.
    """

    def __init__(self) -> None:
        self.seconds, self.cpu_seconds, self._depth = 0.0, 0.0, 0

    def on_start(self, event: object) -> None:
        """Handle the start of a compilation, called by numba."""
        self._depth += 1
        if self._depth == 1:
            self.seconds -= time.perf_counter()
            self.cpu_seconds -= time.process_time()

    def on_end(self, event: object) -> None:
        """Handle the end of a compilation, called by numba. It may be nested in another."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter()
            self.cpu_seconds += time.process_time()


@contextmanager
def compilation_time() -> Iterator[CompilationTime]:
    """Context that measures compilation, so that the first run can be compared with the next."""
    spent = CompilationTime()
    with install_listener("numba:compiler_lock", spent):
        yield spent
