"""Phases of a computation, and listeners: functions that receive its progress.

Only the phase itself has state.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

_PAUSE = 0.05
"""Minimum number of seconds between two reports of a phase, so that listeners cost nothing."""


@dataclass(frozen=True, slots=True)
class Progress:
    """One report on a computation: the current phase, and its completed share.

    Attributes
    ----------
    phase : str
        Current activity: ``"agglomerating"``, ``"measuring"``, ``"writing"``, ….
    fraction : float
        Completed share of the phase: 0 at the beginning, 1 at the end, non-decreasing.
    text : str
        Details, such as the piece count, a metric or a file.

    Examples
    --------
    >>> heard = []
    >>> hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=4, progress=heard.append)
    >>> heard[0]
    Progress(phase='building the graph', fraction=0.0, text='')
    """

    phase: str
    fraction: float
    text: str = ""


Listener = Callable[[Progress], None]
"""Function called with the progress, in the thread of the computation; its exceptions end the computation."""


class Notify(Protocol):
    """Function by which a phase reports its completed share.

    Examples
    --------
    >>> from agglo_core.progress import Notify
    >>> class Printed:
    ...     def __call__(self, fraction, text=""):
    ...         print(f"{fraction:.0%} {text}")
    >>> notify: Notify = Printed()
    >>> notify(0.5, "faces")
    50% faces
    """

    def __call__(self, fraction: float, text: str = "") -> None:
        """Report the completed share, from 0 to 1, and details."""


@contextmanager
def phase(listen: Listener | None, name: str, text: str = "") -> Iterator[Notify]:
    """Run the body as a phase of a computation: report 0 at the start, and 1 at the end without error.

    Parameters
    ----------
    listen : callable, optional
        Without listener nothing happens.
    name, text : str
        See :class:`Progress`; the text is used at the beginning, and for reports without text.

    Yields
    ------
    callable
        ``notify(fraction, text)``. It may be called arbitrarily often: at most 20 reports a second reach the
        listener, with non-decreasing fractions.

    Examples
    --------
    >>> with phase(print, "counting") as notify:
    ...     notify(0.5, "half")
    Progress(phase='counting', fraction=0.0, text='')
    Progress(phase='counting', fraction=0.5, text='half')
    Progress(phase='counting', fraction=1.0, text='half')
    """
    if listen is None:
        yield ignore_progress
        return
    report = Progress(name, 0.0, text)
    listen(report)
    last_time = float("-inf")  # always report the first step, which may take long

    def notify(fraction: float, text: str = "") -> None:
        nonlocal report, last_time
        report = Progress(name, max(report.fraction, min(fraction, 1.0)), text or report.text)
        if time.monotonic() - last_time >= _PAUSE:
            listen(report)
            last_time = time.monotonic()

    yield notify
    listen(replace(report, fraction=1.0))


def ignore_progress(fraction: float, text: str = "") -> None:
    """Do nothing: the report function if there is no listener.

    Examples
    --------
    >>> from agglo_core.progress import ignore_progress
    >>> ignore_progress(0.5, "half done")
    """


def part(notify: Notify, place: int, count: int, label: str = "") -> Notify:
    """Begin part ``place`` of ``count`` equal parts of a phase, and return its report function.

    Examples
    --------
    >>> from agglo_core.progress import part, phase
    >>> def listen(now):
    ...     print(f"{now.fraction:.2f} {now.text}".strip())
    >>> with phase(listen, "reading") as notify:
    ...     second = part(notify, 1, 2, "faces")
    ...     second(0.5)
    0.00
    0.50 faces
    1.00 faces
    """

    def notify_part(fraction: float, text: str = "") -> None:
        notify((place + min(fraction, 1.0)) / count, ": ".join(filter(None, (label, text))))

    notify_part(0.0)
    return notify_part


def labelled(listen: Listener | None, label: str) -> Listener | None:
    """Return a listener that puts ``label`` before the text of each report, such as the run or level.

    Examples
    --------
    >>> from agglo_core.progress import labelled, phase
    >>> def listen(now):
    ...     print(now.fraction, now.text)
    >>> with phase(labelled(listen, "kmeans"), "drawing"):
    ...     pass
    0.0 kmeans
    1.0 kmeans
    """
    if listen is None or not label:
        return listen
    return lambda report: listen(replace(report, text=f"{label}: {report.text}" if report.text else label))


class _Stopped(BaseException):
    """Internal exception that ends the block of :func:`unwrapped` after an exception of the listener.

    It never leaves the block.
    """


@contextmanager
def unwrapped(listen: Listener | None) -> Iterator[Listener | None]:
    """Yield a listener whose exceptions pass unchanged through code that converts or swallows exceptions.

    An exception of the listener leaves the block unchanged, however the code inside handles the interruption.

    Examples
    --------
    >>> from agglo_core.progress import phase, unwrapped
    >>> def listen(now):
    ...     raise ValueError("enough")
    >>> try:
    ...     with unwrapped(listen) as within, phase(within, "reading"):
    ...         pass
    ... except ValueError as error:
    ...     print(error)
    enough
    """
    if listen is None:
        yield None
        return
    errors: list[BaseException] = []

    def call(report: Progress) -> None:
        try:
            if not errors:
                listen(report)
        except BaseException as error:
            errors.append(error)
        if errors:
            raise _Stopped

    try:
        yield call
    except BaseException:
        if not errors:
            raise
    if errors:
        raise errors[0]
