"""Prefetch a row of an array into the cache, without waiting for it."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.core.cgutils import intp_t
from numba.extending import intrinsic, overload

_READ, _KEEP, _DATA = 0, 3, 1
"""Arguments of ``llvm.prefetch``: for reading, into all caches, data."""


@intrinsic
def _prefetch_row(_context, array, row):
    """Issue the prefetch instruction of the processor."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        given = context.make_array(signature.args[0])(context, builder, arguments[0])
        place = context.cast(builder, arguments[1], signature.args[1], types.intp)
        stride = builder.extract_value(given.strides, 0)
        address = builder.add(builder.ptrtoint(given.data, intp_t), builder.mul(place, stride))
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        options = [ir.Constant(number, each) for each in (_READ, _KEEP, _DATA)]
        builder.call(function, [builder.inttoptr(address, byte), *options])
        return context.get_dummy_value()

    return types.void(array, row), generate


def prefetch(array: Any, row: Any) -> None:
    """Prefetch the cache line in which this row of the array begins.

    The processor goes on meanwhile, whereas an ordinary read would wait for the data. Outside of kernels this
    does nothing.
    """


@overload(prefetch)
def _in_kernels(array, row):
    issue: Any = _prefetch_row
    return lambda array, row: issue(array, row)
