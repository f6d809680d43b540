"""Measure the memory needed to read a file, in this process and in child processes."""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path

__all__ = ["ALLOWED", "Memory", "restrict"]

ALLOWED = 200 << 20
"""Bytes allowed beyond the memory for valid files."""

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Memory:
    """Peak memory since :meth:`watch` in bytes, beyond the memory at the start."""

    def __init__(self) -> None:
        self.watch()
        self._own, self._others = _resident("VmRSS"), _of_children()

    def watch(self) -> None:
        """Start a new peak, if the system supports this.

        Otherwise the peak covers the whole process.
        """
        with suppress(OSError):
            _CLEAR.write_text("5")
        self._before = _resident("VmRSS"), _of_children()

    def growth(self) -> int:
        """Return the peak of this process beyond its start, or of a child process with a new maximum.

        A fork starts with the memory of this process.
        """
        grown = max(_resident("VmHWM") - self._own, 0)
        own, others = self._before
        if (child := _of_children()) > others:
            grown = max(grown, child - max(own, self._others))
        return grown


def restrict(more: int = 4 << 30) -> None:
    """Limit the address space of this process to ``more`` bytes beyond its present size, because of the
    bombs.
    """
    with suppress(OSError, ValueError):
        limit = _resident("VmSize") + more
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _resident(key: str) -> int:
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    return next(int(line.split()[1]) << 10 for line in lines if line.startswith(key))


def _of_children() -> int:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10
