"""Notice when numba compiles or loads kernels: that time is not charged to a component."""

from __future__ import annotations

from collections.abc import Callable

from numba.core.event import Listener, register


def tell_of_compilation(say: Callable[[bool], None]) -> None:
    """Call ``say(True)`` when numba begins to compile or load kernels, ``say(False)`` when it has done so."""
    register("numba:compiler_lock", _Compilation(say))  # type: ignore[no-untyped-call]


class _Compilation(Listener):
    def __init__(self, say: Callable[[bool], None]) -> None:
        self.say, self.depth = say, 0

    def on_start(self, event: object) -> None:
        """Called by numba, inside other such calls too."""
        self.depth += 1
        if self.depth == 1:
            self.say(True)

    def on_end(self, event: object) -> None:
        """Called by numba."""
        self.depth -= 1
        if self.depth == 0:
            self.say(False)
