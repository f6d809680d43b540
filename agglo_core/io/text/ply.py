"""Read and write PLY files with 2-D meshes, as text or binary."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, fits_in_index, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import check_last_line, text_bytes
from agglo_core.files.text_numbers import integer_lines, real_lines, reals
from agglo_core.io.tags import note_left_out
from agglo_core.io.text.counted_lists import locate_lists, record_starts
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.to_mesh.plain_cells import loops_of, write_levels
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_NEEDED = ("vertex", "face")
_LONGEST = 1 << 30  # bytes, bound on the length of a valid record


class Property(NamedTuple):
    """Declared column of a PLY element: a number or a list of numbers in each row."""

    name: str
    type: str  # of numpy, without the byte order
    counted: str = ""  # type of the length of a list, empty for a number


class Element(NamedTuple):
    """Declared PLY element such as vertex or face: row count, and columns."""

    name: str
    n: int
    properties: list[Property]


class Rows(NamedTuple):
    """Values of all rows of a PLY element: columns of numbers by name, and the lists as CSR."""

    values: Mapping[str, NDArray[Any]]
    listed: str
    offsets: Int
    lists: Int


def read_elements(content: bytes, start: int, order: str, elements: list[Element]) -> dict[str, Rows]:
    """Read the rows of all PLY elements up to the points and faces.

    ``order`` is the byte order, empty for text.

    Raises
    ------
    FileError
        For truncated elements, or several lists per row.
    """
    last = max((i for i, element in enumerate(elements) if element.name in _NEEDED), default=-1)
    data = np.frombuffer(content, np.uint8, offset=start) if order else reals(content, start)
    rows: dict[str, Rows] = {}
    for element in elements[: last + 1]:
        if not element.properties or sum(bool(p.counted) for p in element.properties) > 1:
            raise FileError(f"element {element.name!r} has no properties, or several lists in each row")
        try:
            rows[element.name], length = (_binary if order else _text)(data, order, element)
        except FileError as error:
            raise FileError(f"element {element.name!r}: {error}") from None
        data = data[length:]
    if len(data) and last == len(elements) - 1:
        raise FileError(f"{len(data)} {'bytes' if order else 'numbers'} follow the last element")
    return rows


def _split(element: Element) -> tuple[list[Property], list[Property], list[Property]]:
    """Split an element's columns into those before the list, the list, and those after it."""
    kinds = [bool(p.counted) for p in element.properties]
    place = kinds.index(True) if True in kinds else len(kinds)
    return element.properties[:place], element.properties[place : place + 1], element.properties[place + 1 :]


def _short(element: Element) -> FileError:
    return FileError(f"{element.n} entries are declared, but the file ends before the last")


def _text(numbers: NDArray[Any], _: str, element: Element) -> tuple[Rows, int]:
    before, listed, after = _split(element)
    if not listed:
        length = element.n * len(before)
        if length > len(numbers):
            raise _short(element)
        table = numbers[:length].reshape(-1, len(before))
        return Rows(_convert_columns(before, table), "", frozen_int([0]), frozen_int([])), length
    stream = np.where(np.abs(numbers) < 2**53, numbers, -1).astype(np.int64)
    stream[stream != numbers] = -1
    # Locate the lists, then the fixed columns before and after each list.
    offsets, places, length = locate_lists(frozen_int(stream), element.n, len(before), len(after))
    width = len(before) + 1 + len(after)
    starts = offsets[:-1] + width * np.arange(element.n)
    values = _convert_columns(before, numbers[starts[:, None] + np.arange(len(before))])
    ends = starts + width + np.diff(offsets)
    values |= _convert_columns(after, numbers[ends[:, None] - np.arange(len(after), 0, -1)])
    return Rows(values, listed[0].name, offsets, frozen_int(stream[places])), length


