"""Read MATLAB level 5 files (``save -v6`` and ``-v7``): numbers, structs, and cell arrays in bulk.

scipy.io also reads them, but creates an object per cell and allocates memory as a damaged file demands. Here
a cell array of a million lists is one pass over its bytes, and no array exceeds the input size.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.matlab.mat5_cells import (
    INSIDE,
    MATRIX,
    NUMBERS,
    TYPES,
    gather_lists,
    matrix_ends,
    matrix_heads,
    whole_values,
)
from agglo_core.io.text.counted_lists import record_starts

_COMPRESSED = 15
_CELL, _STRUCT = 1, 2
_ROOM, _EXPANSION = 1 << 26, 30  # bytes allowed after inflation: fixed, and per byte of the file


class Variable(NamedTuple):
    """MATLAB variable whose values are decoded from the file only when they are requested."""

    name: str
    kind: int  # MATLAB's number of the class
    shape: tuple[int, ...]
    words: NDArray[Any]  # (n, 2) int32: rows of eight bytes
    order: str
    start: int  # row after its name
    stop: int

    @property
    def is_numeric(self) -> bool:
        """True if the variable is an array of numbers.

        False for cells, structs and texts.
        """
        return self.kind in NUMBERS

    @property
    def is_struct(self) -> bool:
        """True if the variable is a struct."""
        return self.kind == _STRUCT

    @property
    def is_cell(self) -> bool:
        """True if the variable is a cell array."""
        return self.kind == _CELL

    def reals(self) -> Float:
        """Return the numbers as doubles, in the shape of the variable.

        Raises FileError if the variable is not numeric.
        """
        return frozen_float(self._numbers())

    def integers(self) -> Int:
        """Return the numbers as a vector of integers ``(n,)``, column by column.

        Raises FileError for other values.
        """
        return whole_values(self._numbers().ravel(order="F"), self.name)

    def _numbers(self) -> NDArray[Any]:
        """Return the numbers in the shape of the variable and in the file's data type."""
        if not self.is_numeric:
            raise FileError(f"{self.name} is not numeric")
        kind, place, size = _element(self.words, self.start, self.stop, self.name)
        count = int(np.prod(self.shape, dtype=object))
        dtype = np.dtype(TYPES.get(kind, "V1")).newbyteorder(self.order)  # type: ignore[arg-type]
        if kind not in TYPES or size != count * dtype.itemsize:
            raise FileError(f"{self.name}: {size} bytes of type {kind} do not match the shape {self.shape}")
        values = self.words.reshape(-1).view(np.uint8)[place : place + size].view(dtype)
        return values.reshape(self.shape, order="F")

    def fields(self) -> dict[str, Variable]:
        """Return the fields of a 1 × 1 struct by name.

        Raises FileError for other variables.
        """
        if not self.is_struct or any(side != 1 for side in self.shape):
            raise FileError(f"{self.name} is not a single struct")
        _, place, size = _element(self.words, self.start, self.stop, self.name)
        # Names have a fixed width.
        raw = self.words.reshape(-1).view(np.uint8)
        width = int(raw[place : place + 4].view(f"{self.order}i4")[0]) if size == 4 else 0
        row = _next_row(self.words, self.start)
        _, place, size = _element(self.words, row, self.stop, self.name)
        if not 0 < width <= 64 or size % width:
            raise FileError(f"{self.name}: the names of its fields are damaged")
        names = [raw[i : i + width].tobytes() for i in range(place, place + size, width)]
        # The values follow in the same order; unsupported classes are skipped.
        row, by_name = _next_row(self.words, row), {}
        for raw_name in names:
            name = f"{self.name}.{raw_name.partition(bytes(1))[0].decode('ascii', 'replace')}"
            _element(self.words, row, self.stop, name)
            with suppress(_Other):
                by_name[name.rpartition(".")[2]] = _matrix(self.words, self.order, row, name)
            row = _next_row(self.words, row)
        return by_name

    def lists(self) -> tuple[Int, Int]:
        """Return a cell array of integer vectors as CSR: offsets and concatenated values.

        Raises FileError if damaged.
        """
        return gather_lists(self.words, self.order, self._children(), self.name)

    def nested_lists(self) -> tuple[Int, Int, Int]:
        """Return a cell array of cell arrays of integer vectors as nested CSR: two offset arrays and values.

        Raises FileError if damaged.
        """
        outer = self._children()
        _, kinds, counts = matrix_heads(self.words, outer, self.name)
        if (kinds != _CELL).any():
            raise FileError(f"{self.name}: cell {int(np.argmax(kinds != _CELL))} is not a cell array")
        cell_offsets = np.concatenate(([0], np.cumsum(counts)))
        if cell_offsets[-1] > len(self.words):
            raise FileError(f"{self.name}: its cells declare more entries than the file can hold")
        # Remove the headers of the outer cells; the inner cells then follow one another.
        last = int(outer[-1] + 1 + -(-int(self.words[outer[-1], 1]) // 8)) if len(outer) else 0
        inner_rows = np.ones(last, bool)
        inner_rows[: int(outer[0]) if len(outer) else 0] = False
        for shift in range(1 + INSIDE):
            inner_rows[outer + shift] = False
        places = np.flatnonzero(inner_rows)
        inner, _ = record_starts(self.words[places], int(cell_offsets[-1]), matrix_ends)
        loop_offsets, values = gather_lists(self.words, self.order, frozen_int(places[inner]), self.name)
        return frozen_int(cell_offsets), loop_offsets, values

    def _children(self) -> Int:
        """Return the first row of each entry of a cell array."""
        if not self.is_cell:
            raise FileError(f"{self.name} is not a cell array")
        count = int(np.prod(self.shape, dtype=object))
        starts, _ = record_starts(self.words[self.start : self.stop], count, matrix_ends)
        return frozen_int(starts + self.start)


def variables(content: bytes) -> dict[str, Variable]:
    """Return the numeric, struct and cell variables of a file by name.

    Other classes are skipped.

    Raises
    ------
    FileError
        For another version, or a truncated or damaged file.
    """
    if content[:10] == b"MATLAB 7.3" or content[:8] == b"\x89HDF\r\n\x1a\n":
        raise FileError("was saved by MATLAB with -v7.3, which is HDF5; save it with -v7")
    if len(content) < 128 or content[126:128] not in (b"IM", b"MI"):
        raise FileError("is not a MATLAB level-5 file (as written by save -v7), or is truncated")
    order: Literal["<", ">"] = "<" if content[126:128] == b"IM" else ">"
    by_name = {}
    for words in _elements(content, order):
        try:
            variable = _matrix(words, order, 0, "")
        except _Other:
            continue
        by_name[variable.name] = variable
    return by_name


class _Other(Exception):
    """Exception for a variable of an unsupported MATLAB class."""


def _elements(content: bytes, order: Literal["<", ">"]) -> Iterator[NDArray[Any]]:
    """Yield the uncompressed bytes of each variable, as rows of eight bytes."""
    place, free_bytes = 128, _ROOM + _EXPANSION * len(content)
    while place < len(content):
        if len(content) - place < 8:
            raise FileError("truncated: the last variable is incomplete")
        kind, size = np.frombuffer(content, f"{order}u4", 2, place).tolist()
        if place + 8 + size > len(content):
            raise FileError(
                f"truncated: a variable of {size} bytes is declared, but {len(content) - place - 8} follow"
            )
        if kind == _COMPRESSED:
            data = _inflate_variable(content[place + 8 : place + 8 + size], order, free_bytes)
            free_bytes -= len(data)
            yield _rows(data, order, 0, len(data))
        elif kind == MATRIX:
            yield _rows(content, order, place, 8 + size)
        else:
            raise FileError(f"expected a variable, found an element of type {kind}")
        place += 8 + size


def _rows(data: bytes, order: Literal["<", ">"], place: int, size: int) -> NDArray[Any]:
    """View bytes as rows of two 32-bit integers, with the last row padded by zeros."""
    if size % 8:
        data, place = data[place : place + size].ljust(-(-size // 8) * 8, b"\0"), 0
    return np.frombuffer(data, f"{order}i4", -(-size // 8) * 2, place).reshape(-1, 2)


def _inflate_variable(data: bytes, order: str, max_bytes: int) -> bytes:
    """Decompress a variable to the size that it declares."""
    codec = zlib.decompressobj()
    try:
        head = codec.decompress(data, 8)
        if len(head) < 8:
            raise FileError("truncated: a compressed variable ends before its size")
        kind, size = np.frombuffer(head, f"{order}u4").tolist()
        if kind != MATRIX or size > max_bytes:
            raise FileError(f"a compressed variable of {len(data)} bytes declares a size of {size}")
        body = codec.decompress(codec.unconsumed_tail, max(size, 1))
    except zlib.error as error:
        raise FileError(f"a compressed variable is damaged: {error}") from None
    if len(body) < size:
        raise FileError(f"truncated: a variable of {size} bytes is declared, but {len(body)} were found")
    return head + body[:size]


def _element(words: NDArray[Any], row: int, stop: int, name: str) -> tuple[int, int, int]:
    """Return data type, data offset in bytes, and data size for the element that starts at a row."""
    if row >= stop:
        raise FileError(f"{name} is truncated")
    kind, size = (int(word) for word in words[row])
    if kind >> 16:
        kind, size, place = kind & 0xFFFF, kind >> 16, 8 * row + 4
    else:
        place = 8 * row + 8
    if size < 0 or (place % 8 and size > 4) or place + size > 8 * stop:
        raise FileError(f"{name} is damaged: it declares {size} bytes, more than there are")
    return kind, place, size


def _next_row(words: NDArray[Any], row: int) -> int:
    """Return the index of the row after the element that starts at ``row``."""
    kind, size = (int(word) for word in words[row])
    return row + 1 if kind >> 16 else row + 1 + -(-size // 8)


def _matrix(words: NDArray[Any], order: str, row: int, name: str) -> Variable:
    """Parse the variable that starts at a row: class, dimensions, name."""
    kind, place, size = _element(words, row, len(words), name or "a variable")
    stop = (place + size) // 8
    if kind != MATRIX or size < 8:
        raise _Other
    # Flags and class.
    _, place, _ = _element(words, row + 1, stop, name or "a variable")
    flags = int(words[place // 8, 0])
    kind = flags & 0xFF
    if kind not in (_CELL, _STRUCT, *NUMBERS):
        raise _Other
    # Dimensions.
    row = row + 3
    sort, place, size = _element(words, row, stop, name or "a variable")
    raw = words.reshape(-1).view(np.uint8)
    if sort != 5 or size % 4 or not 8 <= size <= 128:
        raise FileError(f"{name or 'a variable'} lacks valid dimensions")
    shape = tuple(raw[place : place + size].view(f"{order}i4").tolist())
    if min(shape) < 0:
        raise FileError(f"{name or 'a variable'} has negative dimensions: {shape}")
    # Name, after which the data begin.
    row = _next_row(words, row)
    _, place, size = _element(words, row, stop, name or "a variable")
    stored_name = raw[place : place + size].tobytes().decode("ascii", "replace")
    if flags & 0x800:
        raise FileError(f"{name or stored_name} holds complex numbers, expected real ones")
    return Variable(name or stored_name, kind, shape, words, order, _next_row(words, row), stop)
