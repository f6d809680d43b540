"""A pseudo-terminal of a given width as stdout of this process, and what a person would see on it."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import pytest

__all__ = ["Screen", "set_width", "terminal"]


class Screen:
    """What was written to a pseudo-terminal, once it is closed."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    @property
    def text(self) -> str:
        """Lines as they were sent: a terminal would break those that are wider than it."""
        return self._bytes.decode().replace("\r\n", "\n")

    def read(self, master: int) -> None:
        """Take what comes until the other side is closed."""
        while True:
            try:
                got = os.read(master, 65536)
            except OSError:  # how Linux says that nobody writes any more
                return
            if not got:
                return
            self._bytes += got


def set_width(slave: int, width: int) -> None:
    """Make a pseudo-terminal that wide."""
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, width, 0, 0))


@contextmanager
def terminal(monkeypatch: pytest.MonkeyPatch, width: int) -> Iterator[Screen]:
    """For as long as the context lasts, stdout of this process is a terminal ``width`` columns wide."""
    master, slave = pty.openpty()
    set_width(slave, width)
    screen = Screen()
    reader = Thread(target=screen.read, args=(master,))
    reader.start()
    with monkeypatch.context() as patch, open(slave, "w", encoding="utf-8") as stdout:
        for name in ("COLUMNS", "LINES"):
            patch.delenv(name, raising=False)
        patch.setattr(sys, "stdout", stdout)
        patch.setattr(sys, "__stdout__", stdout)  # whose size shutil asks for
        yield screen
    reader.join()
    os.close(master)
