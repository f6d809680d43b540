"""Arrays of a zip archive in numpy's layout, read step by step: never more than the file declares."""

from __future__ import annotations

import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from agglo_core.errors import FileError

__all__ = ["Archive"]

Shape = Sequence[int | None]
"""Lengths of an array; None where any will do."""

_STEP = 1 << 20  # bytes inflated at once
_EXPANSION = 1100  # deflate cannot exceed 1032
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # of others Python inflates all at once
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
    """A zip archive of arrays.

    Attributes
    ----------
    members : dict of str to ZipInfo
        By the name of the array.

    Raises
    ------
    FileError
        If it is no archive.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive:
                infos = archive.infolist()
        except _CORRUPT as error:
            raise FileError(f"not an npz archive, or truncated: {error}") from None
        if sum(info.compress_size for info in infos) > path.stat().st_size:
            raise FileError("not an npz archive: its members overlap, or claim more bytes than there are")
        self.members = {info.filename.removesuffix(".npy"): info for info in infos}

    def take(self, name: str, kinds: str, shape: Shape, most: int | None = None) -> NDArray[Any]:
        """The array, once its header agrees with the archive and with what is expected.

        Parameters
        ----------
        name : str
        kinds : str
            Kinds of dtype that are accepted, such as ``"iu"``.
        shape : sequence of int or None
            Its lengths, None where any will do.
        most : int, optional
            Bytes it may have.

        Raises
        ------
        FileError
            Naming the array: missing, corrupt, of another dtype or shape, longer than allowed.
        """
        if name not in self.members:
            raise FileError(f"array {name!r} is missing; found {', '.join(list(self.members)[:20])}")
        try:
            with zipfile.ZipFile(self._path) as archive:
                info = self._checked(name)
                with archive.open(info) as stream:
                    header = _header(stream, info.file_size)
                    _check(name, header, kinds, shape, most)
                    return _values(stream, header)
        except FileError:
            raise
        except _CORRUPT as error:
            raise FileError(f"array {name!r} is corrupt: {error}") from None

    def _checked(self, name: str) -> zipfile.ZipInfo:
        info, room = self.members[name], self._path.stat().st_size
        if info.compress_type not in _METHODS:
            raise ValueError(f"it is compressed by method {info.compress_type}, expected deflate or none")
        if info.compress_size > room or info.file_size > _EXPANSION * info.compress_size + 1024:
            raise ValueError(f"it claims {info.file_size} bytes in a file of {room}")
        return info


class _Header(NamedTuple):
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    size: int


def _header(stream: IO[bytes], size: int) -> _Header:
    """The header of an array, or ValueError unless it accounts for ``size`` bytes in all."""
    version = npy.read_magic(stream)
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"npy version {version} is not supported")
    shape, fortran, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    count, rest = 1, size - stream.tell()
    for length in shape:
        count *= length
    if count * dtype.itemsize != rest:
        raise ValueError(f"its header says {count} × {dtype}, but {rest} bytes follow")
    return _Header(shape, fortran, dtype, count)


def _check(name: str, header: _Header, kinds: str, shape: Shape, most: int | None) -> None:
    given = header.shape
    if header.dtype.kind not in kinds or len(given) != len(shape):
        raise FileError(
            f"array {name!r} has dtype {header.dtype} and shape {given}, "
            f"expected kind {' or '.join(kinds)} and {len(shape)} dimensions"
        )
    if any(wanted not in (None, length) for wanted, length in zip(shape, given, strict=True)):
        declared = ", ".join("any" if wanted is None else str(wanted) for wanted in shape)
        raise FileError(
            f"array {name!r} has shape {given}; by the other arrays it is ({declared}): the file is corrupt"
        )
    size = header.size * header.dtype.itemsize
    if most is not None and size > most:
        raise FileError(f"array {name!r} has {size} bytes, expected at most {most}")


def _values(stream: IO[bytes], header: _Header) -> NDArray[Any]:
    """The values behind a header, or ValueError if the archive holds fewer bytes."""
    values = np.empty(header.size, header.dtype)
    room, place = values.view(np.uint8), 0
    while place < len(room):
        step = stream.read(min(_STEP, len(room) - place))
        if not step:
            raise ValueError(f"it holds {place} bytes, its header declares {len(room)}")
        room[place : place + len(step)] = np.frombuffer(step, np.uint8)
        place += len(step)
    values = values.reshape(header.shape, order="F" if header.fortran else "C")
    return values.astype(header.dtype.newbyteorder("="), copy=False)
