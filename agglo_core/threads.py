"""Thread count, and parallel execution of calls.

Results never depend on the number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from typing import Any, TypeVar

from agglo_core.errors import OptionError

__all__ = [
    "COSTLY",
    "mapped",
    "one_blas_thread",
    "over_ranges",
    "ranges",
    "thread_count",
    "together",
    "using_threads",
]

_VARIABLE = "AGGLO_THREADS"
_FEW = 20_000  # items (cells, faces) per thread, about a millisecond of work (benchmarks/threads.py)
COSTLY = 2_000
"""Minimum items per range of a thread where an item takes microseconds, such as the integrals of a cell.

Smaller: threads start for less work than their start takes. Larger: small meshes use fewer threads.
Benchmark: benchmarks/constants.py.
"""
_Result = TypeVar("_Result")
_chosen: ContextVar[int | None] = ContextVar("threads", default=None)
_few: ContextVar[int | None] = ContextVar("few", default=None)


def thread_count() -> int:
    """Return the thread count: from :func:`using_threads`, else from AGGLO_THREADS, else 1.

    Raises
    ------
    OptionError
        If the variable is not a positive integer.

    Examples
    --------
    >>> from agglo_core.threads import thread_count, using_threads
    >>> with using_threads(2):
    ...     print(thread_count())
    2
    """
    chosen = _chosen.get()
    if chosen is not None:
        return chosen
    text = os.environ.get(_VARIABLE, "1")
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise OptionError(f"{_VARIABLE} must be a whole number, 1 or more, given {text!r:.60}")
    return int(text)


@contextmanager
def using_threads(count: int | None, few: int | None = None) -> Iterator[None]:
    """Use this many threads within the context.

    None leaves the number unchanged.

    Parameters
    ----------
    count : int or None
    few : int, optional
        Minimum item count per thread, instead of each computation's default; for tests.

    Raises
    ------
    OptionError
        If the number is not a positive integer.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> with agglo.using_threads(2):
    ...     graph = agglo.samples.squares(4).graph
    """
    if count is None:
        yield
        return
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise OptionError(f"threads must be a whole number, 1 or more, given {count!r:.60}")
    token, before = _chosen.set(count), _few.set(_few.get() if few is None else few)
    try:
        yield
    finally:
        _chosen.reset(token)
        _few.reset(before)


def mapped(call: Callable[..., _Result], *columns: Iterable[Any]) -> Iterator[_Result]:
    """Yield results in order as :func:`map` does, but compute them in parallel threads.

    The threads end with the iteration. An exception of a call reaches the caller; afterwards, or if the
    caller stops early, pending calls are dropped. Inside calls the thread count is 1.

    Examples
    --------
    >>> from agglo_core.threads import mapped, using_threads
    >>> with using_threads(2):
    ...     print(list(mapped(pow, [2, 3], [5, 2])))
    [32, 9]
    """
    todo, threads = list(zip(*columns, strict=True)), thread_count()
    if threads == 1 or len(todo) < 2:
        yield from (call(*row) for row in todo)
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(min(threads, len(todo)), "agglo", lambda: _chosen.set(1))
    try:
        yield from pool.map(lambda row: call(*row), todo)
    finally:
        pool.shutdown(cancel_futures=True)


def ranges(n: int, *, few: int = _FEW, shares: int = 4, work: int | None = None) -> list[tuple[int, int]]:
    """Divide 0..n−1 into consecutive ranges ``(start, stop)`` for parallel threads.

    Parameters
    ----------
    n : int
        Item count.
    few : int
        Minimum item count per range, below which threads cost more than they save.
    shares : int
        Ranges per thread, because some may take longer than others; 1 if each needs a large workspace.
    work : int, optional
        Number to compare with ``few`` instead of n, such as the faces of n cells.

    Examples
    --------
    >>> with using_threads(2):
    ...     ranges(10, few=2, shares=1)
    [(0, 5), (5, 10)]
    """
    threads, least = thread_count(), _few.get()
    few = few if least is None else least
    enough = (n if work is None else work) // max(1, few)
    count = 1 if threads == 1 else max(1, min(shares * threads, n, enough))
    return [(n * k // count, n * (k + 1) // count) for k in range(count)]


def over_ranges(
    call: Callable[[int, int], _Result],
    n: int,
    *,
    few: int = _FEW,
    shares: int = 4,
    work: int | None = None,
) -> list[_Result]:
    """Call ``call(start, stop)`` for all :func:`ranges` in parallel, and return the results.

    Calls must not modify data of other ranges. They run in parallel where their kernels release the
    interpreter lock.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.threads import over_ranges, using_threads
    >>> values = np.arange(10)
    >>> with using_threads(2):
    ...     print(sum(over_ranges(lambda start, stop: values[start:stop].sum(), 10, few=4)))
    45
    """
    spans = ranges(n, few=few, shares=shares, work=work)
    return [call(*spans[0])] if len(spans) == 1 else list(mapped(call, *zip(*spans, strict=True)))


def together(n: int, *calls: Callable[[], Any]) -> list[Any]:
    """Execute independent calls, in parallel if the item count n is large.

    The results are returned in call order.

    Examples
    --------
    >>> from agglo_core.threads import together
    >>> together(10, lambda: "one", lambda: "the other")
    ['one', 'the other']
    """
    if len(ranges(n)) == 1:
        return [call() for call in calls]
    return list(mapped(lambda call: call(), calls))


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS uses one thread, if the package threadpoolctl is installed.

    Threads of BLAS wait for each other where the machine is busy, and on small matrices cost more than they
    save. The number of threads belongs to the process: of several contexts in different threads at the same
    time, the first decides. The package comes with scikit-learn, that is with ``agglo[kmeans]``.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.threads import one_blas_thread
    >>> with one_blas_thread():
    ...     print(np.linalg.inv(np.diag([2.0, 4.0])).diagonal())
    [0.5  0.25]
    """
    pools = _thread_pools()
    return nullcontext() if pools is None else pools.limit(limits=1, user_api="blas")


@cache
def _thread_pools() -> Any:
    """Return the thread pools of the process, cached because finding them takes milliseconds, or None."""
    try:
        from threadpoolctl import ThreadpoolController
    except ImportError:
        return None
    return ThreadpoolController()
