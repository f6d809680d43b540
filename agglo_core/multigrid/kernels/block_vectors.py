"""Products of small blocks with vectors, by vector instructions on block rows.

Left alone, the compiler unrolls the loops over rows and columns and then does not vectorise. Therefore the
instructions are generated here. All arrays are flat and of equal dtype.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import config
from numba.core.errors import RequireLiteralValue
from numba.extending import intrinsic

_IN_PYTHON = bool(getattr(config, "DISABLE_JIT", False))
_FLAGS = ("contract", "reassoc", "nsz")


def _add_product(typing, n, factors, start, stride, block, at, into, to):
    """Generate instructions that add a linear combination of block rows to ``into[to:to + n]``.

    The sum is Σ_c factors[start + c · stride] · block[at + c · n:at + (c + 1) · n].

    c runs from 0 to n − 1. n must be a literal, or a variable of the function around a kernel.
    """
    width = _literal(n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # Σ_c (factor c in all lanes) · (block row c), added to the previous vector.
        lanes = _Lanes(context, builder, signature, args, width)
        totals = [lanes.vector(6, args[7]), None]
        for c in range(width):
            place = builder.add(args[2], builder.mul(args[3], ir.Constant(args[3].type, c)))
            factor = lanes.spread(builder.load(lanes.address(1, place)))
            product = builder.fmul(factor, lanes.row(4, args[5], c), flags=_FLAGS)
            before = totals[c % 2]  # two alternating sums, because each addition waits for the previous
            totals[c % 2] = product if before is None else builder.fadd(before, product, flags=_FLAGS)
        first, second = totals
        lanes.store(6, args[7], first if second is None else builder.fadd(first, second, flags=_FLAGS))
        return context.get_dummy_value()

    place = types.intp
    return types.void(n, factors, place, place, block, place, into, place), generate


def _add_dots(typing, n, block, at, vector, start, into, to):
    """Generate instructions that add the product of a block and a vector to ``into[to:to + n]``.

    Entry c of the product is Σ_q block[at + c · n + q] · vector[start + q].

    c and q run from 0 to n − 1. n must be a literal, or a variable of the function around a kernel.
    """
    width = _literal(n)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # Block row c times vector, entry by entry. The sum over lanes is entry c of the product.
        lanes = _Lanes(context, builder, signature, args, width)
        other = lanes.vector(3, args[4])
        rows = [builder.fmul(lanes.row(1, args[2], c), other, flags=_FLAGS) for c in range(width)]
        found = builder.fadd(lanes.vector(5, args[6]), lanes.sums(rows), flags=_FLAGS)
        lanes.store(5, args[6], found)
        return context.get_dummy_value()

    place = types.intp
    return types.void(n, block, place, vector, place, into, place), generate


def _literal(n: Any) -> int:
    if not isinstance(n, types.IntegerLiteral):
        raise RequireLiteralValue("the block size must be a compile-time constant")
    return int(n.literal_value)


class _Lanes:
    """Generator of instructions for vectors of ``width`` entries, padded with zeros to a power of two.

    ``argument`` is the number of the intrinsic's array argument, and ``place`` an index into this array.
    """

    def __init__(self, context: Any, builder: Any, signature: Any, args: Any, width: int) -> None:
        self.context, self.builder, self.signature, self.args = context, builder, signature, args
        dtype = signature.args[1].dtype
        self.bits, self.one = dtype.bitwidth, context.get_value_type(dtype)
        self.width, self.count = width, 1 << (width - 1).bit_length()
        self.short, self.full = ir.VectorType(self.one, width), ir.VectorType(self.one, self.count)

    def address(self, argument: int, place: Any) -> Any:
        array = self.context.make_array(self.signature.args[argument])(
            self.context, self.builder, self.args[argument]
        )
        return self.builder.gep(array.data, [place])

    def vector(self, argument: int, place: Any) -> Any:
        """Generate the load of ``width`` consecutive array entries, from the index ``place`` on."""
        at = self.builder.bitcast(self.address(argument, place), self.short.as_pointer())
        short = self.builder.load(at, align=self.bits // 8)
        return self._shuffled(short, ir.Constant(self.short, None), range(self.count))

    def row(self, argument: int, at: Any, c: int) -> Any:
        """Generate the load of row c of a block, in one instruction on processors with masked loads."""
        builder = self.builder
        place = builder.add(at, ir.Constant(at.type, c * self.width))
        bit, pointer = ir.IntType(1), self.full.as_pointer()
        mask = ir.Constant(ir.VectorType(bit, self.count), [int(k < self.width) for k in range(self.count)])
        name = f"llvm.masked.load.v{self.count}f{self.bits}.p0"
        kinds = [pointer, ir.IntType(32), mask.type, self.full]
        load = builder.module.declare_intrinsic(name, (), ir.FunctionType(self.full, kinds))
        target = builder.bitcast(self.address(argument, place), pointer)
        align = ir.Constant(ir.IntType(32), self.bits // 8)
        return builder.call(load, [target, align, mask, ir.Constant(self.full, None)])

    def spread(self, value: Any) -> Any:
        """Generate a vector with all entries equal to a value."""
        nothing, first = ir.Constant(self.full, ir.Undefined), ir.Constant(ir.IntType(32), 0)
        one = self.builder.insert_element(nothing, value, first)
        return self._shuffled(one, nothing, [0] * self.count)

    def store(self, argument: int, place: Any, vector: Any) -> None:
        at = self.builder.bitcast(self.address(argument, place), self.short.as_pointer())
        short = self._shuffled(vector, vector, range(self.width))
        self.builder.store(short, at, align=self.bits // 8)

    def sums(self, vectors: list[Any]) -> Any:
        """Generate a vector whose entry c is the sum of the entries of vector c.

        In each round, two vectors (u, v) are combined: the lower halves of both plus the upper halves of
        both. Segments of one original vector are halved from ``count`` lanes to 1, in log₂ ``count`` rounds.
        """
        count, part = self.count, self.count
        vectors = [*vectors, *[None] * (count - len(vectors))]
        while part > 1:
            half, pairs = part // 2, zip(vectors[::2], vectors[1::2], strict=True)
            low = [k for k in range(2 * count) if k % part < half]
            high = [k + half for k in low]
            vectors = [self._halved(one, other, low, high) for one, other in pairs]
            part = half
        return vectors[0]

    def _halved(self, first: Any, second: Any, low: list[int], high: list[int]) -> Any:
        # Vectors beyond ``width`` are None, always at the end.
        if first is None:
            return None
        second = ir.Constant(self.full, None) if second is None else second
        parts = (self._shuffled(first, second, lanes) for lanes in (low, high))
        return self.builder.fadd(*parts, flags=_FLAGS)

    def _shuffled(self, one: Any, other: Any, places: Any) -> Any:
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), len(places)), list(places))
        return self.builder.shuffle_vector(one, other, lanes)


def _add_product_slowly(n, factors, start, stride, block, at, into, to):
    """Compute ``add_product`` in Python, for debugging with NUMBA_DISABLE_JIT."""
    rows = block[at : at + n * n].reshape(n, n)
    into[to : to + n] += factors[start + stride * np.arange(n)] @ rows


def _add_dots_slowly(n, block, at, vector, start, into, to):
    """Compute ``add_dots`` in Python, for debugging with NUMBA_DISABLE_JIT."""
    into[to : to + n] += block[at : at + n * n].reshape(n, n) @ vector[start : start + n]


add_product: Any = _add_product_slowly if _IN_PYTHON else intrinsic(_add_product)
add_dots: Any = _add_dots_slowly if _IN_PYTHON else intrinsic(_add_dots)
