"""Read MatrixMarket files: sparse or dense matrices of real numbers or integers, and sparsity patterns.

Declared sizes are compared with the file size before memory is allocated.

Boisvert, Pozo, Remington, The Matrix Market exchange formats: initial design, NISTIR 5935, 1996.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.errors import FileError
from agglo_core.files.text_numbers import line_of, number_rows

EMPTY_ROWS = 1 << 20
"""Maximum number of rows without entries, which need memory but no bytes in the file."""

_BANNER = "%%MatrixMarket matrix coordinate|array real|integer|pattern general|symmetric|skew-symmetric"
_KINDS, _FIELDS = ("coordinate", "array"), ("real", "double", "integer", "pattern")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric")
_COMMENTS = re.compile(rb"(?:[ \t\r]*(?:%[^\n]*)?\n)*+")
_DIGITS = 18  # decimal digits of a size, which fits into 64 bits
_MARK = b"\xef\xbb\xbf"  # byte order mark


class _Header(NamedTuple):
    """Header of a MatrixMarket file: storage layout, number type, symmetry, sizes, data offset."""

    kind: str
    field: str
    symmetry: str
    sizes: tuple[int, ...]
    start: int


def read_matrix_market(path: Path, rows: int | None = None) -> Any:
    """Read a MatrixMarket file as ``coo_array``, or as dense array if it stores all entries.

    Implied entries of symmetric and skew-symmetric files are filled in. Integers become int64, other numbers
    float64, pattern entries 1.

    Parameters
    ----------
    path : Path
    rows : int, optional
        Expected row count; by default any number consistent with the file size.

    Raises
    ------
    FileError
        With the line number, for another layout, complex numbers, sizes beyond the file, and entries that
        are missing, superfluous, broken or out of range.
    """
    content = path.read_bytes()
    header = _header(content)
    n, m = header.sizes[:2]
    if rows is not None and n != rows:
        raise FileError(f"has {n} rows, expected {rows}")
    if n != m and header.symmetry != "general":
        raise FileError(f"a {header.symmetry} matrix must be square, but its header declares {n} x {m}")
    if max(m if n == rows else n, m) > len(content) + EMPTY_ROWS:
        raise FileError(f"its header declares {n} x {m} in a file of {len(content)} bytes")
    return _entries(content, header) if header.kind == "coordinate" else _dense(content, header)


def _header(content: bytes) -> _Header:
    start = len(_MARK) if content.startswith(_MARK) else 0
    end = content.find(b"\n", start) + 1 or len(content)
    banner = content[start:end]
    words = banner[:200].decode("ascii", "replace").lower().split()
    is_header = len(words) == 5 and words[:2] == ["%%matrixmarket", "matrix"] and words[2] in _KINDS
    if not is_header or words[3] not in _FIELDS or words[4] not in _SYMMETRIES:
        excerpt = banner[:60].decode("ascii", "backslashreplace").strip()
        raise FileError(f"line 1: expected {_BANNER}, found {excerpt!r}")
    kind, field, symmetry = words[2:]
    if kind == "array" and field == "pattern":
        raise FileError("line 1: 'array' cannot be combined with 'pattern', which stores no values")
    comments = _COMMENTS.match(content, end)
    place = comments.end() if comments is not None else end
    start = content.find(b"\n", place) + 1 or len(content)
    sizes = content[place:start].split(None, 3)
    count = 3 if kind == "coordinate" else 2
    if len(sizes) != count or not all(size.isdigit() and len(size) <= _DIGITS for size in sizes):
        excerpt = content[place : min(start, place + 40)].decode("ascii", "backslashreplace").strip()
        names = "rows, columns and entries" if count == 3 else "rows and columns"
        raise FileError(f"line {line_of(content, place)}: expected the numbers of {names}, found {excerpt!r}")
    return _Header(kind, field, symmetry, tuple(int(size) for size in sizes), start)


def _table(content: bytes, header: _Header, entries: int, width: int) -> NDArray[Any]:
    """Read the lines after the header as a table ``(entries, width)``."""
    n_bytes = len(content) - header.start
    if entries * 2 * width - 1 > n_bytes:  # one digit and one separator per number
        raise FileError(f"its header declares {entries} entries, but only {n_bytes} bytes follow")
    dtype = np.int64 if header.field in ("integer", "pattern") else np.float64
    table = number_rows(content, header.start, width, dtype)
    if len(table) != entries:
        raise FileError(f"holds {len(table)} entries, but its header declares {entries}")
    return table


def _entries(content: bytes, header: _Header) -> sparse.coo_array:
    n, m, count = header.sizes
    table = _table(content, header, count, 2 if header.field == "pattern" else 3)
    places = table[:, :2]
    bad = ~((places >= 1) & (places <= (n, m)) & (places == np.floor(places))).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        i, j = places[first]
        raise FileError(f"entry {first + 1} of {count} is at ({i:g}, {j:g}), expected 1..{n}, 1..{m}")
    index = np.int32 if max(n, m) < 2**31 else np.int64
    i, j = (places[:, axis].astype(index) - 1 for axis in (0, 1))
    values = table[:, 2].copy() if header.field != "pattern" else np.ones(count)
    if header.symmetry != "general":
        i, j, values = _mirror_entries(i, j, values, header.symmetry)
    return sparse.coo_array((values, (i, j)), shape=(n, m))


def _mirror_entries(
    i: NDArray[Any], j: NDArray[Any], values: NDArray[Any], symmetry: str
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Complete a symmetric or skew-symmetric matrix given by the entries of one triangle.

    Files should list one triangle only, because a pair listed on both sides would count twice.
    """
    above, below = i < j, i > j
    if above.any() and below.any():
        n = np.int64(max(i.max(), j.max()) + 1)
        repeats = np.intersect1d(i[above] * n + j[above], j[below] * n + i[below])
        if len(repeats):
            a, b = (int(index) + 1 for index in divmod(repeats[0], n))
            raise FileError(
                f"a {symmetry} file may list one triangle only, found both ({a}, {b}) and ({b}, {a})"
            )
    off_diagonal = above | below
    if symmetry == "skew-symmetric":
        if not off_diagonal.all():
            k = int(i[np.argmin(off_diagonal)]) + 1
            raise FileError(f"a skew-symmetric file may not list diagonal entries, found ({k}, {k})")
        opposite = -values
    else:
        opposite = values[off_diagonal]
    i, j = np.concatenate((i, j[off_diagonal])), np.concatenate((j, i[off_diagonal]))
    return i, j, np.concatenate((values, opposite))


def _dense(content: bytes, header: _Header) -> NDArray[Any]:
    """Read a dense matrix stored by columns (only the lower triangle if it is symmetric)."""
    n, m = header.sizes
    if header.symmetry == "general":
        return _table(content, header, n * m, 1).reshape(m, n).T.copy()
    skew = header.symmetry == "skew-symmetric"
    count = n * (n - 1) // 2 if skew else n * (n + 1) // 2
    values = _table(content, header, count, 1)[:, 0]
    matrix = np.zeros((n, n), values.dtype)
    upper = np.triu_indices(n, 1 if skew else 0)  # by rows, like the lower triangle by columns
    matrix[upper] = -values if skew else values
    matrix.T[upper] = values
    return matrix
