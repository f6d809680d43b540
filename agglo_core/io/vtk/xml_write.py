"""Write VTU files: XML, then the raw or zlib-compressed array bytes.

Raw appended data need no encoding, and integers take 32 bits if they fit. VTK supports such files since
version 6.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import fits_in_index
from agglo_core.io.vtk.xml_read import DERIVED
from agglo_core.progress import Notify, ignore_progress, part

_NAMES = {"i4": "Int32", "i8": "Int64", "u1": "UInt8", "f8": "Float64"}
_BLOCK = 1 << 20  # bytes per write or compression
_LEVEL = 1  # zlib level: higher levels take twice the time and save a few per cent
_ZLIB = 'compressor="vtkZLibDataCompressor"'
_FILE = '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
_START = f'<?xml version="1.0"?>\n{_FILE} '
MESH = f'{_START}agglo="mesh"'.encode()
"""First bytes of a mesh written by agglo."""
SOLUTION = f'{_START}agglo="solution"'.encode()
"""First bytes of a solution written by agglo."""
_END = b"\n</AppendedData>\n</VTKFile>\n"
_FAR = 10**19  # larger than any file offset
IDS = {"PointData": "GlobalPointIds", "CellData": "GlobalCellIds"}
"""VTK's names of global point and cell numbers, valid across files."""


class Piece(NamedTuple):
    """Contents of a VTU file: points, cells and data arrays by name.

    Attributes
    ----------
    points : (n_points, d) float
        For 2-D meshes, 0 is added as the third coordinate.
    cells : mapping
        ``connectivity``, ``offsets``, ``types``; with polyhedra also ``faces`` and ``faceoffsets``.
    point_data, cell_data : mapping
        Numbers ``(n,)``, vectors ``(n, d)`` or tensors ``(n, d, d)``; in 2-D they are padded with 0.
    derived : mapping
        More cell data, with the attribute ``mark``.
    mark : str
    field_data : mapping
        Arrays that belong to no point or cell.
    kind : str
        Written to the first line to identify the contents.
    point_ids, cell_ids : (n,) int or None
        Numbers of points and cells in the whole mesh if this is a piece (VTK's global ids).
    wide : collection of str
        Cell data always stored in 64 bits, to match other pieces.
    """

    points: NDArray[Any]
    cells: Mapping[str, NDArray[Any]]
    point_data: Mapping[str, NDArray[Any]] = {}
    cell_data: Mapping[str, NDArray[Any]] = {}
    derived: Mapping[str, NDArray[Any]] = {}
    mark: str = ""
    field_data: Mapping[str, NDArray[Any]] = {}
    kind: str = "mesh"
    point_ids: NDArray[Any] | None = None
    cell_ids: NDArray[Any] | None = None
    wide: Collection[str] = ()


