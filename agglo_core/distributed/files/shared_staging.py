"""Temporary folder shared by all ranks, whose files appear complete or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from agglo_core.distributed.communication import RankError, Ranks
from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_core.io.file_checks import name_in_errors


@contextmanager
def shared_staging(path: Path, ranks: Ranks) -> Iterator[Path]:
    """Provide a temporary folder for all ranks, whose files rank 0 moves to ``path`` if no rank fails.

    In the body, ranks must write within :meth:`Ranks.together`, so that it fails on all ranks or none.

    Yields
    ------
    Path
        Folder for the files.

    Raises
    ------
    FileError
        If a file cannot be moved, or a rank does not see the folder that rank 0 has made (RankError on
        the other ranks).
    """
    with ExitStack() as stages:
        own_folder = None
        with ranks.together(), name_in_errors(path):
            if ranks.rank == 0:
                own_folder = stages.enter_context(staging(path))
        folder: Path = ranks.from_first(own_folder)  # type: ignore[assignment]
        with ranks.together(), name_in_errors(path):
            if not folder.is_dir():
                raise FileError(
                    "this rank does not see the folder that rank 0 created: all ranks must "
                    "write to one file system"
                )
        if ranks.rank > 0:
            stages.enter_context(_remove_if_interrupted(folder))
        yield folder
        with ranks.together(), name_in_errors(path):
            stages.close()


@contextmanager
def _remove_if_interrupted(folder: Path) -> Iterator[None]:
    """Remove the temporary folder if this rank is interrupted, because rank 0 may wait for this rank."""
    try:
        yield
    except RankError:  # rank 0 removes the folder
        raise
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
