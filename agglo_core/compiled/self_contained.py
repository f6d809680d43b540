"""Compilers for kernels, which contain copies of their helpers, and for these helpers.

No other module uses the internals of ``numba.core.codegen`` and of numba's passes.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from numba.core import cpu
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

from agglo_core.compiled import compile_lock


class _KernelLibrary(JITCodeLibrary):
    """Machine code of one kernel, independent of what the process compiled before.

    Sums that the compiler may reorder are rounded as it happens to optimise them. On symmetric meshes two
    kernels with different rounding break the same tie differently.
    """

    reorders_sums = False
    """Whether other kernels must call this kernel and not inline it, so that its sums are rounded alike."""

    def _optimize_final_module(self) -> None:
        # Kernels that call this one link a copy that is not optimised yet. Numba would link the optimised
        # functions, and thus optimise them twice.
        linked: Any = self._final_module.clone()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                if self.reorders_sums:
                    linked.get_function(function.name).add_function_attribute("noinline")
                linked.get_function(function.name).linkage = "linkonce_odr"
        self._shared_module = linked
        super()._optimize_final_module()  # type: ignore[no-untyped-call]

    def _finalize_final_module(self) -> None:
        # Numba leaves linked functions as weak symbols, so that a call leads to the first copy of that name
        # in the process. All optimisation is finished: functions made private earlier would be inlined by
        # other rules.
        functions: Any = self._final_module.functions
        for function in functions:
            if function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._finalize_final_module()  # type: ignore[no-untyped-call]


class _Interned(Flags):
    """Compiler options that are hashed once, and equal to no other interned ones."""

    __slots__ = ("_hash",)

    def __init__(self, options: Flags) -> None:
        super().__init__(options)  # type: ignore[no-untyped-call]
        self._hash = hash(options)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or (type(other) is not _Interned and super().__eq__(other))  # type: ignore[no-untyped-call]

    def copy(self) -> Flags:
        return Flags(self)  # type: ignore[no-untyped-call]


@cache
def _interned(options: Flags) -> _Interned:
    return _Interned(options)


class _Options(Flags):
    """Compiler options, of which numba keeps an interned copy while it compiles a function.

    For each operation numba looks up an implementation by types and options. It would hash and compare some
    20 options each time: a tenth of the time to compile a kernel. The copy lacks the one option that differs
    between kernels and helpers and does not matter to callees, so that both call the same helpers.
    """

    __slots__ = ()

    def copy(self) -> _Interned:
        inherited: Any = Flags(self)  # type: ignore[no-untyped-call]
        inherited.discard("no_cpython_wrapper")
        return _interned(inherited)


class _Compiler(Compiler):
    def compile_extra(self, func: Any) -> Any:
        self.state.flags = _Options(self.state.flags)  # type: ignore[no-untyped-call]
        return super().compile_extra(func)  # type: ignore[no-untyped-call]


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Collect garbage rarely: Python's threshold of 700 objects costs 6 % of the time of compiling."""
    young, *older = gc.get_threshold()
    if young:
        gc.set_threshold(max(young, 100_000), *older)
    try:
        yield
    finally:
        gc.set_threshold(young, *older)


class KernelCompiler(_Compiler):
    """Numba compiler for kernels, which keeps the copies of helpers in a kernel private."""

    def define_pipelines(self) -> Any:
        """Create the kernel's code library before the first pass, and return numba's passes."""
        state = self.state
        library: Any = _KernelLibrary
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        state.library.reorders_sums = bool(state.flags.fastmath)
        return super().define_pipelines()  # type: ignore[no-untyped-call]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function. If this fails, release the locks so that other processes compile it."""
        try:
            with _rare_collections():
                return super().compile_extra(func)
        except BaseException:
            compile_lock.release_all()
            raise


class _HelperLibrary(JITCodeLibrary):
    """Intermediate code of one helper, optimised and translated only as part of kernels.

    Numba optimises each called function by itself and turns it into machine code that nothing here runs,
    and optimises it again in the caller: a third of the time to compile a kernel
    (benchmarks/first_run.py).
    """

    def finalize(self) -> None:
        # Callees are linked to kernels only. Linked here, they would be copied once more for every caller.
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _HelperLowering(NativeLowering):
    """Numba pass that translates a helper to intermediate code, for kernels to link."""

    _name = "helper_lowering"

    def run_pass(self, state: Any) -> bool:
        library: Any = _HelperLibrary
        state.library = library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        changed: bool = super().run_pass(state)  # type: ignore[no-untyped-call]

        # Numba identifies the callee by its entry point from Python. A helper has none, hence address 0.
        lowered = state["cr"]
        name = lowered.fndesc.qualname.rpartition(".")[2]
        if state.flags.fastmath and not state.flags.forceinline:
            # Inlined, reordered sums would be rounded differently in each caller.
            function: Any = state.library._final_module.get_function(lowered.fndesc.mangled_name)
            function.add_function_attribute("noinline")
        entry = cpu._dynfunc.make_function(  # type: ignore[attr-defined]
            lowered.fndesc.lookup_module(), name, "", 0, lowered.env, (state.library,)
        )
        libraries = [state.library, *state.library._linking_libraries]
        state.targetctx.insert_user_function(entry, lowered.fndesc, libraries)
        state.reload_init.extend(state.library._reload_init)
        state["cr"] = lowered._replace(cfunc=entry)
        return changed


class HelperCompiler(_Compiler):
    """Numba compiler for functions that only kernels call: it produces no machine code."""

    def define_pipelines(self) -> Any:
        """Return numba's passes, with one replaced so that translation ends at intermediate code."""
        [passes] = super().define_pipelines()  # type: ignore[no-untyped-call]
        passes.passes = [
            (_HelperLowering if step is NativeLowering else step, text) for step, text in passes.passes
        ]
        return [passes]
