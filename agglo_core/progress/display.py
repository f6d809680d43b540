"""Progress display: a bar in a terminal, an updated line in a notebook, occasional lines elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from agglo_core.errors import OptionError
from agglo_core.progress.notebook_line import in_notebook, notebook_line
from agglo_core.progress.phases import Listener, Progress

_SECONDS = 10.0
"""Seconds between two lines about one phase."""


@contextmanager
def shown(*, lines: bool = True) -> Iterator[Listener | None]:
    """Yield a progress listener that displays the progress until the context ends.

    The display is a bar on stderr in a terminal, and a line in the cell output in a notebook.

    Parameters
    ----------
    lines : bool
        Elsewhere, write lines to stderr: when a phase begins and ends, and every ten seconds. If False, there
        is no listener elsewhere.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.progress import shown
    >>> with shown(lines=False) as progress:  # nothing here: no terminal, no notebook
    ...     print(agglo.agglomerate(agglo.samples.squares(8), n_parts=4, progress=progress))
    Hierarchy(64 cells -> 4 parts)
    """
    if _on_terminal():
        with _bar() as listen:
            yield listen
    elif in_notebook():
        with notebook_line() as listen:
            yield listen
    else:
        yield _line_listener() if lines else None


@contextmanager
def followed(progress: Listener | None, verbose: bool) -> Iterator[Listener | None]:
    """Yield the progress listener ``progress``, with ``verbose`` combined with a display (:func:`shown`).

    Raises
    ------
    OptionError
        If ``progress`` is not callable.

    Examples
    --------
    >>> from agglo_core.progress import followed
    >>> with followed(None, verbose=False) as listen:
    ...     print(listen)
    None
    """
    if progress is not None and not callable(progress):
        raise OptionError(f"progress must be a function of a Progress, given {progress!r:.60}")
    if not verbose:
        yield progress
        return
    with shown() as show:
        listeners = [listener for listener in (show, progress) if listener is not None]

        def notify_all(report: Progress) -> None:
            for listener in listeners:
                listener(report)

        yield notify_all


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def _line_listener() -> Listener:
    previous, last_time = Progress("", 1.0), 0.0

    def listen(report: Progress) -> None:
        nonlocal previous, last_time
        at_end = 1.0 in (previous.fraction, report.fraction)  # of this phase, or the previous phase
        if at_end or report.phase != previous.phase or time.monotonic() - last_time >= _SECONDS:
            sys.stderr.write(f"agglo: {report.phase} {report.fraction:.0%} {report.text}".rstrip() + "\n")
            last_time = time.monotonic()
        previous = report

    return listen


@contextmanager
def _bar() -> Iterator[Listener]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress as Bar, SpinnerColumn, TaskProgressColumn, TextColumn
    from rich.table import Column

    # Columns: spinner, phase, bar, percentage, details.
    details = TextColumn(
        "{task.fields[text]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")
    )
    name = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True))
    columns = SpinnerColumn(), name, BarColumn(20), TaskProgressColumn(), details
    on_screen = sys.stdout is not None and sys.stdout.isatty()
    bar = Bar(*columns, console=Console(stderr=True), transient=True, redirect_stdout=on_screen)
    task = bar.add_task("", total=1.0, text="")
    last_phase = ""

    def listen(report: Progress) -> None:
        nonlocal last_phase
        bar.start()  # start with the first phase, because an unused bar leaves an empty line
        bar.update(
            task,
            description=report.phase,
            completed=report.fraction,
            text=report.text,
            refresh=report.phase != last_phase,  # later work may block the refresh thread
        )
        last_phase = report.phase

    try:
        yield listen
    finally:
        bar.stop()
