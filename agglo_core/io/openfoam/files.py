"""Read OpenFOAM list files: text or binary, optionally gzipped, with 32- or 64-bit numbers."""

from __future__ import annotations

import re
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import strip_mark
from agglo_core.files.text_numbers import integers, reals
from agglo_core.io.openfoam.dictionaries import COMMENT, SPACE, FoamParser, word_in
from agglo_core.io.text.counted_lists import locate_lists

_LIST = re.compile(SPACE + rb"(\d{1,18})" + SPACE + rb"([({]?)")
_COMMENT = re.compile(COMMENT)
_BRACKETS = bytes.maketrans(b"()", b"  ")
_ROOM, _EXPANSION = 1 << 26, 40  # bytes allowed after inflation: fixed, and per byte of the file


class FoamFile(NamedTuple):
    """Content of an OpenFOAM file, and the number formats that its header declares."""

    name: str
    content: bytes
    start: int
    kind: str  # class in the header
    binary: bool
    label: str
    scalar: str


def has_foam(folder: Path, name: str) -> bool:
    """Return True if a folder has a file with this name, plain or gzipped."""
    return (folder / name).is_file() or (folder / f"{name}.gz").is_file()


def open_foam(folder: Path, name: str) -> FoamFile:
    """Read an OpenFOAM file, plain or gzipped, and parse its header.

    Raises FileError if missing or invalid.
    """
    path, packed_path = folder / name, folder / f"{name}.gz"
    if path.is_file():
        content = path.read_bytes()
    elif packed_path.is_file():
        content = _inflate_file(packed_path.read_bytes(), packed_path.name)
    else:
        raise FileError(f"neither {path} nor {packed_path.name} exists; run blockMesh to create the mesh")
    content = strip_mark(content)
    header = FoamParser(name, content)
    if header.token() != b"FoamFile" or header.token() != b"{":
        raise FileError(f"{name}: the header FoamFile is missing")
    words = header.table()
    form, arch = word_in(words, "format") or "ascii", word_in(words, "arch")
    if form not in ("ascii", "binary"):
        raise FileError(f"{name}: unknown format {form!r}, expected ascii or binary")
    order = ">" if "MSB" in arch else "<"
    label = f"{order}i{8 if 'label=64' in arch else 4}"
    scalar = f"{order}f{4 if 'scalar=32' in arch else 8}"
    return FoamFile(name, content, header.place, word_in(words, "class"), form == "binary", label, scalar)


def parser_of(file: FoamFile, most: int) -> FoamParser:
    """Return a parser placed after the file header.

    ``most`` bounds lists of equal labels.
    """
    return FoamParser(file.name, file.content, file.start, file.label if file.binary else "", most)


def points_of(file: FoamFile) -> Float:
    """Read the coordinates ``(n, 3)`` in a point file.

    Raises FileError if damaged.
    """
    n, start, _ = _read_list_head(file, file.start)
    if file.binary:
        values, _ = _raw(file, start, 3 * n, file.scalar)
        return frozen_float(values.reshape(-1, 3))
    values = reals(*_text(file, start))
    if len(values) != 3 * n:
        raise FileError(f"{file.name}: {n} points are declared, but {len(values)} coordinates follow")
    return frozen_float(values.reshape(-1, 3))


def labels_of(file: FoamFile, most: int) -> Int:
    """Read the integers (OpenFOAM's labels) in a list file.

    Raises FileError if damaged.

    ``most`` bounds the label count, because a list of equal labels stores only its length and one label.
    """
    n, start, bracket = _read_list_head(file, file.start, most)
    if not bracket:
        return frozen_int([])
    if bracket == b"{":
        stop = file.content.find(b"}", start)
        value = integers(file.content, start, stop if stop >= 0 else start)
        if len(value) != 1:
            raise FileError(f"{file.name}: a list of {n} equal labels must give one label")
        return frozen_int(np.full(n, value[0]))
    if file.binary:
        return frozen_int(_raw(file, start, n, file.label)[0])
    values = integers(*_text(file, start, file.content.find(b")", start)))
    if len(values) != n:
        raise FileError(f"{file.name}: {n} labels are declared, but {len(values)} follow")
    return values


