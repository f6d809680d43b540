"""File locks with which only one of several processes compiles a kernel, and the others load it."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: every process compiles what it needs
    fcntl = None  # type: ignore[assignment]

# Seconds to wait for another process, which may be suspended. The slowest kernel takes about 20 s to compile
# on an idle core (benchmarks/first_run.py).
_PATIENCE = 300.0
_INTERVAL = 0.02  # seconds between two attempts

_held: dict[Path, int] = {}  # file descriptors of the locks of this process


def acquire(file: Path) -> None:
    """Lock a file, after waiting for the process that holds the lock, for at most five minutes.

    Nothing is locked where the file cannot be created, on file systems without locks, and if the other
    process takes more than five minutes. Then several processes compile a kernel, with the same result.
    """
    release(file)  # left behind by a compilation that failed
    if fcntl is None:
        return
    try:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return
    ends = time.monotonic() + _PATIENCE
    while time.monotonic() < ends:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_INTERVAL)
        except OSError:  # no locks on this file system
            with suppress(OSError):
                file.unlink()
            break
        else:
            _held[file] = descriptor
            return
    os.close(descriptor)


def release(file: Path) -> None:
    """Unlock and remove a file that :func:`acquire` has locked."""
    descriptor = _held.pop(file, None)
    if descriptor is not None:
        with suppress(OSError):  # the folder may have been removed or write-protected meanwhile
            file.unlink()
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # forked processes may share the descriptor
        os.close(descriptor)


def release_all() -> None:
    """Release all locks of this process, after a compilation has failed."""
    for file in list(_held):
        release(file)
