"""Reading TOML files: of a run, of a problem. Every way in which that fails is an error in words."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from agglo_core.errors import FileError
from agglo_core.files import check_regular

__all__ = ["read_toml"]


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; a byte order mark is passed over.

    Raises
    ------
    FileError
        If there is no such file, it cannot be read, or it is not TOML; names the file.
    """
    try:
        check_regular(path)
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileError as error:
        raise FileError(f"{path}: {error}; expected a TOML file") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        line = error.object.count(b"\n", 0, error.start) + 1
        raise FileError(f"{path}: byte 0x{byte:02x} in line {line} is not UTF-8, as TOML must be") from None
    except RecursionError:
        raise FileError(f"{path}: its lists or tables are nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path}: is not valid TOML: {error}") from None
    except ValueError:  # tomllib has no error of its own for this one
        raise FileError(f"{path}: a number in it has too many digits") from None
