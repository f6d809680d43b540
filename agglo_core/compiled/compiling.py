"""Decorators that compile kernels and their helpers with numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.extending import is_jitted, register_jitable

try:
    from agglo_core.compiled.kernel_cache import KernelCache
    from agglo_core.compiled.self_contained import KernelCompiler
except (ImportError, AttributeError):  # a numba that is otherwise within: its own compiler and cache serve
    KernelCache = KernelCompiler = None  # type: ignore[assignment, misc]

ONE = np.uint64(1)
"""To be added to unsigned indices, which a plain 1 would make real numbers.

An index that may be negative counts from the end: to see whether it does takes three instructions at every
access, half the time of a loop over neighbours. Hot loops say ``np.uint32(indices[h])``, which takes none.
"""

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def kernel(
    function: Callable[..., Any] | None = None, *, reorder_sums: bool = False, allocates: bool = True
) -> Any:
    """Compile ``function`` with numba on first call, from the disk cache where one can be written.

    ``reorder_sums`` lets the compiler vectorise reductions; results stay the same from run to run. One that
    calls helpers many times with many arrays, and makes and returns none, may say ``allocates=False``.

    Examples
    --------
    >>> from agglo_core.authoring import kernel, turned
    >>> compiled = kernel(turned)  # most often a decorator; what it is given has to be in a file
    >>> compiled(3.0, 4.0, 0.0, 1.0)
    (-4.0, 3.0)
    """
    if function is None:
        return lambda inner: kernel(inner, reorder_sums=reorder_sums, allocates=allocates)
    compiled: Any = numba.njit(pipeline_class=KernelCompiler, **_options(reorder_sums, allocates))(function)
    if is_jitted(compiled):  # not so under NUMBA_DISABLE_JIT
        _keep(compiled, function)
    return compiled


def helper(
    function: Callable[..., Any] | None = None,
    *,
    reorder_sums: bool = False,
    allocates: bool = False,
    inline: bool = False,
) -> Any:
    """Let kernels call ``function``; called from Python it runs uncompiled.

    Whatever only kernels call should be a helper: it compiles in less time than a kernel, as it needs no
    entry from Python, and a literal argument does not make a second signature. It cannot call itself. One
    that both a kernel and a helper call is compiled for each of the two.

    Arrays are borrowed from the caller, so that no references are counted: two atomic additions for every
    array of every call. One that makes arrays, or calls a helper that does, says ``allocates=True``. One of
    many lines that is called in a loop meant for vector registers says ``inline=True``.

    Examples
    --------
    >>> from agglo_core.authoring import helper
    >>> @helper
    ... def square(x):
    ...     return x * x
    >>> square(3.0)
    9.0
    """
    if function is None:
        return lambda inner: helper(inner, reorder_sums=reorder_sums, allocates=allocates, inline=inline)
    options = _options(reorder_sums, allocates) | ({"forceinline": True} if inline else {})
    return register_jitable(**options)(function)


def _keep(compiled: Any, function: Callable[..., Any]) -> None:
    if KernelCache is None:
        compiled.enable_caching()
    else:
        compiled._cache = KernelCache(function)


def _options(reorder_sums: bool, allocates: bool) -> dict[str, Any]:
    options = _OPTIONS | {"_nrt": allocates}  # inherited from the caller unless it is given
    return options | ({"fastmath": {"reassoc", "contract", "nsz"}} if reorder_sums else {})