def _convert_columns(properties: list[Property], table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    values: dict[str, NDArray[Any]] = {}
    for prop, column in zip(properties, table.T, strict=True):
        whole = prop.type[0] != "f"
        if whole and not ((np.abs(column) < 2**53) & (column == np.floor(column))).all():
            raise FileError(f"property {prop.name!r} must hold whole numbers")
        values[prop.name] = column.astype(np.int64) if whole else column
    return values


def _binary(data: NDArray[Any], order: str, element: Element) -> tuple[Rows, int]:
    before, listed, after = _split(element)
    head = np.dtype([(f"{i}", order + p.type) for i, p in enumerate(before)])
    tail = np.dtype([(f"{i}", order + p.type) for i, p in enumerate(after)])
    if not listed:
        n_bytes = element.n * head.itemsize
        if n_bytes > len(data):
            raise _short(element)
        table = data[:n_bytes].view(head)
        return Rows(_fields(before, table), "", frozen_int([0]), frozen_int([])), n_bytes
    # Find the record starts by the list lengths, then read all columns at once.
    length, item = (np.dtype(order + kind) for kind in (listed[0].counted, listed[0].type))
    if "f" in (length.kind, item.kind):
        raise FileError(f"the list {listed[0].name!r} must hold whole numbers")
    fixed = head.itemsize + length.itemsize + tail.itemsize

    def ends(window: NDArray[Any]) -> Int:
        counts = _read_at(
            window, np.arange(max(len(window) - fixed + tail.itemsize + 1, 0)) + head.itemsize, length
        )
        stops = np.full(len(window), len(window) + 1)
        reach = np.arange(len(counts)) + fixed + counts * item.itemsize
        stops[: len(counts)] = np.where((counts > 0) & (counts < _LONGEST), reach, 1 << 60)
        return frozen_int(stops)

    starts, n_bytes = record_starts(data, element.n, ends)
    counts = _read_at(data, starts + head.itemsize, length)
    offsets = np.concatenate(([0], np.cumsum(counts)))
    first = starts + head.itemsize + length.itemsize
    places = np.repeat(first - item.itemsize * offsets[:-1], counts) + item.itemsize * np.arange(offsets[-1])
    values = _fields(before, _read_at(data, starts, head)) | _fields(
        after, _read_at(data, first + item.itemsize * counts, tail)
    )
    entries = frozen_int(_read_at(data, places, item))
    return Rows(values, listed[0].name, frozen_int(offsets), entries), n_bytes


def _read_at(data: NDArray[Any], places: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Decode values of a type at given byte offsets, integers as int64."""
    if not dtype.itemsize:
        return np.empty(len(places), dtype)
    items = data[places[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
    return items.astype(np.int64) if dtype.kind in "iu" else items


def _fields(properties: list[Property], table: NDArray[Any]) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {}
    for i, prop in enumerate(properties):
        columns[prop.name] = table[f"{i}"].astype(np.float64 if prop.type[0] == "f" else np.int64)
    return columns


_HEAD = re.compile(rb"ply\r?\n.*?\nend_header\r?\n", re.S)
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_CORNERS = ("vertex_indices", "vertex_index")
_COLOURS = ("red", "green", "blue", "alpha", "flags")


class _Header(NamedTuple):
    """Header of a PLY file: byte order (empty for text), declared elements, and end of the header."""

    order: str
    elements: list[Element]
    stop: int


class Ply(Reading):
    """PLY files, text or binary: points and polygons, with integers per polygon.

    Surfaces are rejected.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read a PLY file.

        Integer properties of faces become cell tags, colours are ignored.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh, or a surface.
        """
        content = text_bytes(path)
        header = _header(content)
        if not header.order:
            check_last_line(content)
        elements = read_elements(content, header.stop, header.order, header.elements)
        points, (rows, lists) = _points(elements), _faces(elements)
        tags = {
            unquote(name): frozen_int(values)
            for name, values in rows.items()
            if values.dtype.kind in "iu" and name not in _COLOURS
        }
        mesh = Mesh.from_polygons(points, lists, cell_tags=tags, **self.reading, name=path.stem)
        return note_left_out(mesh, [name for name, values in rows.items() if values.dtype.kind == "f"])

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 2-D mesh with its tags and labels, and each coarse mesh to a file beside it.

        Raises
        ------
        FileError
            For a 3-D mesh, cells with holes, or a tag with values beyond 32 bits.
        MeshError
            If files cannot hold a tag name.
        """
        write_levels(path, mesh, hierarchy, _write)


def _header(content: bytes) -> _Header:
    match = _HEAD.match(content[: 1 << 20])
    if match is None:
        raise FileError("it has no header from 'ply' to 'end_header'")
    order, elements = None, list[Element]()
    for line in match[0].decode("utf-8", "replace").splitlines()[1:-1]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) > 1 and words[1] in _FORMATS:
            order = _FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,15}", words[2]):
            elements.append(Element(words[1], int(words[2]), []))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(line, words[1:]))
        else:
            raise FileError(f"its header has a line {line[:40]!r} that cannot be read")
    if order is None:
        raise FileError(f"its header gives no format, expected one of {', '.join(_FORMATS)}")
    return _Header(order, elements, match.end())


