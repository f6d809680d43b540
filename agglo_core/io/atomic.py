"""Files that appear whole or not at all: written in a temporary folder beside them, then renamed.

The folder ``.NAME.agglo-XXXXXXXX`` is locked as long as its process lives. So the next write to the same
place knows what a killed one left behind, whatever became of its process number, and removes it.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from agglo_core.errors import FileError

_log = logging.getLogger("agglo")
_NAME = 60  # bytes of a target's name in that of its folder: file systems allow some 255
_FORGOTTEN = 86_400.0  # seconds after which a folder is nobody's where folders cannot be locked


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """A temporary folder; the files left in it move beside ``path`` when the block ends without error.

    None moves before all are written; if an existing target is not a regular file, none moves
    at all. A symbolic link is followed, an existing file's permissions are kept. Folders that killed
    processes left for the same ``path`` are removed first.

    Files in folders inside move to folders of these names. The others are taken for lists of them: old ones
    are withdrawn before anything moves, so that none ever leads to files of two writings.

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

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.authoring import staging
    >>> with staging(Path("out.txt")) as folder:
    ...     _ = (folder / "out.txt").write_text("whole or not at all")
    >>> Path("out.txt").read_text()
    'whole or not at all'
    """
    with _own_folder(path) as stage, ExitStack() as elsewhere:
        yield stage
        files = sorted(file for file in stage.rglob("*") if file.is_file())
        inner = [file for file in files if file.parent != stage]
        lists = [file for file in files if file.parent == stage]
        with new_folders(path.parent / file.parent.relative_to(stage) for file in inner):
            moves = [
                (file, check_replaceable(path.parent / file.relative_to(stage))) for file in inner + lists
            ]
            ready = [(_beside(target, file, elsewhere), target) for file, target in moves]
            for file, target in ready:
                if target.exists():
                    shutil.copymode(target, file)
            for _, target in ready[len(inner) :] if inner else ():
                target.unlink(missing_ok=True)
            for file, target in ready:
                os.replace(file, target)


@contextmanager
def new_folders(folders: Iterable[Path]) -> Iterator[None]:
    """Make the folders that do not exist; if the block fails, remove those that are still empty."""
    made: list[Path] = []
    try:
        for folder in dict.fromkeys(folders):
            if not folder.exists():
                folder.mkdir()
                made.append(folder)
            elif not folder.is_dir():
                raise FileError(f"{folder}: exists and is not a folder")
        yield
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):  # not empty: files have moved there
                folder.rmdir()
        raise


def check_replaceable(target: Path) -> Path:
    """Return where a file is to be put, after all links.

    Raises
    ------
    FileError
        If something is there that must not be overwritten, its folder is missing or not writable, or links
        lead round in a circle.
    """
    try:
        place = target.resolve()
    except RuntimeError:  # of Python before 3.13, which leaves such links as they are
        place = target
    if place.is_symlink():
        raise FileError(f"{target}: is a symbolic link that leads back to itself")
    if place.exists() and not place.is_file():
        raise FileError(f"{target}: exists and is not a regular file")
    if place.exists() and not os.access(place, os.W_OK):
        raise FileError(f"{target}: exists and is read-only")
    if not place.parent.is_dir():
        raise FileError(f"{target}: is a symbolic link to {place}, whose folder does not exist")
    if not os.access(place.parent, os.W_OK):
        raise FileError(f"{target}: the folder is not writable")
    return place


def _beside(target: Path, file: Path, elsewhere: ExitStack) -> Path:
    """The file, or a copy of it where a link leads to another file system: only there it can be renamed."""
    if file.stat().st_dev == target.parent.stat().st_dev:
        return file
    return Path(shutil.copy(file, elsewhere.enter_context(_own_folder(target)) / target.name))


@contextmanager
def _own_folder(path: Path) -> Iterator[Path]:
    """A new folder beside ``path``, locked; it is removed when the block ends."""
    name = path.name
    while len(os.fsencode(name)) > _NAME:
        name = name[:-1]
    prefix = f".{name}.agglo-"
    _remove_abandoned(path.parent, prefix)
    folder, lock = _new_folder(path.parent, prefix)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _unlock(lock)


def _new_folder(parent: Path, prefix: str) -> tuple[Path, int | None]:
    """A new folder and its lock."""
    while True:  # until one is locked before another write takes it for abandoned
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        try:
            lock = _lock(folder)
        except (BlockingIOError, FileNotFoundError):
            continue
        if folder.exists():
            return folder, lock
        _unlock(lock)


def _remove_abandoned(parent: Path, prefix: str) -> None:
    """Remove the folders whose process has ended; where folders cannot be locked, those of yesterday."""
    pattern = re.compile(re.escape(prefix) + "[a-z0-9_]{8}", re.ASCII)
    try:
        found = [entry for entry in os.scandir(parent) if pattern.fullmatch(entry.name)]
    except PermissionError:  # one may write to a folder without seeing what is in it
        return
    for entry in found:
        try:
            if not entry.is_dir(follow_symlinks=False):
                continue
            age, lock = time.time() - entry.stat(follow_symlinks=False).st_mtime, _lock(Path(entry.path))
        except OSError:  # in use, gone meanwhile, or of another user
            continue
        if lock is not None or age > _FORGOTTEN:
            shutil.rmtree(entry.path, ignore_errors=True)
            _log.info("removed %s, which a run that was killed left behind", entry.path)
        _unlock(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder until :func:`_unlock` or the end of the process; None where that cannot be done.

    Raises
    ------
    BlockingIOError
        If another write has locked it.
    OSError
        If it is gone, or of another user.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:  # some network file systems
        os.close(descriptor)
        return None
    return descriptor


def _unlock(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)
