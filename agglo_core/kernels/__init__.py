"""Numba kernels, one file per concern; each is tested against a slow, obvious numpy twin.

Signatures are compiled on first use and cached on disk, so the first run on a fresh machine is
slower. Inputs are read-only arrays, outputs are fresh: every kernel has one signature.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

__all__ = ["first_use", "kernel"]

_log = logging.getLogger("agglo")
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_unwritable: list[str] = []  # at most one entry: the warning is given once per process


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
        if not _unwritable:
            _unwritable.append(str(error))
            _log.warning("no folder for compiled kernels is writable: they are compiled anew in each run")
        return numba.njit(**options)(function)


def first_use() -> bool:
    """Whether the kernels of the recursion are not compiled on disk yet (the first run takes longer)."""
    from agglo_core.kernels import graphs

    folder = Path(graphs.permute_graph.stats.cache_path or "")
    return not any(folder.glob("graphs.permute_graph*.nbi"))
