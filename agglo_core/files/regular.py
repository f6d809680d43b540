"""Content of files that are there as a whole: pipes and devices may never end."""

from __future__ import annotations

import codecs
from pathlib import Path

from agglo_core.errors import FileError


def check_regular(path: Path) -> None:
    """Raise FileError unless a path, or what its links lead to, is a regular file."""
    if path.is_file():
        return
    if path.is_dir():
        raise FileError("is a folder")
    raise FileError("is not a regular file" if path.exists() else "no such file")


def file_bytes(path: Path) -> bytes:
    """Content of a regular file; raises FileError or OSError."""
    check_regular(path)
    return path.read_bytes()


def text_bytes(path: Path) -> bytes:
    """Content of a regular file without a UTF-8 byte order mark; raises FileError or OSError."""
    return without_mark(file_bytes(path))


def without_mark(content: bytes) -> bytes:
    """Text without the byte order mark that it may begin with."""
    return content.removeprefix(codecs.BOM_UTF8)