def _property(line: str, words: list[str]) -> Property:
    listed = words[:1] == ["list"]
    types = [_TYPES.get(word) for word in words[listed:-1]]
    if len(types) != 1 + listed or None in types:
        raise FileError(f"its header has a property {line[:40]!r} of unknown type")
    return Property(words[-1], str(types[-1]), str(types[0]) if listed else "")


def _points(rows: Mapping[str, Rows]) -> Float:
    coordinates = rows["vertex"].values if "vertex" in rows else {}
    missing = [axis for axis in "xyz" if axis not in coordinates]
    if missing and missing != ["z"]:
        raise FileError(f"its points have no coordinate {missing[0]}")
    return frozen_float(
        np.stack([np.asarray(coordinates[axis], np.float64) for axis in "xyz" if axis in coordinates], axis=1)
    )


def _faces(rows: Mapping[str, Rows]) -> tuple[Mapping[str, NDArray[Any]], tuple[Int, Int]]:
    if "face" not in rows or rows["face"].listed not in _CORNERS:
        raise FileError(f"its faces have no list {' or '.join(_CORNERS)}")
    faces = rows["face"]
    return faces.values, (faces.offsets, faces.lists)


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    loops = loops_of(mesh, ".ply")
    wide = [name for name, values in tags.items() if not fits_in_index(values)]
    if wide:
        raise FileError(f".ply holds 32-bit numbers, but cell tag {wide[0]!r} has larger ones")
    # Each row holds the corners of a polygon, followed by its tags.
    sizes = np.diff(loops.offsets)
    names = "".join(f"property int {quote(name, safe='')}\n" for name in tags)
    rows = np.empty(len(loops.vertices) + len(sizes) * len(tags), np.int64)
    offsets = loops.offsets + len(tags) * np.arange(len(sizes) + 1)
    corner = np.ones(len(rows), bool)
    for place, values in enumerate(tags.values(), -len(tags)):
        rows[offsets[1:] + place] = values
        corner[offsets[1:] + place] = False
    rows[corner] = loops.vertices
    length = "uchar" if sizes.max() < 256 else "int"
    forms = [
        f"{k - len(tags)} " + " ".join(["%d"] * k) + "\n" for k in range(int(sizes.max()) + len(tags) + 1)
    ]
    with open(path, "w", encoding="utf-8") as stream:
        stream.write(f"ply\nformat ascii 1.0\ncomment agglo\nelement vertex {len(loops.points)}\n")
        stream.write("property double x\nproperty double y\nproperty double z\n")
        stream.write(
            f"element face {len(sizes)}\nproperty list {length} int vertex_indices\n{names}end_header\n"
        )
        stream.write(real_lines(np.hstack((loops.points, np.zeros((len(loops.points), 1))))))
        stream.write(integer_lines(frozen_int(offsets), frozen_int(rows), forms))
