"""Wall and CPU time per solve phase."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Sum of wall and CPU time per phase.

    Attributes
    ----------
    wall, cpu : dict
        Seconds per phase: wall time, and CPU time over all threads in this process.

    Examples
    --------
    >>> from agglo_core.solvers.stopwatch import Stopwatch
    >>> watch = Stopwatch()
    >>> with watch("assemble"):
    ...     pass
    >>> list(watch.wall), watch.cpu["assemble"] >= 0.0
    (['assemble'], True)
    """

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self.cpu: dict[str, float] = {}

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        """Time the body of a ``with`` statement, even if it raises an exception."""
        start, cpu_start = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.wall[phase] = self.wall.get(phase, 0.0) + time.perf_counter() - start
            self.cpu[phase] = self.cpu.get(phase, 0.0) + time.process_time() - cpu_start
