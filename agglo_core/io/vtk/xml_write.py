"""A VTU file as it is written: the XML, then the bytes of all arrays as they are, or zlib of them.

Raw appended data cost nothing to encode, and integers take 32 bits where they fit. VTK opens such files
since version 6.
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
from agglo_core.progress import Tell, part, to_nobody

_NAMES = {"i4": "Int32", "i8": "Int64", "u1": "UInt8", "f8": "Float64"}
_BLOCK = 1 << 20  # bytes written or compressed at once
_LEVEL = 1  # of zlib: higher ones take twice as long for a few per cent
_ZLIB = 'compressor="vtkZLibDataCompressor"'
_FILE = '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
_START = f'<?xml version="1.0"?>\n{_FILE} '
MESH = f'{_START}agglo="mesh"'.encode()
"""First bytes of a mesh written by agglo."""
SOLUTION = f'{_START}agglo="solution"'.encode()
"""First bytes of a solution written by agglo."""
_END = b"\n</AppendedData>\n</VTKFile>\n"
_FAR = 10**19  # no file is longer
IDS = {"PointData": "GlobalPointIds", "CellData": "GlobalCellIds"}
"""The names that VTK gives to numbers of points and cells that hold across files."""


class Piece(NamedTuple):
    """Contents of a file: arrays by name, reals or integers.

    Attributes
    ----------
    points : (n_points, d) float
        In a plane mesh, 0 is added as the third coordinate.
    cells : mapping
        ``connectivity``, ``offsets``, ``types``; of polyhedra ``faces`` and ``faceoffsets``, too.
    point_data, cell_data : mapping
    derived : mapping
        More cell data, which get the attribute ``mark``.
    mark : str
    field_data : mapping
        Arrays that belong to no point or cell.
    kind : str
        Stands in the first line, so that a program knows what it has before it.
    point_ids, cell_ids : (n,) int or None
        Numbers of points and cells in the mesh of which this is a piece, as VTK's global ids.
    wide : collection of str
        Cell data stored in 64 bits also if they fit in 32, as other pieces store theirs.
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
    """One array and how it is stored."""

    section: str
    name: str
    values: NDArray[Any]
    dtype: np.dtype[Any]
    components: int = 1
    mark: str = ""

    @property
    def attributes(self) -> str:
        """Type, name and all that is to be known of it, but not where it is."""
        kind = f'type="{_NAMES[self.dtype.str[1:]]}" Name={quoteattr(self.name)}'
        width = f' NumberOfComponents="{self.components}"' if self.components > 1 else ""
        return f"{kind}{width}{self.mark}"

    def element(self, offset: int) -> str:
        """The XML that says where its bytes are."""
        return f'<DataArray {self.attributes} format="appended" offset="{offset}"/>'

    def blocks(self) -> Iterator[memoryview]:
        """Its bytes, some at a time."""
        rows = self.values if self.values.ndim > 1 else self.values[:, None]
        missing = np.zeros((_BLOCK // self.row, self.components - rows.shape[1]))
        for start in range(0, len(rows), len(missing)):
            some = rows[start : start + len(missing)]
            if missing.shape[1]:
                some = np.concatenate((some, missing[: len(some)]), axis=1)
            yield np.ascontiguousarray(some, self.dtype).data.cast("B")

    @property
    def row(self) -> int:
        """Bytes for each point or cell."""
        return self.components * self.dtype.itemsize


def write_document(path: Path, piece: Piece, *, compress: bool = False, tell: Tell = to_nobody) -> None:
    """Write one piece as a VTU file, array by array.

    Parameters
    ----------
    path : Path
    piece : Piece
    compress : bool
        Store zlib of the bytes: smaller, but slower to write and to read.
    tell : callable
        Told before each array.
    """
    arrays = list(stored_arrays(piece))
    room = len(_xml(piece, arrays, [_FAR] * len(arrays), compress))
    with open(path, "wb") as stream:
        stream.write(bytes(room))
        offsets = []
        for place, array in enumerate(arrays):
            part(tell, place, len(arrays), array.name)
            offsets.append(stream.tell() - room)
            (_deflate if compress else _store)(stream, array)
        stream.write(_END)
        stream.seek(0)
        stream.write(_xml(piece, arrays, offsets, compress, room))


def stored_arrays(piece: Piece) -> Iterator[StoredArray]:
    """The arrays of a piece in the order in which they are stored."""
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
            yield StoredArray(section, name, values, dtype, mark=f"{tuples}{mark}")
    for (section, name), ids in zip(IDS.items(), (piece.point_ids, piece.cell_ids), strict=True):
        if ids is not None:
            yield StoredArray(section, name, ids, np.dtype("<i8"), mark=f' IdType="1" {DERIVED}')


def _stored_type(values: NDArray[Any]) -> np.dtype[Any]:
    dtype = np.dtype(np.int32) if fits_in_index(values) else values.dtype
    return dtype.newbyteorder("<")


def _xml(
    piece: Piece, arrays: Sequence[StoredArray], offsets: Sequence[int], compress: bool, room: int = 0
) -> bytes:
    """All before the bytes of the arrays, filled up with spaces to ``room`` bytes."""

    def section(name: str) -> list[str]:
        own = [a.element(offset) for a, offset in zip(arrays, offsets, strict=True) if a.section == name]
        return [f"<{name}{global_ids(piece, name)}>", *own, f"</{name}>"]

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
    return before.ljust(room - len(after)) + after


def global_ids(piece: Piece, section: str) -> str:
    """The attribute of a section that says which of its arrays are global ids, if any are."""
    there = {"PointData": piece.point_ids, "CellData": piece.cell_ids}.get(section) is not None
    return f' GlobalIds="{IDS[section]}"' if there else ""


def _store(stream: IO[bytes], array: StoredArray) -> None:
    """The number of bytes, and the bytes."""
    stream.write((len(array.values) * array.row).to_bytes(8, "little"))
    for block in array.blocks():
        stream.write(block)


def _deflate(stream: IO[bytes], array: StoredArray) -> None:
    """The number and sizes of blocks, and the blocks."""
    blocks = [zlib.compress(block, _LEVEL) for block in array.blocks()]
    whole = _BLOCK // array.row * array.row
    sizes = (len(blocks), whole, len(array.values) * array.row % whole, *map(len, blocks))
    stream.write(np.array(sizes, "<u8").tobytes())
    for packed in blocks:
        stream.write(packed)
