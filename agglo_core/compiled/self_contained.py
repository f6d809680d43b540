"""Kernels that call their own copies of helpers, independent of other kernels in the process.

No other module uses the internals of ``numba.core.codegen``.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _Library(JITCodeLibrary):
    """Code of one kernel, whose machine code keeps its linked functions private.

    Numba leaves these functions as weak symbols, and a call leads to the first copy of that name in the
    process. In a process that compiled the kernel, this is the helper as compiled separately. In a process
    that loaded the kernel from disk, it is the copy in the kernel's file, optimised once more. The two round
    sums differently, so that ties on symmetric meshes were broken inconsistently.
    """

    def _finalize_final_module(self) -> None:
        # All optimisation is finished. Functions made private earlier would be inlined by other rules.
        functions: Any = self._final_module.functions
        linked = [function for function in functions if function.linkage.name == "linkonce_odr"]
        for function in linked:
            function.linkage = "internal"
        super()._finalize_final_module()  # type: ignore[no-untyped-call]
        # The machine code is written. Other kernels link the module itself, which must export the functions.
        for function in linked:
            function.linkage = "linkonce_odr"


class KernelCompiler(Compiler):
    """Numba compiler with a library that keeps a kernel's helpers private."""

    def define_pipelines(self) -> Any:
        """Create the library before the first pass, and return numba's passes."""
        state = self.state
        library: Any = _Library
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()  # type: ignore[no-untyped-call]