class StoredArray(NamedTuple):
    """An array of a VTU file with its name, section and stored data type."""

    section: str
    name: str
    values: NDArray[Any]
    dtype: np.dtype[Any]
    components: int = 1
    mark: str = ""

    @property
    def attributes(self) -> str:
        """XML attributes of the array except its offset: type, name, components, mark."""
        kind = f'type="{_NAMES[self.dtype.str[1:]]}" Name={quoteattr(self.name)}'
        width = f' NumberOfComponents="{self.components}"' if self.components > 1 else ""
        return f"{kind}{width}{self.mark}"

    def element(self, offset: int) -> str:
        """Return the XML element of the array, whose bytes begin at ``offset``."""
        return f'<DataArray {self.attributes} format="appended" offset="{offset}"/>'

    def blocks(self) -> Iterator[memoryview]:
        """Yield the bytes of the array in blocks."""
        rows = self.values if self.values.ndim > 1 else self.values[:, None]
        missing = np.zeros((_BLOCK // self.row, self.components - rows.shape[1]))
        for start in range(0, len(rows), len(missing)):
            some = rows[start : start + len(missing)]
            if missing.shape[1]:
                some = np.concatenate((some, missing[: len(some)]), axis=1)
            yield np.ascontiguousarray(some, self.dtype).data.cast("B")

    @property
    def row(self) -> int:
        """Bytes per point or cell."""
        return self.components * self.dtype.itemsize


def write_document(
    path: Path, piece: Piece, *, compress: bool = False, notify: Notify = ignore_progress
) -> None:
    """Write a VTU file array by array.

    Parameters
    ----------
    path : Path
    piece : Piece
    compress : bool
        Compress with zlib: smaller, but slower to write and to read.
    notify : callable
        Called before each array.
    """
    arrays = list(stored_arrays(piece))
    # Reserve space for the XML, whose offsets are known only after the arrays.
    xml_size = len(_xml(piece, arrays, [_FAR] * len(arrays), compress))
    with open(path, "wb") as stream:
        stream.write(bytes(xml_size))
        offsets = []
        for place, array in enumerate(arrays):
            part(notify, place, len(arrays), array.name)
            offsets.append(stream.tell() - xml_size)
            (_deflate if compress else _store)(stream, array)
        stream.write(_END)
        stream.seek(0)
        stream.write(_xml(piece, arrays, offsets, compress, xml_size))


def stored_arrays(piece: Piece) -> Iterator[StoredArray]:
    """Yield the arrays of a VTU file in the order in which they are written."""
    yield StoredArray("Points", "Points", piece.points, np.dtype("<f8"), 3)
    for section, data, mark in (
        ("Cells", piece.cells, ""),
        ("PointData", piece.point_data, ""),
        ("CellData", piece.cell_data, ""),
        ("CellData", piece.derived, f" {piece.mark}"),
        ("FieldData", piece.field_data, ""),
    ):
        for name, values in data.items():
            tuples = f' NumberOfTuples="{len(values)}"' if section == "FieldData" else ""
            wide = section == "CellData" and name in piece.wide
            dtype = values.dtype.newbyteorder("<") if wide else _stored_type(values)
            if values.ndim == 3:
                more = 3 - values.shape[2]
                values = np.pad(values, ((0, 0), (0, more), (0, more))).reshape(-1, 9)
            components = 1 if values.ndim == 1 else 3 if values.shape[1] <= 3 else 9
            yield StoredArray(section, name, values, dtype, components, f"{tuples}{mark}")
    for (section, name), ids in zip(IDS.items(), (piece.point_ids, piece.cell_ids), strict=True):
        if ids is not None:
            yield StoredArray(section, name, ids, np.dtype("<i8"), mark=f' IdType="1" {DERIVED}')


def _stored_type(values: NDArray[Any]) -> np.dtype[Any]:
    dtype = np.dtype(np.int32) if fits_in_index(values) else values.dtype
    return dtype.newbyteorder("<")


def _xml(
    piece: Piece, arrays: Sequence[StoredArray], offsets: Sequence[int], compress: bool, xml_size: int = 0
) -> bytes:
    """Return the XML before the binary data, padded with spaces to ``xml_size`` bytes."""

    def section(name: str) -> list[str]:
        elements = [a.element(offset) for a, offset in zip(arrays, offsets, strict=True) if a.section == name]
        return [f"<{name}{global_ids(piece, name)}>", *elements, f"</{name}>"]

    lines = [
        f'{_START}agglo="{piece.kind}"{f" {_ZLIB}" if compress else ""}>',
        "<UnstructuredGrid>",
        *(section("FieldData") if piece.field_data else ()),
        f'<Piece NumberOfPoints="{len(piece.points)}" NumberOfCells="{len(piece.cells["types"])}">',
    ]
    for name in ("Points", "Cells", "PointData", "CellData"):
        lines += section(name)
    lines += ["</Piece>", "</UnstructuredGrid>"]
    before, after = "\n".join(lines).encode(), b'\n<AppendedData encoding="raw">\n_'
    return before.ljust(xml_size - len(after)) + after


def global_ids(piece: Piece, section: str) -> str:
    """Return the XML attribute that names the global number array, or an empty string without one."""
    has_ids = {"PointData": piece.point_ids, "CellData": piece.cell_ids}.get(section) is not None
    return f' GlobalIds="{IDS[section]}"' if has_ids else ""


def _store(stream: IO[bytes], array: StoredArray) -> None:
    """Write the bytes of an array uncompressed, after their number."""
    stream.write((len(array.values) * array.row).to_bytes(8, "little"))
    for block in array.blocks():
        stream.write(block)


def _deflate(stream: IO[bytes], array: StoredArray) -> None:
    """Write the bytes of an array as compressed blocks, after the block count and sizes."""
    blocks = [zlib.compress(block, _LEVEL) for block in array.blocks()]
    whole = _BLOCK // array.row * array.row
    sizes = (len(blocks), whole, len(array.values) * array.row % whole, *map(len, blocks))
    stream.write(np.array(sizes, "<u8").tobytes())
    for packed in blocks:
        stream.write(packed)
