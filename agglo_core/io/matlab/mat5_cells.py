"""Decode all entries of a MATLAB cell array together: they are consecutive matrices without names."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type numbers of stored values and their numpy types."""

NUMBERS = range(6, 16)
"""Class numbers of numeric matrices."""

MATRIX = 14
"""Type number of a matrix element."""

INSIDE = 5
"""Number of eight-byte rows before the content of a nameless matrix."""


def matrix_ends(window: NDArray[Any]) -> Int:
    """Return for each row of a window the end of the matrix that would start there."""
    size = window[:, 1].astype(np.int64)
    fits = (window[:, 0] == MATRIX) & (size >= 0)
    return frozen_int(np.where(fits, np.arange(1, len(window) + 1) + (size + 7) // 8, 1 << 60))


def matrix_heads(words: NDArray[Any], starts: Int, name: str) -> tuple[Int, Int, Int]:
    """Return first data row, MATLAB class and entry count of matrices without names."""
    empty = words[starts, 1] == 0
    rows = np.minimum(starts, len(words) - 1 - INSIDE)
    # A plain header: flags of 8 bytes, two dimensions, no name.
    is_valid = (words[rows, 1] >= 8 * INSIDE) & (words[rows + 5, 1] == 0)
    for shift, tag in ((1, (6, 8)), (3, (5, 8))):
        for column, value in enumerate(tag):
            is_valid &= words[rows + shift, column] == value
    is_valid |= empty
    if not is_valid.all():
        raise FileError(f"{name}: cell {int(np.argmin(is_valid))} is not a 2-D matrix")
    sides = np.where(empty[:, None], 0, words[rows + 4].astype(np.int64))
    if (sides < 0).any():
        raise FileError(f"{name}: cell {int(np.argmax((sides < 0).any(axis=1)))} has negative dimensions")
    kinds = np.where(empty, 0, words[rows + 2, 0] & 0xFF)
    return frozen_int(rows + 1 + INSIDE), frozen_int(kinds), frozen_int(sides[:, 0] * sides[:, 1])


def gather_lists(words: NDArray[Any], order: str, starts: Int, name: str) -> tuple[Int, Int]:
    """Return the integers in consecutive matrices without names as CSR: offsets and values."""
    if not len(starts):
        return frozen_int([0]), frozen_int([])
    rows, kinds, counts = matrix_heads(words, starts, name)
    counts = frozen_int(np.where(np.isin(kinds, NUMBERS), counts, 0))
    # Data tags; data up to four bytes are stored inside the tag.
    ends = starts + 1 + (words[starts, 1].astype(np.int64) + 7) // 8
    tags = words[np.minimum(rows, len(words) - 1)].astype(np.int64)
    small = tags[:, 0] >> 16 != 0
    types = np.where(small, tags[:, 0] & 0xFFFF, tags[:, 0])
    sizes = np.where(small, tags[:, 0] >> 16, tags[:, 1])
    places = 8 * rows + np.where(small, 4, 8)
    # Check that the declared sizes match the entry counts and stay inside the cells.
    widths = np.array([np.dtype(TYPES[k]).itemsize if k in TYPES else 0 for k in range(16)])
    width = np.where((types >= 0) & (types < 16), widths[types & 15], 0)
    fits = (counts == 0) | ((width > 0) & (sizes == counts * width) & (places + sizes <= 8 * ends))
    if not fits.all():
        raise FileError(f"{name}: cell {int(np.argmin(fits))} is not a list of numbers, or is damaged")
    offsets = np.concatenate(([0], np.cumsum(counts)))
    values = np.empty(offsets[-1], np.int64)
    raw = words.reshape(-1).view(np.uint8)
    # Copy the values, one stored type at a time.
    for kind in np.unique(types[counts > 0]).tolist():
        lists = np.flatnonzero((types == kind) & (counts > 0))
        dtype = np.dtype(TYPES[kind])
        items = raw[: len(raw) // dtype.itemsize * dtype.itemsize].view(dtype.newbyteorder(order))  # type: ignore[arg-type]
        rank = np.arange(counts[lists].sum()) - np.repeat(
            np.cumsum(counts[lists]) - counts[lists], counts[lists]
        )
        raw_values = items[np.repeat(places[lists] // dtype.itemsize, counts[lists]) + rank]
        values[np.repeat(offsets[lists], counts[lists]) + rank] = whole_values(raw_values, name)
    return frozen_int(offsets), frozen_int(values)


def whole_values(values: NDArray[Any], name: str) -> Int:
    """Convert numbers without a fractional part to integers.

    Raises FileError for other values.
    """
    if values.dtype.kind in "iu":
        return frozen_int(values)
    whole = np.abs(values) < 2**53
    whole &= values == np.floor(np.where(whole, values, 0))
    if not whole.all():
        raise FileError(f"{name} holds {values[np.argmin(whole)]:g}, expected whole numbers")
    return frozen_int(values.astype(np.int64))
