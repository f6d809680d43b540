"""Decorators that compile kernels, and helper functions called by kernels, with numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.extending import is_jitted, register_jitable

try:
    from agglo_core.compiled.kernel_cache import KernelCache
    from agglo_core.compiled.self_contained import HelperCompiler, KernelCompiler
except (ImportError, AttributeError):  # numba with other internals: use its compiler and cache
    KernelCache = KernelCompiler = HelperCompiler = None  # type: ignore[assignment, misc]

ONE = np.uint64(1)
"""One as an unsigned integer: a plain 1 would turn unsigned indices into real numbers.

An index that may be negative counts from the end, and testing for this takes three instructions at every
access, half the time of a loop over neighbours. Hot loops therefore write ``np.uint32(indices[h])``.
"""

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def kernel(
    function: Callable[..., Any] | None = None, *, reorder_sums: bool = False, allocates: bool = True
) -> Any:
    """Compile ``function`` with numba at its first call, and keep the machine code on disk if possible.

    ``reorder_sums`` lets the compiler vectorise reductions; results stay reproducible from run to run. Use
    ``allocates=False`` for a kernel that calls helpers many times with many arrays, and neither creates nor
    returns arrays.

    Examples
    --------
    >>> from agglo_core.authoring import kernel
    >>> from agglo_core.compiled.frames import turned
    >>> compiled = kernel(turned)  # most often a decorator; what it is given has to be in a file
    >>> compiled(3.0, 4.0, 0.0, 1.0)
    (-4.0, 3.0)
    """
    if function is None:
        return lambda inner: kernel(inner, reorder_sums=reorder_sums, allocates=allocates)
    compiled: Any = numba.njit(pipeline_class=KernelCompiler, **_options(reorder_sums, allocates))(function)
    if is_jitted(compiled):  # False under NUMBA_DISABLE_JIT
        _keep(compiled, function)
    return compiled


def helper(
    function: Callable[..., Any] | None = None,
    *,
    reorder_sums: bool = False,
    allocates: bool = False,
    inline: bool = False,
) -> Any:
    """Mark ``function`` as callable from kernels. Called from Python, it runs uncompiled.

    A function called only by kernels should be a helper: it compiles faster than a kernel, as it needs no
    entry point from Python, and a literal argument does not create a second signature. A helper cannot call
    itself. A helper is compiled once for callers that create arrays, and once for other helpers.

    Arrays are borrowed from the caller, so no references are counted: this saves two atomic additions for
    every array in every call. Use ``allocates=True`` for helpers that create arrays, or call such helpers.
    Use ``inline=True`` for long helpers called in a loop to be vectorised.

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
    return register_jitable(pipeline_class=HelperCompiler, **options)(function)


def _keep(compiled: Any, function: Callable[..., Any]) -> None:
    if KernelCache is None:
        compiled.enable_caching()
    else:
        compiled._cache = KernelCache(function)


def _options(reorder_sums: bool, allocates: bool) -> dict[str, Any]:
    options = _OPTIONS | {"_nrt": allocates}  # inherited from the caller unless given
    return options | ({"fastmath": {"reassoc", "contract", "nsz"}} if reorder_sums else {})
