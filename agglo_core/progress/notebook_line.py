"""Progress display in notebooks: one line in the cell output, updated during the computation."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from agglo_core.progress.phases import Listener, Progress

_WIDTH = 20
_PAUSE = 0.1
"""Minimum number of seconds between two updates within a phase, because updates travel to a browser."""


def in_notebook() -> bool:
    """Return True in a notebook, that is, in a process started as an IPython kernel."""
    return type(sys.stderr).__module__.partition(".")[0] == "ipykernel"


@contextmanager
def notebook_line() -> Iterator[Listener]:
    """Yield a listener that displays progress in one line, in the end the phases and the total time.

    After an error the line is unchanged and shows the progress up to the error.
    """
    display: Any = import_module("IPython.display").display
    start, handle, previous, last_time = time.monotonic(), None, Progress("", 0.0), 0.0
    phases: dict[str, None] = {}

    def listen(report: Progress) -> None:
        nonlocal handle, previous, last_time
        phases.setdefault(report.phase)
        if report.phase != previous.phase or time.monotonic() - last_time >= _PAUSE:
            if handle is None:
                handle = display(_plain(_bar(report)), raw=True, display_id=True)
            else:
                handle.update(_plain(_bar(report)), raw=True)
            last_time = time.monotonic()
        previous = report

    yield listen
    if handle is not None:
        handle.update(_plain(f"{', '.join(phases)}: {time.monotonic() - start:.1f} s"), raw=True)


def _bar(report: Progress) -> str:
    n_blocks = round(_WIDTH * report.fraction)
    return (
        f"{'█' * n_blocks}{'░' * (_WIDTH - n_blocks)} {report.fraction:4.0%} {report.phase} {report.text}"
    ).rstrip()


def _plain(text: str) -> dict[str, Any]:
    return {"text/plain": text}
