"""Read and write VTU files independently of the package."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

__all__ = ["arrays_of", "cell_data_of", "replace_bytes", "write_ascii"]

_TRIPLES = ' NumberOfComponents="3"'
_TYPES = {"Float64": "<f8", "Int64": "<i8", "Int32": "<i4", "UInt8": "<u1"}


def arrays_of(file: Path) -> dict[str, NDArray[Any]]:
    """Return all arrays of a file by name.

    Names must be unique.
    """
    root, appended = _parts(file)
    arrays: dict[str, NDArray[Any]] = {}
    for element in root.iter("DataArray"):
        name = element.attrib["Name"]
        assert name not in arrays
        arrays[name] = _decoded(root, element, appended)
    return arrays


def cell_data_of(file: Path) -> dict[str, NDArray[Any]]:
    """Return the cell data of a file by name."""
    root, appended = _parts(file)
    found = root.iterfind("UnstructuredGrid/Piece/CellData/DataArray")
    return {element.attrib["Name"]: _decoded(root, element, appended) for element in found}


def replace_bytes(file: Path, old: bytes, new: bytes) -> None:
    """Replace ``old``, which must occur once in the file, by ``new``."""
    content = file.read_bytes()
    assert content.count(old) == 1
    file.write_bytes(content.replace(old, new))


def write_ascii(
    file: Path,
    points: Sequence[Sequence[float]],
    cells: Sequence[tuple[int, Sequence[int]]],
    data: Mapping[str, Sequence[int]] | None = None,
) -> Path:
    """Write cells by VTK type and nodes, and integer cell data, as text.

    Returns the file.
    """

    def array(kind: str, name: str, values: Any, more: str = "") -> str:
        text = " ".join(map(str, np.ravel(values).tolist()))
        return f'<DataArray type="{kind}" Name="{name}" format="ascii"{more}>{text}</DataArray>'

    nodes = np.concatenate([np.asarray(each, np.int64) for _, each in cells])
    ends = np.cumsum([len(each) for _, each in cells])
    file.write_text(
        '<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'
        f"<Points>{array('Float64', 'p', points, _TRIPLES)}</Points>"
        f"<Cells>{array('Int64', 'connectivity', nodes)}{array('Int64', 'offsets', ends)}"
        f"{array('UInt8', 'types', [kind for kind, _ in cells])}</Cells>"
        f"<CellData>{''.join(array('Int64', *each) for each in (data or {}).items())}</CellData>"
        "</Piece></UnstructuredGrid></VTKFile>"
    )
    return file


def _parts(file: Path) -> tuple[ElementTree.Element, bytes]:
    """Return the XML of a file and its raw appended bytes (empty in version 0.1)."""
    content = file.read_bytes()
    before, mark, after = content.partition(b'<AppendedData encoding="raw">\n_')
    if not mark:
        return ElementTree.fromstring(content), b""
    end = b"\n</AppendedData>\n</VTKFile>\n"
    assert after.endswith(end)
    return ElementTree.fromstring(before + b"</VTKFile>"), after.removesuffix(end)


def _decoded(root: ElementTree.Element, element: ElementTree.Element, appended: bytes) -> NDArray[Any]:
    kind = _TYPES[element.attrib["type"]]
    if element.attrib["format"] == "binary":
        return np.frombuffer(_inflated_text(element.text or ""), kind)
    assert element.attrib["format"] == "appended"
    data = appended[int(element.attrib["offset"]) :]
    size = int.from_bytes(data[:8], "little")
    if "compressor" not in root.attrib:
        assert len(data) >= 8 + size
        return np.frombuffer(data[8 : 8 + size], kind)
    head = 8 * (3 + size)
    return np.frombuffer(_inflated(data[:head], data[head:]), kind)


def _inflated_text(text: str) -> bytes:
    count = int(np.frombuffer(base64.b64decode(text[:12])[:8], "<u8")[0])
    head = 4 * -(-8 * (3 + count) // 3)
    return _inflated(base64.b64decode(text[:head])[: 8 * (3 + count)], base64.b64decode(text[head:]))


def _inflated(head: bytes, content: bytes) -> bytes:
    blocks, start = [], 0
    for size in np.frombuffer(head, "<u8")[3:].tolist():
        blocks.append(zlib.decompress(content[start : start + size]))
        start += size
    return b"".join(blocks)
