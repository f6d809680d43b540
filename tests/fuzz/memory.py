"""How much memory reading a file takes: of this process, file by file, and of those it starts."""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path

__all__ = ["ALLOWED", "Memory", "restrict"]

ALLOWED = 200 << 20
"""Bytes beyond what valid files take."""

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Memory:
    """The largest memory in use since :meth:`watch`, beyond that at the start; bytes."""

    def __init__(self) -> None:
        self.watch()
        self._own, self._others = _resident("VmRSS"), _of_children()

    def watch(self) -> None:
        """Begin a new peak, where the system can; elsewhere it is that of the whole process."""
        with suppress(OSError):
            _CLEAR.write_text("5")
        self._before = _resident("VmRSS"), _of_children()

    def growth(self) -> int:
        """The peak of this process beyond what it was at the start, or of a child that is the largest so far.

        A copy of this process begins with what this process has.
        """
        grown = max(_resident("VmHWM") - self._own, 0)
        own, others = self._before
        if (child := _of_children()) > others:
            grown = max(grown, child - max(own, self._others))
        return grown


def restrict(more: int = 4 << 30) -> None:
    """Let this process have no more than so much address space besides: a bomb must not reach the machine."""
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
