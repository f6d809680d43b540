"""Notification when kernels are compiled, which takes longer than most runs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

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
