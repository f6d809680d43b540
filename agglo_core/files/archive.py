"""Read arrays from ``.npz`` archives and ``.npy`` files in bounded memory.

Headers are checked against the file and the expected arrays before memory is allocated. Archive members are
inflated step by step, never beyond the declared size.
"""

from __future__ import annotations

import io
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError

WHOLE, REAL = "iu", "biuf"
"""Kinds of dtype for integers and for real numbers."""

Shape = Sequence[int | None]
"""Lengths of an array; None accepts any length."""

_WORDS = {WHOLE: "integers", REAL: "real numbers", "f": "floating-point numbers", "fiu": "real numbers"}
_STEP = 1 << 20  # bytes inflated per step
_HEADER = 10_000  # bytes of an array header; numpy does not evaluate longer headers
_EXPANSION = 1100  # deflate cannot exceed 1032
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # Python inflates other methods all at once
_CORRUPT = (
    ValueError,
    TypeError,
    KeyError,
    SyntaxError,
    OverflowError,
    EOFError,
    RecursionError,
    RuntimeError,
    NotImplementedError,
    struct.error,
    tokenize.TokenError,
    lzma.LZMAError,
    zipfile.BadZipFile,
    zlib.error,
)


class Archive:
    """An ``.npz`` archive whose arrays are read and checked one at a time.

    Parameters
    ----------
    path : Path
    most : int, optional
        Maximum total size of all arrays taken from it, in bytes; by default only deflate's limit applies.

    Attributes
    ----------
    members : dict of str to ZipInfo
        By array name.

    Raises
    ------
    FileError
        If it is no archive.
    """

    def __init__(self, path: Path, most: int | None = None) -> None:
        self._path, self._left = path, most
        try:
            with zipfile.ZipFile(path) as archive:
                infos = archive.infolist()
        except _CORRUPT as error:
            raise FileError(f"not an npz archive, or truncated: {error}") from None
        if sum(info.compress_size for info in infos) > path.stat().st_size:
            raise FileError(
                "not an npz archive: its members overlap, or declare more bytes than the file has"
            )
        self.members = {info.filename.removesuffix(".npy"): info for info in infos}

    def take(self, name: str, kinds: str, shape: Shape | None, most: int | None = None) -> NDArray[Any]:
        """Return the array with this name, of an accepted data type, shape and size.

        Parameters
        ----------
        name : str
        kinds : str
            Accepted dtype kinds, such as ``"iu"``.
        shape : sequence of int or None, optional
            Expected lengths, None for any length; None for any shape.
        most : int, optional
            Maximum size in bytes.

        Raises
        ------
        FileError
            With the array name, if it is missing, corrupt, too large, or has another dtype or shape.
        """
        if name not in self.members:
            raise FileError(f"array {name!r} is missing; found {', '.join(list(self.members)[:20])}")
        with _name_array_in_errors(name), zipfile.ZipFile(self._path) as archive:
            info = self._checked(name)
            with archive.open(info) as stream:
                header = _header(stream, info.file_size)
                _check(name, header, kinds, shape, most)
                self._spend(name, header.size * header.dtype.itemsize)
                return _values(stream, header)

    def integers(self, name: str, shape: Shape) -> Int:
        """Return the integer array with this name as int64.

        Raises FileError as :meth:`take`.
        """
        values = self.take(name, WHOLE, shape)
        largest = int(values.max(initial=0))
        if largest > np.iinfo(np.int64).max:
            raise FileError(f"array {name!r} holds {largest}, more than an int64 can hold")
        return frozen_int(values.astype(np.int64, copy=False))

    def _spend(self, name: str, size: int) -> None:
        if self._left is None:
            return
        if size > self._left:
            raise FileError(
                f"array {name!r} has {size} bytes, far more than a file of {self._path.stat().st_size} bytes "
                "is expected to hold; store it uncompressed"
            )
        self._left -= size

    def _checked(self, name: str) -> zipfile.ZipInfo:
        info, file_size = self.members[name], self._path.stat().st_size
        if info.compress_type not in _METHODS:
            raise ValueError(f"it uses compression method {info.compress_type}, expected deflate or none")
        if info.compress_size > file_size or info.file_size > _EXPANSION * info.compress_size + 1024:
            raise ValueError(f"it declares {info.file_size} bytes in a file of {file_size}")
        return info


