"""Clean end on Ctrl-C and SIGTERM: both raise an exception, so that temporary folders are removed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(KeyboardInterrupt):
    """Exception raised on SIGTERM.

    Like Ctrl-C, and unlike SystemExit, it is not mistaken for the failure of a plugin.
    """


@contextmanager
def terminations() -> Iterator[None]:
    """Raise Terminated on SIGTERM within the context, unless SIGTERM already has a handler."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def find_interrupt(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interrupt (Ctrl-C) that caused an error, or None if it has another cause.

    In kernels an interrupt becomes a SystemError.
    """
    chain = list[BaseException]()  # plugin errors may form a cycle
    while error is not None and not isinstance(error, KeyboardInterrupt):
        if error in chain:
            return None
        chain.append(error)
        error = error.__cause__ or error.__context__
    return error
