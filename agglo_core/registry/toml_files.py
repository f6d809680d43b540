"""TOML files of runs and problems, read in bounded memory; every failure is a FileError."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from agglo_core.errors import FileError
from agglo_core.files.regular import check_regular

_SIZE = 1 << 21
"""Bytes of a file: tomllib takes up to a hundred times as much memory."""


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; a byte order mark is passed over.

    Raises
    ------
    FileError
        If there is no such file, it cannot be read, it is too large, or it is not TOML; names the file.
    """
    text = _text(path)
    try:
        table = tomllib.loads(text)
        _show_integers(table)
        return table
    except RecursionError:
        raise FileError(f"{path}: its lists or tables are nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path}: is not valid TOML: {error}") from None
    except ValueError:  # tomllib has no error of its own for this one
        raise FileError(f"{path}: a number in it has too many digits") from None


def _text(path: Path) -> str:
    try:
        check_regular(path)
        size = path.stat().st_size
        if size > _SIZE:
            raise FileError(f"has {size} bytes, more than {_SIZE}")
        return path.read_text(encoding="utf-8-sig")
    except FileError as error:
        raise FileError(f"{path}: {error}; expected a TOML file") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        line = error.object.count(b"\n", 0, error.start) + 1
        raise FileError(f"{path}: byte 0x{byte:02x} in line {line} is not UTF-8, as TOML must be") from None


def _show_integers(value: Any) -> None:
    """Raise ValueError for an integer that messages could not show: hexadecimal ones are not limited."""
    if isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            _show_integers(each)
    elif isinstance(value, int):
        str(value)
