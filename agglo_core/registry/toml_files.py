"""Reader for TOML files that configure runs and problems, with bounded memory.

Every failure is a FileError.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from agglo_core.errors import FileError
from agglo_core.files.regular import check_regular

_SIZE = 1 << 21
"""Maximum file size in bytes; tomllib needs up to a hundred times as much memory."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file as a dict.

    A byte order mark is ignored.

    Raises
    ------
    FileError
        With the file name, for a file that does not exist, cannot be read, is too large, or is not TOML.
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
    except ValueError:  # tomllib has no separate error class for this
        raise FileError(f"{path}: a number has too many digits") from None


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
        raise FileError(
            f"{path}: byte 0x{byte:02x} in line {line} is not UTF-8, as required by TOML"
        ) from None


def _show_integers(value: Any) -> None:
    """Raise ValueError for an integer with more digits than Python converts to text.

    The TOML parser does not limit hexadecimal integers.
    """
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            _show_integers(item)
    elif isinstance(value, int):
        str(value)
