"""Seconds of the phases of a solve, and the listener told of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from agglo_core.authoring import Listener, phase


class PhaseTimes:
    """Times phases and announces them.

    Attributes
    ----------
    wall, cpu : dict
        Seconds by phase: of the clock, of all threads of this process.
    """

    def __init__(self, listener: Listener | None) -> None:
        self._listener = listener
        self.wall: dict[str, float] = {}
        self.cpu: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str, text: str) -> Iterator[None]:
        """Time what happens inside, whatever it raises."""
        start, used = time.perf_counter(), time.process_time()
        try:
            with phase(self._listener, text):
                yield
        finally:
            self.wall[name] = self.wall.get(name, 0.0) + time.perf_counter() - start
            self.cpu[name] = self.cpu.get(name, 0.0) + time.process_time() - used
