"""Decode the arrays in VTK XML files, stored as text, base64 or raw bytes.

Compression is zlib, lzma or none; the byte order is arbitrary.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from agglo_core.errors import FileError

DERIVED = 'agglo="derived"'
"""Attribute of DataArrays that agglo derives from the mesh or its hierarchy; VTK ignores it."""

TYPES = {f"{kind}{8 * size}": f"{kind[0].lower()}{size}" for kind in ("Int", "UInt") for size in (1, 2, 4, 8)}
TYPES |= {"Float32": "f4", "Float64": "f8"}
_COMPRESSORS = {"": "", "vtkZLibDataCompressor": "zlib", "vtkLZMADataCompressor": "lzma"}
_EXPANSION = 10_000  # above lzma's best ratio on real data; bounds the claims of forged headers
_SPARE = 1 << 20  # values decoded beyond the declared number, so that the caller can report the error
_LZMA_MEMORY = 1 << 27  # bytes, twice the need of the largest preset
_DOCTYPES = tuple("<!DOCTYPE".encode(code) for code in ("ascii", "utf-16-le", "utf-16-be"))
_WORDS = 1 << 16  # text numbers per conversion


def is_derived(element: ElementTree.Element) -> bool:
    """Return True for an array that agglo has computed from the mesh, so that it is not a tag."""
    return element.get("agglo") == "derived"


@dataclass(frozen=True)
class Document:
    """A parsed VTK XML file: its XML tree and the encoding of its binary arrays."""

    root: ElementTree.Element
    order: Literal["<", ">"]
    header: np.dtype[Any]
    compression: str  # "", "zlib" or "lzma"
    appended: bytes | memoryview
    raw: bool  # the appended bytes are not base64

    def array(self, element: ElementTree.Element, declared: int) -> NDArray[Any]:
        """Decode the values of an array ``(n,)`` in their own type and native byte order.

        Parameters
        ----------
        element : Element
        declared : int
            Value count expected from other parts of the file. Arrays with many more values are
            rejected before decoding; the caller checks the exact number.

        Raises
        ------
        FileError
            With the array name, for an unknown type or format, a broken encoding, or a wrong length.
        """
        name = element.get("Name", "Points")
        try:
            return self._array(element, declared)
        except (ValueError, OverflowError, zlib.error, lzma.LZMAError, binascii.Error) as error:
            raise FileError(f"array {name!r}: {error}") from None

    def _array(self, element: ElementTree.Element, declared: int) -> NDArray[Any]:
        """Decode an array from its text, from base64, or from the appended binary data.

        Raises ValueError if damaged.
        """
        kind, form = element.get("type", ""), element.get("format", "ascii")
        if kind not in TYPES:
            raise ValueError(f"unknown type {kind!r}")
        native = np.dtype(TYPES[kind])
        if form == "ascii":
            return _numbers(element.text or "", native, declared)
        limit = _Room(declared, native.itemsize)
        if form == "binary":
            content = self._binary((element.text or "").strip().encode(), 0, limit, raw=False)
        elif form == "appended":
            start = int(element.get("offset", "-1"))
            if not 0 <= start <= len(self.appended):
                raise ValueError(f"offset {start} lies outside the {len(self.appended)} appended bytes")
            content = self._binary(self.appended, start, limit, raw=self.raw)
        else:
            raise ValueError(f"unknown format {form!r}")
        if len(content) % native.itemsize:
            raise ValueError(f"{len(content)} bytes are not a whole number of {kind} values")
        return np.frombuffer(content, native.newbyteorder(self.order)).astype(native)

    def _binary(self, data: bytes | memoryview, start: int, limit: _Room, *, raw: bool) -> bytes | memoryview:
        """Decode the bytes of an array, which follow their number, raw or in base64."""
        if len(data) <= start:
            return b""
        if self.compression:
            return self._compressed(data, start, limit, raw)
        width = self.header.itemsize
        prefix, after = _take(data, start, width, raw)
        size = int(np.frombuffer(prefix, self.header)[0])
        limit.check(size)
        if raw or len(base64.b64decode(data[start:after])) == width:  # separate encodings
            return _take(data, after, size, raw)[0]
        return _take(data, start, width + size, raw)[0][width:]

    def _compressed(self, data: bytes | memoryview, start: int, limit: _Room, raw: bool) -> bytes:
        """Decompress an array: a header with all block sizes, then the blocks."""
        width = self.header.itemsize
        prefix, _ = _take(data, start, 3 * width, raw)
        n, size, last = (int(value) for value in np.frombuffer(prefix, self.header))
        limit.check(n * size - (size - last if n and last else 0))
        prefix, place = _take(data, start, (3 + n) * width, raw)
        lengths = np.frombuffer(prefix, self.header)[3:].tolist()
        blocks, _ = _take(data, place, sum(lengths), raw)
        pieces, position = [], 0
        for i, length in enumerate(lengths):
            expected = last if i == n - 1 and last else size
            pieces.append(self._inflate(blocks[position : position + length], expected))
            position += length
        return b"".join(pieces)

    def _inflate(self, block: bytes | memoryview, size: int) -> bytes:
        """Decompress a block, which must have exactly ``size`` bytes."""
        if size > _EXPANSION * (len(block) + 64):
            raise ValueError(f"a block of {len(block)} bytes declares a size of {size}")
        zipped = self.compression == "zlib"
        codec = zlib.decompressobj() if zipped else lzma.LZMADecompressor(memlimit=_LZMA_MEMORY)
        content = codec.decompress(block, size + 1)
        if len(content) != size:
            actual_size = len(content) if len(content) < size else f"more than {size}"
            raise ValueError(f"a block holds {actual_size} bytes, but its header declares {size}")
        return content


class _Room(NamedTuple):
    """Upper limit for the size of an array in bytes, from the declared value count."""

    declared: int
    width: int

    def check(self, size: int) -> None:
        """Raise ValueError if ``size`` bytes are far more than the declared values need."""
        if size > self.width * (max(self.declared, 0) + _SPARE):
            raise ValueError(
                f"it holds {size // self.width} values ({size} bytes), but the file declares {self.declared} "
                f"({self.width * self.declared} bytes)"
            )


def _numbers(text: str, dtype: np.dtype[Any], declared: int) -> NDArray[Any]:
    """Parse the numbers of an array stored as text.

    Raises ValueError for far too many numbers or invalid words.
    """
    most = max(declared, 0) + _SPARE
    words = text.split(maxsplit=most)
    if not words:
        return np.empty(0, dtype)
    if len(words) > most:
        raise ValueError(f"it holds more than {most} values, but the file declares {declared}")
    longest = max(words, key=len)
    if len(longest) > 64:  # a numpy string array allocates the longest word's length for every word
        raise ValueError(f"{longest[:20]}… is not a number")
    values = np.empty(len(words), dtype)
    for i in range(0, len(words), _WORDS):
        values[i : i + _WORDS] = np.array(words[i : i + _WORDS]).astype(dtype)
    return values


def _take(data: bytes | memoryview, start: int, size: int, raw: bool) -> tuple[bytes | memoryview, int]:
    """Return ``size`` bytes, decoded from ``start`` on, and the offset of the next."""
    stop = start + (size if raw else (size + 2) // 3 * 4)
    if stop > len(data):
        raise ValueError(f"truncated: {stop - start} bytes expected at {start}, {len(data) - start} found")
    if raw:
        return data[start:stop], stop
    content = base64.b64decode(data[start:stop], validate=True)
    if len(content) < size:
        raise ValueError(f"truncated: {size} bytes expected, {len(content)} decoded")
    return content[:size], stop


def parse(content: bytes, kind: str = "UnstructuredGrid") -> Document:
    """Parse a VTK XML file, whose binary data may follow the XML.

    Raises
    ------
    FileError
        For anything except a complete VTKFile of this type.
    """
    text, appended, raw = _split_appended(content)
    root = vtk_root(text, kind)
    orders: dict[str, Literal["<", ">"]] = {"LittleEndian": "<", "BigEndian": ">"}
    order = orders.get(root.get("byte_order", "LittleEndian"))
    header = {"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"))
    compressor = root.get("compressor", "")
    if order is None or header is None:
        raise FileError(f"unknown byte order or header type: {root.attrib}")
    if compressor not in _COMPRESSORS:
        raise FileError(f"compressor {compressor} is not supported; write the file with zlib, lzma or none")
    return Document(
        root, order, np.dtype(header).newbyteorder(order), _COMPRESSORS[compressor], appended, raw
    )


def vtk_root(text: bytes, kind: str) -> ElementTree.Element:
    """Parse XML and return its root element, which must be a VTKFile of type ``kind``.

    Raises FileError for other content.
    """
    if any(mark in text for mark in _DOCTYPES):  # a declaration may define entities that expand without bound
        raise FileError("it has a document type declaration, which VTK files do not use; remove it")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FileError(f"not well-formed XML: {error}") from None
    if root.tag != "VTKFile" or root.get("type") != kind:
        raise FileError(f"expected a VTKFile of type {kind}, found {root.tag} of type {root.get('type')}")
    return root


def _split_appended(content: bytes) -> tuple[bytes, bytes | memoryview, bool]:
    """Separate the binary data in the section AppendedData from the XML.

    Return both, and True if the data are raw (invalid in XML).
    """
    tag = re.search(rb"<AppendedData([^>]*)>\s*_", content)
    if tag is None:
        return content, b"", False
    stop = content.rfind(b"</AppendedData>")
    if stop < tag.end():
        raise FileError("truncated: AppendedData is not closed")
    raw = b"raw" in tag.group(1)
    data = memoryview(content)[tag.end() : stop]
    return content[: tag.start()] + b"</VTKFile>", data if raw else bytes(data).rstrip(), raw
