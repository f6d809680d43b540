"""Notification when kernels are compiled, which takes longer than most runs, and the time that it takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from numba.core.event import Listener, install_listener


def watch_compilation(tell: Callable[[], None]) -> AbstractContextManager[None]:
    """Context in which the callback is called when numba first compiles something.

    Kernels on disk are loaded, not compiled.
    """
    watch: AbstractContextManager[None] = install_listener("numba:compile", _Once(tell))
    return watch


class _Once(Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell, self._told = tell, False

    def on_start(self, event: object) -> None:
        """Handle the start of a compilation, called by numba."""
        if not self._told:
            self._told = True
            self._tell()

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
