"""Create the bytes of MATLAB variables: numeric matrices, structs, and cell arrays of vectors."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, fits_in_index, frozen_int
from agglo_core.errors import FileError

Words = NDArray[np.int32]

_MATRIX, _COMPRESSED, _CELL, _STRUCT = 14, 15, 1, 2
_DOUBLE, _BYTES, _LONG = 6, 9, 14
_HEAD = 6  # rows of eight bytes before the data of a matrix without a name: its tag, flags, dimensions, name
_LARGEST = (1 << 31) - 1  # bytes, MATLAB's limit for a variable
_LEVEL = 1  # zlib level: higher levels take twice the time and save a few per cent
_EXACT = 1 << 53  # integers of at least this size are not all exact as doubles


def write_variables(path: Path, variables: Iterable[bytes], *, compress: bool) -> None:
    """Write a MATLAB file with variables created by this module's functions.

    Raises
    ------
    FileError
        If a matrix exceeds the format's limit.
    """
    with open(path, "wb") as stream:
        stream.write(b"MATLAB 5.0 MAT-file, written by agglo".ljust(124) + b"\x00\x01IM")
        for variable in variables:
            if len(variable) > _LARGEST:
                raise FileError(
                    f"a variable takes {len(variable)} bytes, but .mat files (-v7) hold at most {_LARGEST}"
                )
            if compress:
                packed = zlib.compress(variable, _LEVEL)
                stream.write(struct.pack("<II", _COMPRESSED, len(packed)))
                stream.write(packed)
            else:
                stream.write(variable)


def numbers(name: str, values: ArrayLike) -> bytes:
    """Return the bytes of a numeric MATLAB variable, of class double where possible.

    Integers are stored in 32 bits if they fit, as MATLAB does.
    """
    array = np.asarray(values)
    if array.ndim == 1:
        array = array[:, None]
    sort, stored = _DOUBLE, array.astype("<f8")
    if array.dtype == np.uint8:
        sort, stored = _BYTES, array
    elif fits_in_index(array):
        stored = array.astype("<i4")
    elif array.dtype == np.int64 and ((array >= _EXACT) | (array <= -_EXACT)).any():
        sort, stored = _LONG, array.astype("<i8")
    kind = {"|u1": 2, "<i4": 5, "<i8": 12}.get(stored.dtype.str, 9)
    return _matrix(name, sort, array.shape, _element(kind, stored.tobytes("F")))


def structure(name: str, fields: Mapping[str, bytes]) -> bytes:
    """Return the bytes of a MATLAB struct, given the fields as matrices without names."""
    names = b"".join(field.encode("ascii").ljust(32, b"\0") for field in fields)
    head = struct.pack("<HHi", 5, 4, 32) + _element(1, names)
    return _matrix(name, _STRUCT, (1, 1), head + b"".join(fields.values()))


def cell_array(name: str, shape: tuple[int, int], cells: Words) -> bytes:
    """Return the bytes of a cell array from the result of ``lists``, ``matrices`` or ``nested_lists``."""
    return _matrix(name, _CELL, shape, cells.tobytes())


def lists(offsets: Int, values: Int) -> Words:
    """Convert each row of a CSR to an integer row vector, an entry of a cell array."""
    sizes = np.diff(offsets)
    words, starts = _blank(sizes, (sizes + 1) // 2, 5, 4 * sizes)
    words[starts + 4, 0] = 1
    words[starts + 4, 1] = sizes
    places = np.repeat(2 * (starts + _HEAD + 1) - offsets[:-1], sizes) + np.arange(len(values))
    words.reshape(-1)[places] = values
    return words


def matrices(offsets: Int, rows: Float) -> Words:
    """Convert ``rows[offsets[i]:offsets[i + 1]]`` for each i to a two-column matrix."""
    sizes = np.diff(offsets)
    words, starts = _blank(sizes, 2 * sizes, 9, 16 * sizes)
    words[starts + 4, 0] = sizes
    words[starts + 4, 1] = 2
    places = np.repeat(starts + _HEAD + 1 - offsets[:-1], sizes) + np.arange(len(rows))
    doubles = words.reshape(-1).view("<f8")
    doubles[places] = rows[:, 0]
    doubles[places + np.repeat(sizes, sizes)] = rows[:, 1]
    return words


def nested_lists(cell_offsets: Int, loop_offsets: Int, values: Int) -> Words:
    """Convert each cell of a nested CSR to a cell array of row vectors."""
    inner = lists(loop_offsets, values)
    rows = np.concatenate(([0], np.cumsum(1 + _HEAD + (np.diff(loop_offsets) + 1) // 2)))[cell_offsets]
    starts = rows[:-1] + _HEAD * np.arange(len(rows) - 1)
    # Insert a header before the lists of each cell.
    words = np.zeros((len(inner) + _HEAD * len(starts), 2), "<i4")
    heads = np.zeros(len(words), bool)
    heads[(starts[:, None] + np.arange(_HEAD)).ravel()] = True
    words[~heads] = inner
    _fill_heads(words, frozen_int(starts), _CELL, np.diff(rows) + _HEAD)
    words[starts + 4, 0] = np.diff(cell_offsets)
    words[starts + 4, 1] = 1
    return words


def _blank(sizes: Int, data_rows: Int, kind: int, data_bytes: Int) -> tuple[Words, Int]:
    """Allocate consecutive matrices of class double, without dimensions and data.

    Return them and their first rows.
    """
    lengths = 1 + _HEAD + data_rows
    starts = np.concatenate(([0], np.cumsum(lengths)))
    words = np.zeros((int(starts[-1]), 2), "<i4")
    _fill_heads(words, frozen_int(starts[:-1]), _DOUBLE, lengths)
    words[starts[:-1] + _HEAD, 0] = kind
    words[starts[:-1] + _HEAD, 1] = data_bytes
    return words, frozen_int(starts[:-1])


def _fill_heads(words: Words, starts: Int, kind: int, lengths: Int) -> None:
    """Fill in the headers of consecutive matrices, except their dimensions."""
    words[starts, 0] = _MATRIX
    words[starts, 1] = 8 * (lengths - 1)
    words[starts + 1] = (6, 8)
    words[starts + 2, 0] = kind
    words[starts + 3] = (5, 8)
    words[starts + 5, 0] = 1


def _matrix(name: str, kind: int, shape: tuple[int, ...], body: bytes) -> bytes:
    head = _element(6, struct.pack("<II", kind, 0)) + _element(5, np.array(shape, "<i4").tobytes())
    return _element(_MATRIX, head + _element(1, name.encode("ascii")) + body)


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data.ljust(-(-len(data) // 8) * 8, b"\0")
