"""How a kernel is compiled, and where its machine code is kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from typing import Any

import numba

__all__ = ["kernel"]

_log = logging.getLogger("agglo")
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def kernel(function: Callable[..., Any] | None = None, *, reorder_sums: bool = False) -> Any:
    """Compile ``function`` with numba on first call, from the disk cache where one can be written.

    ``reorder_sums`` lets the compiler vectorise reductions; results stay the same from run to run.
    """
    if function is None:
        return lambda inner: kernel(inner, reorder_sums=reorder_sums)
    options = _OPTIONS | ({"fastmath": {"reassoc", "contract", "nsz"}} if reorder_sums else {})
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError as error:  # numba's word for "no cache folder is writable"
        if "cache" not in str(error):
            raise
        _warn_unwritable()
        return numba.njit(**options)(function)


@cache  # once per process
def _warn_unwritable() -> None:
    _log.warning(
        "no folder for compiled kernels is writable: they are compiled again in each run; "
        "set NUMBA_CACHE_DIR to a folder that is"
    )