def read_npy(path: Path, kinds: str) -> NDArray[Any]:
    """Read the array in an ``.npy`` file.

    Raises
    ------
    FileError
        If it is corrupt, or its dtype kind is not in ``kinds``.
    """
    with _name_array_in_errors(path.stem), path.open("rb") as stream:
        header = _header(stream, path.stat().st_size)
        _check(path.stem, header, kinds, None, None)
        return _values(stream, header)


@contextmanager
def _name_array_in_errors(name: str) -> Iterator[None]:
    """Convert exceptions of zipfile and numpy to a FileError that names the array."""
    try:
        yield
    except FileError:
        raise
    except _CORRUPT as error:
        raise FileError(f"array {name!r} is corrupt: {error}") from None


_LAYOUTS = {(1, 0): (npy.read_array_header_1_0, 2), (2, 0): (npy.read_array_header_2_0, 4)}
"""Header reader per npy version, and the width of the length field in bytes."""


class _Header(NamedTuple):
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    size: int


def _header(stream: IO[bytes], size: int) -> _Header:
    """Read an array header: shape, order and data type.

    Raises ValueError unless it accounts for ``size`` bytes in total.
    """
    version = npy.read_magic(stream)
    read, width = _LAYOUTS.get(version, (None, 0))
    if read is None:
        raise ValueError(f"npy version {version} is not supported")
    start = stream.read(width)
    length = int.from_bytes(start, "little")
    if length > _HEADER:
        raise ValueError(f"its header has {length} bytes, expected at most {_HEADER}")
    shape, fortran, dtype = read(io.BytesIO(start + stream.read(length)))
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    count, n_bytes = 1, size - npy.MAGIC_LEN - width - length
    for length in shape:
        count *= length
    if count * dtype.itemsize != n_bytes:
        raise ValueError(f"its header declares {count} × {dtype}, but {n_bytes} bytes follow")
    return _Header(shape, fortran, dtype, count)


def _check(name: str, header: _Header, kinds: str, shape: Shape | None, most: int | None) -> None:
    stored_shape = header.shape
    if header.dtype.kind not in kinds or (shape is not None and len(stored_shape) != len(shape)):
        dimensions = "" if shape is None else f", {len(shape)}-D"
        raise FileError(
            f"array {name!r} has dtype {header.dtype} and shape {stored_shape}, "
            f"expected {_WORDS.get(kinds, f'kind {kinds}')}{dimensions}"
        )
    if shape is not None and any(
        expected not in (None, length) for expected, length in zip(shape, stored_shape, strict=True)
    ):
        declared = ", ".join("any" if expected is None else str(expected) for expected in shape)
        raise FileError(
            f"array {name!r} has shape {stored_shape}, but the other arrays require ({declared}): "
            "the file is corrupt"
        )
    size = header.size * header.dtype.itemsize
    if most is not None and size > most:
        raise FileError(f"array {name!r} has {size} bytes, expected at most {most}")


def _values(stream: IO[bytes], header: _Header) -> NDArray[Any]:
    """Read an array's values after its header.

    Raises ValueError if the archive holds fewer bytes.
    """
    values = np.empty(header.size, header.dtype)
    buffer, place = values.view(np.uint8), 0
    while place < len(buffer):
        step = stream.read(min(_STEP, len(buffer) - place))
        if not step:
            raise ValueError(f"it holds {place} bytes, but its header declares {len(buffer)}")
        buffer[place : place + len(step)] = np.frombuffer(step, np.uint8)
        place += len(step)
    values = values.reshape(header.shape, order="F" if header.fortran else "C")
    return values.astype(header.dtype.newbyteorder("="), copy=False)
