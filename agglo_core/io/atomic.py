"""Write files atomically: into a temporary folder beside the target, then by renaming.

The folder ``.NAME.agglo-XXXXXXXX`` is locked while its process lives. The next write to the same path can
thus identify and remove folders left by killed processes, independent of process numbers.
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
_NAME = 60  # bytes of the target's name in the folder name: file systems allow about 255
_FORGOTTEN = 86_400.0  # seconds until an unlockable folder counts as abandoned


@contextmanager
def staging(path: Path) -> Iterator[Path]:
    """Yield a temporary folder for new files, which replace the old files together at the end.

    Its files move beside ``path`` when the block ends without error.

    No file moves before all are written, and none at all if an existing target is not a regular file.
    Symbolic links are followed, permissions of existing files are kept. Folders left for the same ``path`` by
    killed processes are removed first.

    Files in subfolders move to subfolders of the same name. Files at the top are treated as indices of
    them: their old versions are removed before any file moves, so that an index never refers to a mixture of
    old and new files.

    Yields
    ------
    Path
        Folder for the new files, under their final names.

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
        # Files in subfolders come first, the indices that refer to them last.
        files = sorted(file for file in stage.rglob("*") if file.is_file())
        inner = [file for file in files if file.parent != stage]
        lists = [file for file in files if file.parent == stage]
        with new_folders(path.parent / file.parent.relative_to(stage) for file in inner):
            moves = [
                (file, check_replaceable(path.parent / file.relative_to(stage))) for file in inner + lists
            ]
            # Copy across file systems before the first target changes.
            replacements = [(_bring_beside(target, file, elsewhere), target) for file, target in moves]
            for file, target in replacements:
                if target.exists():
                    shutil.copymode(target, file)
            # Remove old indices, then rename everything.
            for _, target in replacements[len(inner) :] if inner else ():
                target.unlink(missing_ok=True)
            for file, target in replacements:
                os.replace(file, target)


@contextmanager
def new_folders(folders: Iterable[Path]) -> Iterator[None]:
    """Create missing folders for files that the ``with`` block moves into them.

    If the block fails, remove the new folders that are still empty.
    """
    new_paths: list[Path] = []
    try:
        for folder in dict.fromkeys(folders):
            if not folder.exists():
                folder.mkdir()
                new_paths.append(folder)
            elif not folder.is_dir():
                raise FileError(f"{folder}: exists and is not a folder")
        yield
    except BaseException:
        for folder in reversed(new_paths):
            with suppress(OSError):  # not empty: files have moved there
                folder.rmdir()
        raise


def check_replaceable(target: Path) -> Path:
    """Return the file to which a path leads through symbolic links, if it can be created or replaced.

    Raises
    ------
    FileError
        If something there must not be overwritten, the folder is missing or read-only, or links form a
        cycle.
    """
    try:
        place = target.resolve()
    except RuntimeError:  # Python before 3.13 (later versions return such links unchanged)
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


def _bring_beside(target: Path, file: Path, elsewhere: ExitStack) -> Path:
    """Return the file, or its copy beside the target if the target lies on another file system.

    A file can only be renamed within its file system.
    """
    if file.stat().st_dev == target.parent.stat().st_dev:
        return file
    return Path(shutil.copy(file, elsewhere.enter_context(_own_folder(target)) / target.name))


@contextmanager
def _own_folder(path: Path) -> Iterator[Path]:
    """Yield a new locked temporary folder beside ``path`` and remove it when the block ends."""
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
    """Create a temporary folder in ``parent`` and lock it."""
    while True:  # retry if another write removed the folder before the lock
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        try:
            lock = _lock(folder)
        except (BlockingIOError, FileNotFoundError):
            continue
        if folder.exists():
            return folder, lock
        _unlock(lock)


def _remove_abandoned(parent: Path, prefix: str) -> None:
    """Remove temporary folders left by processes that have ended.

    Without locks, remove folders older than a day.
    """
    pattern = re.compile(re.escape(prefix) + "[a-z0-9_]{8}", re.ASCII)
    try:
        entries = [entry for entry in os.scandir(parent) if pattern.fullmatch(entry.name)]
    except PermissionError:  # a writable folder need not be readable
        return
    for entry in entries:
        try:
            if not entry.is_dir(follow_symlinks=False):
                continue
            age, lock = time.time() - entry.stat(follow_symlinks=False).st_mtime, _lock(Path(entry.path))
        except OSError:  # in use, gone meanwhile, or of another user
            continue
        if lock is not None or age > _FORGOTTEN:
            shutil.rmtree(entry.path, ignore_errors=True)
            _log.info("removed %s, left behind by a run that was killed", entry.path)
        _unlock(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder against other processes until :func:`_unlock` or the end of this process.

    Return None if locks are unavailable.

    Raises
    ------
    BlockingIOError
        If another write has locked it.
    OSError
        If it is gone or belongs to another user.
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
