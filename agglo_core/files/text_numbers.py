"""Convert text to arrays of numbers and back, many numbers at a time.

Errors name the line and the invalid word.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError

_FORTRAN = bytes.maketrans(b"Dd", b"Ee")  # 1.5D-3, as Fortran writes doubles
_LINES = 1 << 16  # lines per write
_PIECE = 1 << 19  # bytes per conversion, to bound temporary memory
_LARGEST = np.iinfo(np.int64).max


def reals(content: bytes, start: int = 0, stop: int | None = None) -> Float:
    """Convert the real numbers in ``content[start:stop]`` to an array.

    Raises
    ------
    FileError
        With the line of the first invalid word.
    """
    return frozen_float(_parse_range(content, start, stop, np.float64))


def integers(content: bytes, start: int = 0, stop: int | None = None) -> Int:
    """Convert the integers in ``content[start:stop]`` to an array.

    Raises FileError as :func:`reals`.
    """
    values = _parse_range(content, start, stop, np.int64)
    if values.size and (values.max() == _LARGEST or values.min() == -_LARGEST - 1):  # saturated, or equal
        _check_largest(content, start, len(content) if stop is None else stop)
    return frozen_int(values)


def _check_largest(content: bytes, start: int, stop: int) -> None:
    """Raise FileError for a number beyond int64, with its line."""
    for match in re.finditer(rb"[-+]?\d{19,}", content[start:stop]):
        digits = match[0].lstrip(b"+-0")
        if len(digits) > 19 or not -_LARGEST - 1 <= int(match[0]) <= _LARGEST:
            line = line_of(content, start + match.start())
            raise FileError(f"line {line}: it holds a number too large for an int64")


def number_rows(content: bytes, start: int, width: int, dtype: type = np.float64) -> NDArray[Any]:
    """Read a table ``(rows, width)`` from non-blank text lines.

    Parameters
    ----------
    content : bytes
    start : int
        Position of the first line.
    width : int
        Numbers per line.
    dtype : float64 or int64

    Raises
    ------
    FileError
        With the line number, for an invalid word or a wrong count.
    """
    parse = integers if dtype is np.int64 else reals
    parts: list[NDArray[Any]] = [np.empty((0, width), dtype)]
    while start < len(content):
        stop = content.find(b"\n", start + _PIECE) + 1 or len(content)
        values = parse(content, start, stop)
        _check_widths(content, start, stop, width, len(values))
        parts.append(values.reshape(-1, width))
        start = stop
    return np.concatenate(parts)


def _check_widths(content: bytes, start: int, stop: int, width: int, count: int) -> None:
    """Raise FileError unless each non-blank line has ``width`` words, and the text ``count`` in total."""
    codes = np.frombuffer(content, np.uint8, stop - start, start)
    word = codes > ord(" ")
    word[1:] &= ~word[:-1]  # starts of words; the right side is a copy
    begins, ends = np.flatnonzero(word), np.flatnonzero(codes == ord("\n"))
    if (  # usual case: no blank lines, and a final line end
        len(begins) == count == len(ends) * width
        and (begins[width - 1 :: width] < ends).all()
        and (begins[width::width] > ends[:-1]).all()
    ):
        return
    line = np.searchsorted(ends, begins)
    counts = np.bincount(line, minlength=1)
    wrong = np.flatnonzero((counts > 0) & (counts != width))
    if len(wrong):
        number = line_of(content, start) + int(wrong[0])
        raise FileError(f"line {number}: expected {width} numbers, found {counts[wrong[0]]}")
    if len(begins) != count:
        raise FileError(f"the numbers from line {line_of(content, start)} on cannot be read")


def words_per_line(text: bytes) -> Int:
    """Return the word count per non-blank text line."""
    codes = np.frombuffer(text, np.uint8)
    word = codes > ord(" ")
    begins = np.flatnonzero(word & np.concatenate(([True], ~word[:-1])))
    line = np.searchsorted(np.flatnonzero(codes == ord("\n")), begins)
    counts = np.bincount(line) if len(line) else np.empty(0, np.int64)
    return frozen_int(counts[counts > 0])


def line_of(content: bytes, place: int) -> int:
    """Return the number of the line (from 1) that contains the byte with index ``place``."""
    return content.count(b"\n", 0, place) + 1


def _parse_range(content: bytes, start: int, stop: int | None, dtype: type) -> NDArray[Any]:
    stop = len(content) if stop is None else stop
    text = content[start:stop] if (start, stop) != (0, len(content)) else content
    if not text or text.isspace():
        return np.empty(0, dtype)
    try:
        return _parse(text, dtype)
    except ValueError:
        pass
    if dtype is np.float64:
        try:
            return _parse(text.translate(_FORTRAN), dtype)
        except ValueError:
            pass
    raise _error(content, start, stop, dtype)


def _parse(text: bytes, dtype: type) -> NDArray[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # the error of numpy before 2.4
        try:
            return np.fromstring(text, dtype, sep=" ")
        except DeprecationWarning as error:
            raise ValueError(str(error)) from None


def _error(content: bytes, start: int, stop: int, dtype: type) -> FileError:
    """Create the error message for the first word in ``content[start:stop]`` that is not a number."""
    first = line_of(content, start)
    for number, line in enumerate(content[start:stop].split(b"\n"), first):
        for word in line.split():
            try:
                _parse(word.translate(_FORTRAN) if dtype is np.float64 else word, dtype)
            except ValueError:
                excerpt = word[:20].decode("ascii", "backslashreplace")
                kind = "a number" if dtype is np.float64 else "a whole number"
                return FileError(f"line {number}: expected {kind}, found {excerpt!r}")
    return FileError(f"the numbers from line {first} on cannot be read")


def real_lines(rows: ArrayLike, prefix: str = "") -> str:
    """Format each row of a table ``(n, k)`` as a text line, with digits for an exact round trip."""
    table = np.asarray(rows, np.float64)
    line = prefix + " ".join(["%r"] * table.shape[1]) + "\n"
    parts = [table[i : i + _LINES] for i in range(0, len(table), _LINES)]
    return "".join(line * len(part) % tuple(part.ravel().tolist()) for part in parts)


def integer_lines(offsets: Int, values: Int, forms: Sequence[str] = ()) -> str:
    """Format each row ``values[offsets[i]:offsets[i + 1]]`` of a CSR as a text line.

    Parameters
    ----------
    offsets : (n + 1,) int
    values : int
    forms : sequence of str, optional
        Format ``forms[k]`` for a row of k numbers, with ``%d`` for each; by default separated by spaces.
    """
    sizes = np.diff(offsets)
    widest = int(sizes.max(initial=0))
    shapes = list(forms) or [" ".join(["%d"] * k) + "\n" for k in range(widest + 1)]
    parts = []
    for start in range(0, len(sizes), _LINES):
        stop = min(start + _LINES, len(sizes))
        form = "".join(map(shapes.__getitem__, sizes[start:stop].tolist()))
        parts.append(form % tuple(values[offsets[start] : offsets[stop]].tolist()))
    return "".join(parts)
