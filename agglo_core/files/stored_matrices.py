"""Read sparse matrices and vectors from ``.npz``, ``.npy``, ``.mtx`` and text files.

An ``.npz`` has the layout of ``scipy.sparse.save_npz``, or at least ``data``, ``indices`` and ``indptr`` of a
square CSR matrix. scipy's own reader trusts the arrays and inflates them completely.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.errors import FileError
from agglo_core.files.archive import REAL, Archive, read_npy
from agglo_core.files.matrix_market import EMPTY_ROWS, read_matrix_market
from agglo_core.files.text_numbers import number_rows

_SPARE = 1 << 24
"""Allowed array bytes of a small archive."""
_RATIO = 64
"""Allowed array bytes per archive byte; at most 27 in agglo's own matrices, on uniform meshes."""
_COMPRESSED: Mapping[str, Any] = {"csr": sparse.csr_array, "csc": sparse.csc_array, "bsr": sparse.bsr_array}
_COMMENT = re.compile(rb"#[^\n]*")


def matrix_archive(path: Path, rows: int = 0) -> Archive:
    """Open an archive and limit its arrays to a multiple of the file size, plus ``rows`` numbers."""
    return Archive(path, _SPARE + _RATIO * path.stat().st_size + 8 * rows)


def read_matrix(path: Path) -> Any:
    """Read a sparse or dense matrix from an ``.npz`` or ``.mtx`` file.

    Its indices are not yet checked.

    Raises
    ------
    FileError
        If arrays or entries are missing, corrupt, of the wrong type or larger than the file allows.
    """
    return _MATRICES[path.suffix.lower()](path)


def read_vectors(path: Path, name: str, rows: int) -> NDArray[Any]:
    """Read one or several vectors, such as right-hand sides, for a matrix with ``rows`` rows.

    ``name`` is the array to read from an ``.npz`` archive.

    Its shape is given by the file; only MatrixMarket shapes are compared with ``rows``.

    Raises
    ------
    FileError
        As :func:`read_matrix`.
    """
    return _VECTORS[path.suffix.lower()](path, name, rows)


def stored_matrix(arrays: Archive) -> Any:
    """Return the sparse matrix in an ``.npz`` archive, in the storage format declared there.

    Raises
    ------
    FileError
        As :func:`read_matrix`.
    """
    form = _format(arrays)
    try:
        if form in _COMPRESSED:
            return _read_compressed(arrays, form)
        if form == "coo":
            return _read_coordinates(arrays)
        if form == "dia":
            return _read_diagonals(arrays)
    except FileError:
        raise
    except (ValueError, OverflowError) as error:  # scipy's error for inconsistent lengths
        raise FileError(f"the arrays of the {form} matrix are inconsistent: {error}") from None
    raise FileError(f"array 'format' is {form!r}, expected csr, csc, bsr, coo or dia")


def _format(arrays: Archive) -> str:
    if "format" not in arrays.members:
        return "csr"
    text = arrays.take("format", "SU", (), 4096).item()
    return text.decode("ascii", "backslashreplace") if isinstance(text, bytes) else str(text)


def _shape(arrays: Archive, entries: int) -> tuple[int, int]:
    """Return the declared shape of a matrix, if it is plausible for its nonzero count."""
    n, m = (int(size) for size in arrays.integers("shape", (2,)))
    if not 0 <= min(n, m) <= max(n, m) <= entries + EMPTY_ROWS:
        raise FileError(f"array 'shape' is ({n}, {m}), but there are {entries} entries")
    return n, m


def _read_compressed(arrays: Archive, form: str) -> Any:
    indptr, indices = arrays.integers("indptr", (None,)), arrays.integers("indices", (None,))
    data = arrays.take("data", REAL, (len(indices), *([None] * 2 if form == "bsr" else [])))
    n = len(indptr) - 1
    shape = _shape(arrays, data.size) if "shape" in arrays.members else (n, n)
    if n > len(indices) + EMPTY_ROWS:
        raise FileError(f"array 'indptr' declares {n} rows, but there are {len(indices)} entries")
    return _COMPRESSED[form]((data, indices, indptr), shape=shape)


def _read_coordinates(arrays: Archive) -> Any:
    if "coords" in arrays.members:
        i, j = arrays.integers("coords", (2, None))
    else:
        i, j = arrays.integers("row", (None,)), arrays.integers("col", (None,))
    return sparse.coo_array((arrays.take("data", REAL, (len(i),)), (i, j)), shape=_shape(arrays, len(i)))


def _read_diagonals(arrays: Archive) -> Any:
    offsets = arrays.integers("offsets", (None,))
    data = arrays.take("data", REAL, (len(offsets), None))
    return sparse.dia_array((data, offsets), shape=_shape(arrays, data.size))


def _market_vectors(path: Path, _: str, rows: int) -> NDArray[Any]:
    matrix = read_matrix_market(path, rows)
    if isinstance(matrix, np.ndarray):
        return matrix
    size = path.stat().st_size
    if rows * matrix.shape[1] > rows + size + EMPTY_ROWS:
        raise FileError(f"its header declares {rows} x {matrix.shape[1]} in a file of {size} bytes")
    return np.asarray(matrix.toarray())


def _text_vectors(path: Path, _: str, rows: int) -> NDArray[Any]:
    """Read a table of numbers from a text file, in which # starts a comment."""
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    if b"#" in content:
        content = _COMMENT.sub(b"", content)
    start = len(content) - len(content.lstrip())
    width = len(content[start : content.find(b"\n", start) + 1 or len(content)].split())
    return number_rows(content, start, width) if width else np.empty((0, 1))


_MATRICES: Mapping[str, Callable[[Path], Any]] = {
    ".mtx": read_matrix_market,
    ".npz": lambda path: stored_matrix(matrix_archive(path)),
}
_VECTORS: Mapping[str, Callable[[Path, str, int], NDArray[Any]]] = {
    ".npy": lambda path, _, rows: read_npy(path, REAL),
    ".mtx": _market_vectors,
    ".txt": _text_vectors,
    ".npz": lambda path, name, rows: matrix_archive(path, rows).take(name, REAL, None),
}
MATRIX_SUFFIXES, VECTOR_SUFFIXES = tuple(_MATRICES), tuple(_VECTORS)
