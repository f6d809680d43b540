"""How a kernel is compiled, and where its machine code is kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
from numba.extending import register_jitable

__all__ = ["helper", "kernel"]

_log = logging.getLogger("agglo")
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def kernel(
    function: Callable[..., Any] | None = None, *, reorder_sums: bool = False, allocates: bool = True
) -> Any:
    """Compile ``function`` with numba on first call, from the disk cache where one can be written.

    ``reorder_sums`` lets the compiler vectorise reductions; results stay the same from run to run. One that
    calls helpers many times with many arrays, and makes and returns none, may say ``allocates=False``.
    """
    if function is None:
        return lambda inner: kernel(inner, reorder_sums=reorder_sums, allocates=allocates)
    options = _options(reorder_sums, allocates)
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError as error:  # numba's word for "no cache folder is writable"
        if "cache" not in str(error):
            raise
        _warn_unwritable()
        return numba.njit(**options)(function)


def helper(
    function: Callable[..., Any] | None = None, *, reorder_sums: bool = False, allocates: bool = False
) -> Any:
    """Let kernels call ``function``; called from Python it runs uncompiled.

    Whatever only kernels call should be a helper: it compiles in less time than a kernel, as it needs no
    entry from Python, and a literal argument does not make a second signature. It cannot call itself. One
    that both a kernel and a helper call is compiled for each of the two.

    Arrays are borrowed from the caller, so that no references are counted: two atomic additions for every
    array of every call. One that makes arrays, or calls a helper that does, says ``allocates=True``.
    """
    if function is None:
        return lambda inner: helper(inner, reorder_sums=reorder_sums, allocates=allocates)
    return register_jitable(**_options(reorder_sums, allocates))(function)


def _options(reorder_sums: bool, allocates: bool) -> dict[str, Any]:
    options = _OPTIONS | {"_nrt": allocates}  # inherited from the caller unless it is given
    return options | ({"fastmath": {"reassoc", "contract", "nsz"}} if reorder_sums else {})


@cache  # once per process
def _warn_unwritable() -> None:
    _log.warning(
        "no folder for compiled kernels is writable: they are compiled again in each run; "
        "set NUMBA_CACHE_DIR to a folder that is"
    )
