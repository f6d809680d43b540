"""Read regular files only, because reading from pipes and devices may never end."""

from __future__ import annotations

import codecs
from pathlib import Path

from agglo_core.errors import FileError


def check_regular(path: Path) -> None:
    """Raise FileError unless a path leads to a regular file."""
    if path.is_file():
        return
    if path.is_dir():
        raise FileError("is a folder")
    raise FileError("is not a regular file" if path.exists() else "no such file")


def file_bytes(path: Path) -> bytes:
    """Return the content of a regular file. Raises FileError or OSError."""
    check_regular(path)
    return path.read_bytes()


def text_bytes(path: Path) -> bytes:
    """Return the content of a regular file without a UTF-8 byte order mark. Raises FileError or OSError."""
    return strip_mark(file_bytes(path))


def whole_text(path: Path) -> bytes:
    """Return the content of a text file as :func:`text_bytes`, and check that its last line is complete.

    The last number of a file without a final line break may be a part of a longer one.

    Raises
    ------
    FileError
        With the number of the last line, if the line does not end.
    """
    content = text_bytes(path)
    check_last_line(content)
    return content


def check_last_line(content: bytes) -> None:
    """Raise FileError if a non-empty text does not end with a line break."""
    if content and not content.endswith((b"\n", b"\r")):
        line = content.count(b"\n") + 1
        raise FileError(
            f"line {line}: the last line has no line break, so the file may be truncated; "
            "add a line break if it is complete"
        )


def strip_mark(content: bytes) -> bytes:
    """Remove a UTF-8 byte order mark from the beginning of a text."""
    return content.removeprefix(codecs.BOM_UTF8)
