"""Time limits of searches, and a list of the limits that were reached."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from math import isfinite

from agglo_core.errors import OptionError

_noted: ContextVar[list[float] | None] = ContextVar("noted limits", default=None)


class TimeLimit:
    """A time limit that starts now, in seconds, or no limit.

    Results of searches that a limit ends may differ between runs, because they depend on the machine.

    Parameters
    ----------
    seconds : float, optional
        Wall-clock time.

    Examples
    --------
    >>> from agglo_core.progress import TimeLimit
    >>> TimeLimit(60.0).over(), TimeLimit().over()
    (False, False)
    """

    def __init__(self, seconds: float | None = None) -> None:
        self._seconds = seconds
        self._end = None if seconds is None else time.monotonic() + seconds
        self._told = False

    def over(self) -> bool:
        """Return True if the time is over. The first time is recorded for :func:`noted_limits`."""
        if self._end is None or self._seconds is None or time.monotonic() < self._end:
            return False
        noted = _noted.get()
        if noted is not None and not self._told:
            noted.append(self._seconds)
        self._told = True
        return True


def checked_seconds(owner: str, seconds: object) -> float | None:
    """Check a time limit given as an option of a component: positive seconds, or None.

    Raises OptionError for other values.

    Examples
    --------
    >>> from agglo_core.progress import checked_seconds
    >>> checked_seconds("mine", 5), checked_seconds("mine", None)
    (5.0, None)
    """
    if seconds is None:
        return None
    number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not (number and isfinite(seconds) and seconds > 0):  # type: ignore[arg-type, operator]
        raise OptionError(f"{owner}: seconds must be a number above 0, given {seconds!r}")
    return float(seconds)  # type: ignore[arg-type]


@contextmanager
def noted_limits() -> Iterator[list[float]]:
    """Yield a list to which every time limit reached within this context is added, in seconds.

    Examples
    --------
    >>> from agglo_core.progress import TimeLimit, noted_limits
    >>> with noted_limits() as noted:
    ...     limit = TimeLimit(1e-9)
    ...     while not limit.over():
    ...         pass
    >>> noted
    [1e-09]
    """
    noted: list[float] = []
    token = _noted.set(noted)
    try:
        yield noted
    finally:
        _noted.reset(token)
