"""Phases of a computation, and who is told of them. There is no state but in the phase itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

_PAUSE = 0.05
"""Least number of seconds between two reports of a phase: whoever is told costs nothing."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a computation: the phase, and the share of it that is done.

    Attributes
    ----------
    phase : str
        What is done: ``"agglomerating"``, ``"measuring"``, ``"writing"``, ….
    fraction : float
        Share of the phase that is done: 0 when it begins, 1 when it ends, never less than before.
    text : str
        Details, such as the number of pieces, a metric or a file.

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
"""Is told how far a computation has come, in its thread; what it raises ends the computation."""


class Tell(Protocol):
    """Tells how much of a phase is done.

    Examples
    --------
    >>> from agglo_core.progress import Tell
    >>> class Printed:
    ...     def __call__(self, fraction, text=""):
    ...         print(f"{fraction:.0%} {text}")
    >>> tell: Tell = Printed()
    >>> tell(0.5, "faces")
    50% faces
    """

    def __call__(self, fraction: float, text: str = "") -> None:
        """Tell a share in [0, 1], and details."""


@contextmanager
def phase(listen: Listener | None, name: str, text: str = "") -> Iterator[Tell]:
    """A phase: 0 is told when the block begins, 1 when it ends without error.

    Parameters
    ----------
    listen : callable, optional
        Without one nothing happens.
    name, text : str
        See :class:`Progress`; the text is that of the begin, and of reports that have none.

    Yields
    ------
    callable
        ``tell(fraction, text)``. It may be called as often as is convenient: at most 20 calls a second
        come through, and none with less than the one before.

    Examples
    --------
    >>> with phase(print, "counting") as tell:
    ...     tell(0.5, "half")
    Progress(phase='counting', fraction=0.0, text='')
    Progress(phase='counting', fraction=0.5, text='half')
    Progress(phase='counting', fraction=1.0, text='half')
    """
    if listen is None:
        yield to_nobody
        return
    now = Progress(name, 0.0, text)
    listen(now)
    told = float("-inf")  # what comes first may take long, and is told

    def tell(fraction: float, text: str = "") -> None:
        nonlocal now, told
        now = Progress(name, max(now.fraction, min(fraction, 1.0)), text or now.text)
        if time.monotonic() - told >= _PAUSE:
            listen(now)
            told = time.monotonic()

    yield tell
    listen(replace(now, fraction=1.0))


def to_nobody(fraction: float, text: str = "") -> None:
    """Do nothing: how progress is told where nobody wants to know.

    Examples
    --------
    >>> from agglo_core.progress import to_nobody
    >>> to_nobody(0.5, "half done")
    """


def part(tell: Tell, place: int, count: int, label: str = "") -> Tell:
    """``tell`` for part number ``place`` of ``count`` equal parts of a phase, which begins now.

    Examples
    --------
    >>> from agglo_core.progress import part, phase
    >>> def listen(now):
    ...     print(f"{now.fraction:.2f} {now.text}".strip())
    >>> with phase(listen, "reading") as tell:
    ...     second = part(tell, 1, 2, "faces")
    ...     second(0.5)
    0.00
    0.50 faces
    1.00 faces
    """

    def tell_part(fraction: float, text: str = "") -> None:
        tell((place + min(fraction, 1.0)) / count, ": ".join(filter(None, (label, text))))

    tell_part(0.0)
    return tell_part


def labelled(listen: Listener | None, label: str) -> Listener | None:
    """A listener that puts ``label`` before each text: which run of several, which level.

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
    return lambda now: listen(replace(now, text=f"{label}: {now.text}" if now.text else label))


class _Stopped(BaseException):
    """Ends what runs within :func:`unwrapped`; never seen outside."""


@contextmanager
def unwrapped(listen: Listener | None) -> Iterator[Listener | None]:
    """The listener for code that turns exceptions into others, or swallows them.

    What the listener raises leaves the block as it was raised, whatever is made of the stop within.

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
    raised: list[BaseException] = []

    def call(now: Progress) -> None:
        try:
            if not raised:
                listen(now)
        except BaseException as error:
            raised.append(error)
        if raised:
            raise _Stopped

    try:
        yield call
    except BaseException:
        if not raised:
            raise
    if raised:
        raise raised[0]
