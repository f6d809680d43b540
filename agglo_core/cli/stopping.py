"""Ctrl-C and SIGTERM: both unwind the program, so that no temporary folder stays behind."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(KeyboardInterrupt):
    """SIGTERM; like Ctrl-C not the failure of a plugin, for which a SystemExit of 143 would be taken."""


@contextmanager
def terminations() -> Iterator[None]:
    """Raise Terminated on SIGTERM for as long as the context lasts, unless someone else handles it."""
    own = threading.current_thread() is threading.main_thread()
    if not own or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def stopped_by(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interrupt an error goes back to, if any: within a kernel it comes out as a SystemError."""
    seen = list[BaseException]()  # errors of plugins may go back to one another
    while error is not None and not isinstance(error, KeyboardInterrupt):
        if error in seen:
            return None
        seen.append(error)
        error = error.__cause__ or error.__context__
    return error
