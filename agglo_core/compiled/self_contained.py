"""Kernels that call their own copies of helpers, whichever other kernels a process holds.

No other file knows ``numba.core.codegen`` from within.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _Library(JITCodeLibrary):
    """Code of one kernel, whose machine code keeps the functions linked into it private.

    Numba leaves them weak symbols, and a call leads to the first copy of that name in the process. Where
    the kernel was compiled, this is the helper as compiled for itself; where it was loaded from disk, the
    copy in its file, over which the optimiser has passed once more. The two round sums differently, so
    ties of symmetric meshes were broken in one way or the other.
    """

    def _finalize_final_module(self) -> None:
        # all optimisation is done: functions that were private before would be inlined by other rules
        functions: Any = self._final_module.functions
        linked = [each for each in functions if each.linkage.name == "linkonce_odr"]
        for each in linked:
            each.linkage = "internal"
        super()._finalize_final_module()  # type: ignore[no-untyped-call]
        # machine code is written; other kernels link the module itself, which needs the functions shared
        for each in linked:
            each.linkage = "linkonce_odr"


class KernelCompiler(Compiler):
    """Numba's compiler, with a library that keeps the helpers of a kernel private."""

    def define_pipelines(self) -> Any:
        """Make the library before the first pass runs; the passes are numba's own."""
        state = self.state
        library: Any = _Library
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()  # type: ignore[no-untyped-call]