def faces_of(file: FoamFile) -> tuple[Int, Int]:
    """Read the vertices of all faces as CSR: offsets and point numbers.

    Raises FileError if damaged.
    """
    n, start, _ = _read_list_head(file, file.start)
    if not file.binary:
        content, first, last = _text(file, start)
        stream = integers(content, first, last)
        offsets, places, length = locate_lists(stream, n)
        if length != len(stream):
            raise FileError(f"{file.name}: {n} faces take {length} numbers, but {len(stream)} follow")
        return offsets, frozen_int(stream[places])
    if "Compact" not in file.kind:
        raise FileError(
            f"{file.name}: binary faces of class {file.kind} are not supported; run foamFormatConvert first"
        )
    starts, stop = _raw(file, start, n, file.label)
    if not n or starts[0] != 0 or (np.diff(starts) < 0).any():
        raise FileError(f"{file.name}: the face offsets must increase from 0")
    count, start, _ = _read_list_head(file, stop)
    if count != starts[-1]:
        raise FileError(f"{file.name}: the last face offset is {starts[-1]}, but {count} points are listed")
    return frozen_int(starts), frozen_int(_raw(file, start, count, file.label)[0])


def _read_list_head(file: FoamFile, place: int, most: int | None = None) -> tuple[int, int, bytes]:
    """Return a list's length, the offset of its first byte, and its opening bracket.

    An empty list may lack the bracket.
    """
    match = _LIST.match(file.content, place)
    n = int(match[1]) if match is not None else 0
    if match is None or (n and not match[2]):
        raise FileError(f"{file.name}: expected a number and a list in brackets")
    if match[2] == b"{" and (most is None or n > most):
        raise FileError(f"{file.name}: a list of {n} equal values is too long or not allowed here")
    return n, match.end(), match[2]


def _raw(file: FoamFile, start: int, n: int, kind: str) -> tuple[Float | Int, int]:
    """Read n binary numbers and the closing bracket.

    Return them and the position after the closing bracket.
    """
    dtype = np.dtype(kind)
    stop = start + n * dtype.itemsize
    if file.content[stop : stop + 1] != b")":
        wide = 8 * dtype.itemsize
        raise FileError(
            f"{file.name}: the list of {n} {wide}-bit values is not closed: truncated, or the header is wrong"
        )
    return np.frombuffer(file.content, dtype, n, start), stop + 1


def _text(file: FoamFile, start: int, stop: int | None = None) -> tuple[bytes, int, int]:
    """Blank out brackets and comments of a text list, and return it with start and end of its numbers."""
    text = file.content[start : stop if stop is not None and stop >= 0 else None]
    slash = text.find(b"/")
    if slash >= 0:
        text = text[:slash] + _COMMENT.sub(b" ", text[slash:])
    last = text.rfind(b")") if stop is None else stop
    if last < 0:
        raise FileError(f"{file.name}: truncated: the list is not closed by a bracket")
    text = text.translate(_BRACKETS)
    return text, 0, last if stop is None else len(text)


def _inflate_file(data: bytes, name: str) -> bytes:
    """Decompress a gzipped file, up to a multiple of its compressed size."""
    free_bytes, parts = _ROOM + _EXPANSION * len(data), []
    try:
        while data:
            codec = zlib.decompressobj(31)
            parts.append(codec.decompress(data, free_bytes + 1))
            free_bytes -= len(parts[-1])
            if free_bytes < 0:
                raise FileError(f"{name}: it inflates to more than {_EXPANSION} times its size")
            if not codec.eof:
                raise FileError(f"{name}: truncated")
            data = codec.unused_data
    except zlib.error as error:
        raise FileError(f"{name}: {error}") from None
    return b"".join(parts)
