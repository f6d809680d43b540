"""Files that appear whole or not at all: written in a temporary folder beside them, then renamed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agglo_core.errors import FileError

__all__ = ["check_replaceable", "staging"]


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """A temporary folder; the files left in it move beside ``path`` when the block ends without error.

    None moves before all are written; if an existing target is not a regular file, none moves
    at all. A symbolic link is followed, an existing file's permissions are kept.

    Yields
    ------
    Path
        The folder to write in, under the final file names.

    Raises
    ------
    FileError
        If a file cannot be put in place.
    OSError
        If the folder cannot be written to.
    """
    folder = path.parent
    stage = Path(tempfile.mkdtemp(prefix=f".{path.name[:60]}.", dir=folder))
    try:
        yield stage
        written = sorted(file for file in stage.iterdir())
        moves = [(file, (folder / file.name).resolve()) for file in written]
        for _, target in moves:
            check_replaceable(target)
        for file, target in moves:
            if target.exists():
                shutil.copymode(target, file)
            _move(file, target)
    finally:
        shutil.rmtree(stage, ignore_errors=True)


def check_replaceable(target: Path) -> None:
    """Raise FileError if something stands at ``target`` that must not be overwritten."""
    if target.exists() and not target.is_file():
        raise FileError(f"{target}: exists and is not a regular file")
    if target.exists() and not os.access(target, os.W_OK):
        raise FileError(f"{target}: exists and is read-only")
    if not os.access(target.resolve().parent, os.W_OK):
        raise FileError(f"{target}: the folder is not writable")


def _move(file: Path, target: Path) -> None:
    """Rename, through a second temporary file where a link leads to another file system."""
    if file.stat().st_dev == target.parent.stat().st_dev:
        os.replace(file, target)
        return
    near = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        shutil.copy(file, near)
        os.replace(near, target)
    finally:
        near.unlink(missing_ok=True)
