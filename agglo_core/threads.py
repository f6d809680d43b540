"""How many threads kernels may use; results never depend on it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from agglo_core.errors import OptionError

__all__ = ["thread_count", "using_threads"]

_VARIABLE = "AGGLO_THREADS"
_chosen: ContextVar[int | None] = ContextVar("threads", default=None)


def thread_count() -> int:
    """Threads of this run: those of :func:`using_threads`, else the variable AGGLO_THREADS, else 1.

    Raises
    ------
    OptionError
        If the variable is not a whole number from 1 on.
    """
    chosen = _chosen.get()
    if chosen is not None:
        return chosen
    given = os.environ.get(_VARIABLE, "1")
    if not given.isascii() or not given.isdigit() or int(given) < 1:
        raise OptionError(f"{_VARIABLE} must be a whole number, 1 or more, given {given!r:.60}")
    return int(given)


@contextmanager
def using_threads(count: int | None) -> Iterator[None]:
    """Context in which this many threads are used; None leaves the number as it is.

    Raises
    ------
    OptionError
        If the number is not a whole one from 1 on.
    """
    if count is None:
        yield
        return
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise OptionError(f"threads must be a whole number, 1 or more, given {count!r:.60}")
    token = _chosen.set(count)
    try:
        yield
    finally:
        _chosen.reset(token)
