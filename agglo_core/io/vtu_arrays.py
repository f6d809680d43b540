"""DataArrays of VTK XML files: ascii, base64 and raw; plain, zlib and lzma; either byte order."""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from dataclasses import dataclass
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from agglo_core.errors import FileError

__all__ = ["DERIVED", "TYPES", "Document", "is_derived", "parse"]

DERIVED = 'agglo="derived"'
"""Attribute of our own DataArrays that follow from the mesh or its hierarchy; VTK passes over it."""

TYPES = {f"{kind}{8 * size}": f"{kind[0].lower()}{size}" for kind in ("Int", "UInt") for size in (1, 2, 4, 8)}
TYPES |= {"Float32": "f4", "Float64": "f8"}
_COMPRESSORS = {"": "", "vtkZLibDataCompressor": "zlib", "vtkLZMADataCompressor": "lzma"}
_EXPANSION = 10_000  # more than lzma's largest ratio on real data: bounds what a forged header can claim


def is_derived(element: ElementTree.Element) -> bool:
    """Whether a DataArray holds what agglo derived when it wrote the file: it is no tag of the mesh."""
    return element.get("agglo") == "derived"


@dataclass(frozen=True)
class Document:
    """A parsed file: its XML tree, and how its binary arrays are encoded."""

    root: ElementTree.Element
    order: Literal["<", ">"]
    header: np.dtype[Any]
    compression: str  # "", "zlib" or "lzma"
    appended: bytes
    raw: bool  # the appended bytes are not base64

    def array(self, element: ElementTree.Element) -> NDArray[Any]:
        """Values of a DataArray ``(n,)`` in its own type, native byte order.

        Raises
        ------
        FileError
            Naming the array: unknown type or format, broken encoding, too short.
        """
        name = element.get("Name", "Points")
        try:
            return self._array(element)
        except (ValueError, OverflowError, zlib.error, lzma.LZMAError, binascii.Error) as error:
            raise FileError(f"array {name!r}: {error}") from None

    def _array(self, element: ElementTree.Element) -> NDArray[Any]:
        kind, form = element.get("type", ""), element.get("format", "ascii")
        if kind not in TYPES:
            raise ValueError(f"unknown type {kind!r}")
        native = np.dtype(TYPES[kind])
        if form == "ascii":
            return _numbers((element.text or "").split(), native)
        if form == "binary":
            content = self._binary((element.text or "").strip().encode(), 0, raw=False)
        elif form == "appended":
            start = int(element.get("offset", "-1"))
            if not 0 <= start <= len(self.appended):
                raise ValueError(f"offset {start} lies outside the {len(self.appended)} appended bytes")
            content = self._binary(self.appended, start, raw=self.raw)
        else:
            raise ValueError(f"unknown format {form!r}")
        if len(content) % native.itemsize:
            raise ValueError(f"{len(content)} bytes are not a whole number of {kind}")
        return np.frombuffer(content, native.newbyteorder(self.order)).astype(native)

    def _binary(self, data: bytes, start: int, *, raw: bool) -> bytes:
        if len(data) <= start:
            return b""
        if self.compression:
            return self._compressed(data, start, raw)
        width = self.header.itemsize
        prefix, after = _take(data, start, width, raw)
        size = int(np.frombuffer(prefix, self.header)[0])
        if (
            raw or len(base64.b64decode(data[start:after])) == width
        ):  # the length is encoded apart from the data
            return _take(data, after, size, raw)[0]
        return _take(data, start, width + size, raw)[0][width:]

    def _compressed(self, data: bytes, start: int, raw: bool) -> bytes:
        width = self.header.itemsize
        prefix, _ = _take(data, start, 3 * width, raw)
        n, size, last = (int(value) for value in np.frombuffer(prefix, self.header))
        prefix, place = _take(data, start, (3 + n) * width, raw)
        lengths = np.frombuffer(prefix, self.header)[3:].tolist()
        blocks, _ = _take(data, place, sum(lengths), raw)
        pieces, position = [], 0
        for i, length in enumerate(lengths):
            expected = last if i == n - 1 and last else size
            pieces.append(self._inflate(blocks[position : position + length], expected))
            position += length
        return b"".join(pieces)

    def _inflate(self, block: bytes, size: int) -> bytes:
        if size > _EXPANSION * (len(block) + 64):
            raise ValueError(f"a block of {len(block)} bytes claims to hold {size}")
        codec = zlib.decompressobj() if self.compression == "zlib" else lzma.LZMADecompressor()
        content = codec.decompress(block, max(size, 1))
        if len(content) != size:
            raise ValueError(f"a block holds {len(content)} bytes, expected {size}")
        return content


def _numbers(words: list[str], dtype: np.dtype[Any]) -> NDArray[Any]:
    if not words:
        return np.empty(0, dtype)
    longest = max(words, key=len)
    if len(longest) > 64:  # a numpy string array gives every word the room of the longest
        raise ValueError(f"{longest[:20]}… is not a number")
    return np.array(words).astype(dtype)


def _take(data: bytes, start: int, size: int, raw: bool) -> tuple[bytes, int]:
    """``size`` bytes encoded from ``start`` on, and the place after them."""
    stop = start + (size if raw else (size + 2) // 3 * 4)
    if stop > len(data):
        raise ValueError(f"truncated: {stop - start} bytes expected at {start}, {len(data) - start} found")
    if raw:
        return data[start:stop], stop
    content = base64.b64decode(data[start:stop], validate=True)
    if len(content) < size:
        raise ValueError(f"truncated: {size} bytes expected, {len(content)} decoded")
    return content[:size], stop


def parse(content: bytes) -> Document:
    """Read the XML of a VTK file, its appended data apart.

    Raises
    ------
    FileError
        For anything but a whole VTKFile of type UnstructuredGrid.
    """
    text, appended, raw = _split_appended(content)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FileError(f"not well-formed XML: {error}") from None
    if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid":
        raise FileError(
            f"expected a VTKFile of type UnstructuredGrid, found {root.tag} of type {root.get('type')}"
        )
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


def _split_appended(content: bytes) -> tuple[bytes, bytes, bool]:
    """XML without its AppendedData, that data, and whether it is raw (then it breaks XML's rules)."""
    tag = re.search(rb"<AppendedData([^>]*)>\s*_", content)
    if tag is None:
        return content, b"", False
    stop = content.rfind(b"</AppendedData>")
    if stop < tag.end():
        raise FileError("truncated: AppendedData does not end")
    raw = b"raw" in tag.group(1)
    data = content[tag.end() : stop]
    return content[: tag.start()] + b"</VTKFile>", data if raw else data.rstrip(), raw
