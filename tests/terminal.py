"""Pseudo-terminal of a given width as stdout of this process."""

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
    """Text written to a pseudo-terminal, complete once the terminal is closed."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    @property
    def text(self) -> str:
        """Lines as sent, without the line breaks that a terminal adds to long lines."""
        return self._bytes.decode().replace("\r\n", "\n")

    def read(self, master: int) -> None:
        """Read until the other side is closed."""
        while True:
            try:
                got = os.read(master, 65536)
            except OSError:  # Linux signals the closed side by this error
                return
            if not got:
                return
            self._bytes += got


def set_width(slave: int, width: int) -> None:
    """Set the width of a pseudo-terminal."""
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, width, 0, 0))


@contextmanager
def terminal(monkeypatch: pytest.MonkeyPatch, width: int) -> Iterator[Screen]:
    """Replace stdout of this process by a terminal with ``width`` columns."""
    master, slave = pty.openpty()
    set_width(slave, width)
    screen = Screen()
    reader = Thread(target=screen.read, args=(master,))
    reader.start()
    with monkeypatch.context() as patch, open(slave, "w", encoding="utf-8") as stdout:
        for name in ("COLUMNS", "LINES"):
            patch.delenv(name, raising=False)
        patch.setattr(sys, "stdout", stdout)
        patch.setattr(sys, "__stdout__", stdout)  # shutil reads its size
        yield screen
    reader.join()
    os.close(master)
