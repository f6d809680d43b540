"""A VTU file of ours taken apart without our reader."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

__all__ = ["arrays_of", "cell_data_of"]

_TYPES = {"Float64": "<f8", "Int64": "<i8", "UInt8": "<u1"}


def arrays_of(file: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a file by name, as VTK would find them; no two may have the same name."""
    arrays: dict[str, NDArray[Any]] = {}
    for element in ElementTree.parse(file).iter("DataArray"):
        name = element.attrib["Name"]
        assert name not in arrays
        arrays[name] = _decoded(element)
    return arrays


def cell_data_of(file: Path) -> dict[str, NDArray[Any]]:
    """The cell data of a file by name."""
    found = ElementTree.parse(file).iterfind("UnstructuredGrid/Piece/CellData/DataArray")
    return {element.attrib["Name"]: _decoded(element) for element in found}


def _decoded(element: ElementTree.Element) -> NDArray[Any]:
    assert element.attrib["format"] == "binary"
    text = element.text or ""
    count = int(np.frombuffer(base64.b64decode(text[:12])[:8], "<u8")[0])
    head = 4 * -(-8 * (3 + count) // 3)
    sizes = np.frombuffer(base64.b64decode(text[:head])[: 8 * (3 + count)], "<u8")[3:].tolist()
    content, blocks, start = base64.b64decode(text[head:]), [], 0
    for size in sizes:
        blocks.append(zlib.decompress(content[start : start + size]))
        start += size
    return np.frombuffer(b"".join(blocks), _TYPES[element.attrib["type"]])
