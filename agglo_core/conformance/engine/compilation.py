"""Report when numba compiles or loads kernels, so that time limits exclude compilation."""

from __future__ import annotations

from collections.abc import Callable

from numba.core.event import Listener, register


def tell_of_compilation(say: Callable[[bool], None]) -> None:
    """Call a function with True when numba starts to compile, and with False when numba is done.

    Loading cached kernels counts as well.
    """
    register("numba:compiler_lock", _Compilation(say))  # type: ignore[no-untyped-call]


class _Compilation(Listener):
    def __init__(self, say: Callable[[bool], None]) -> None:
        self.say, self.depth = say, 0

    def on_start(self, event: object) -> None:
        """Count the start of a compilation, and report it unless it is nested in another."""
        self.depth += 1
        if self.depth == 1:
            self.say(True)

    def on_end(self, event: object) -> None:
        """Count the end of a compilation, and report it unless it is nested in another."""
        self.depth -= 1
        if self.depth == 0:
            self.say(False)
