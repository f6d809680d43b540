"""Read legacy VTK files: unstructured grids with polyhedra and PolyData, text and binary, any version."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import check_last_line
from agglo_core.io.tags import tag_values
from agglo_core.io.text.counted_lists import locate_lists
from agglo_core.io.vtk.pieces import Stored, StoredArrays, check_counts, polydata_cells, soup_of_piece

_DATASETS = ("UNSTRUCTURED_GRID", "POLYDATA")
_LISTS = {"VERTICES": "Verts", "LINES": "Lines", "POLYGONS": "Polys", "TRIANGLE_STRIPS": "Strips"}
_POLYHEDRON = 42
_NUMBERS = {
    "char": "i1",
    "signed_char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtkidtype": "i4",
    "float": "f4",
    "double": "f8",
    **{f"vtktype{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)},
}
_WIDTHS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}
_TEXTS = ("string", "variant", "utf8_string", "unicode_string")


def legacy_kind(path: Path) -> str:
    """Return the dataset type of a legacy VTK file, or an empty string if it is not supported."""
    with open(path, "rb") as file:
        head = file.read(1024).split(b"\n")
    if not head[0].lower().startswith(b"# vtk datafile version"):
        return ""
    datasets = [line.split()[1:2] for line in head[2:] if line.upper().startswith(b"DATASET")]
    kind = datasets[0][0].decode("ascii", "replace").upper() if datasets and datasets[0] else ""
    return kind if kind in _DATASETS else ""


def read_legacy(path: Path) -> Stored:
    """Read the cells and the integer cell data in a legacy VTK file.

    Files do not declare their arrays: one that is truncated between two arrays lacks the others.

    Raises
    ------
    FileError
        For a truncated file, or unknown content.
    """
    with open(path, "rb") as file:
        return _Reader(file, os.fstat(file.fileno()).st_size).stored()


@dataclass
class _Reader:
    """Parser that collects the arrays of a legacy VTK file section by section."""

    file: BinaryIO
    size: int
    text: bool = True
    points: Float | None = None
    lists: dict[str, tuple[Int, Int]] = field(default_factory=dict)
    types: Int | None = None
    data: dict[str, NDArray[Any]] = field(default_factory=dict)  # of cells
    ours: bool = False  # True if the following arrays are cell data
    count: int = 0  # number of values in these arrays

    def stored(self) -> Stored:
        """Read the whole file and return its cells and tags."""
        header = [self.file.readline() for _ in range(3)]
        encoding = header[2].strip().upper()
        if encoding not in (b"ASCII", b"BINARY"):
            raise FileError(f"line 3: expected ASCII or BINARY, found {encoding[:20]!r}")
        self.text = encoding == b"ASCII"
        if self.text:
            self._check_end()
        for line in iter(self.file.readline, b""):
            words = line.decode("utf-8", "replace").split()
            if words:
                self._section(words)
        if self.points is None:
            raise FileError("it has no section POINTS")
        if self.ours and not self.data:
            raise FileError("truncated: no array follows CELL_DATA")
        # Assemble the cells and attach integer cell data as tags.
        arrays = polydata_cells(self.lists) if self.types is None else self._grid(self.types)
        n = len(arrays["types"])
        check_counts(len(self.points), n)
        tags, skipped_names = {}, []
        for name, values in self.data.items():
            if values.dtype.kind not in "iu" or values.shape[1] != 1:
                skipped_names.append(name)
                continue
            if len(values) != n:
                raise FileError(f"cell data {name!r} has {len(values)} values for {n} cells")
            tags[name] = tag_values(name, values.ravel())
        return Stored([soup_of_piece(arrays, self.points, n)._replace(tags=tags)], skipped_names)

    def _check_end(self) -> None:
        """Raise FileError if the last line of a text file is incomplete, and keep the position."""
        place = self.file.tell()
        self.file.seek(self.size - 1)
        if self.file.read() not in (b"\n", b"\r"):
            self.file.seek(0)
            check_last_line(self.file.read())
        self.file.seek(place)

    def _section(self, words: list[str]) -> None:
        title = words[0].upper()
        if title == "DATASET":
            return
        if title == "METADATA":
            while self.file.readline().strip():
                pass
        elif title == "POINTS":
            self.points = frozen_float(self._array(_word(words, 2), 3 * _count(words, 1)).reshape(-1, 3))
        elif title == "CELLS" or title in _LISTS:
            self.lists[_LISTS.get(title, title)] = self._lists(_count(words, 1), _count(words, 2))
        elif title == "CELL_TYPES":
            self.types = frozen_int(self._array("int", _count(words, 1)))
        elif title in ("CELL_DATA", "POINT_DATA"):
            self.ours, self.count = title == "CELL_DATA", _count(words, 1)
        elif title == "FIELD":
            for _ in range(_count(words, 2)):
                self._field()
        else:
            self._attribute(title, words)

    def _attribute(self, title: str, words: list[str]) -> None:
        """Read a data array (scalars, vectors, …) with values per cell or point."""
        colour = "float" if self.text else "unsigned_char"
        if title == "LOOKUP_TABLE":
            self._array(colour, 4 * _count(words, 2))
            return
        if title == "SCALARS":
            width, kind = _count(words, 3) if len(words) > 3 else 1, _word(words, 2)
            place = self.file.tell()
            line = self.file.readline()
            if not line.endswith(b"\n"):
                raise _short(self.count * width, kind)
            if not line.upper().startswith(b"LOOKUP_TABLE"):
                self.file.seek(place)
        elif title == "COLOR_SCALARS":
            width, kind = _count(words, 2), colour
        elif title == "TEXTURE_COORDINATES":
            width, kind = _count(words, 2), _word(words, 3)
        elif title in _WIDTHS:
            width, kind = _WIDTHS[title], _word(words, 2)
        else:
            raise FileError(f"unknown section {words[0][:30]!r}")
        self._keep(_word(words, 1), self._array(kind, self.count * width), width)

    def _field(self) -> None:
        """Read the next array in a section FIELD."""
        words = self._next_line()
        if words[0].upper() == "METADATA":
            self._section(words)
            words = self._next_line()
        width, n, kind = _count(words, 1), _count(words, 2), _word(words, 3)
        if kind.lower() not in _TEXTS:
            self._keep(words[0], self._array(kind, width * n), width)
            return
        if not self.text:
            raise FileError(f"array {words[0]!r} holds text, which is not supported in binary files")
        for _ in range(min(width * n, self.size)):
            self.file.readline()
        if self.ours:
            self.data[unquote(words[0])] = np.empty((n if n < self.size else 0, width), "U0")

    def _next_line(self) -> list[str]:
        for line in iter(self.file.readline, b""):
            words = line.decode("utf-8", "replace").split()
            if words:
                return words
        raise FileError("truncated: it ends before the last array of a FIELD")

    def _keep(self, name: str, values: NDArray[Any], width: int) -> None:
        if self.ours:
            self.data[unquote(name)] = values.reshape(-1, max(width, 1))

    def _lists(self, n: int, size: int) -> tuple[Int, Int]:
        """Read lists of integers, and return the end of each list and their concatenated entries.

        Since version 5.1 offsets are stored separately, earlier a count before each list.
        """
        place = self.file.tell()
        words = self.file.readline().decode("ascii", "replace").split()
        if words[:1] != ["OFFSETS"]:
            self.file.seek(place)
            stream = frozen_int(self._array("int", size))
            offsets, places, length = locate_lists(stream, n)
            if length != size:
                raise FileError(f"{n} lists take {length} numbers, but {size} are declared")
            return frozen_int(offsets[1:]), frozen_int(stream[places])
        offsets = frozen_int(self._array(_word(words, 1), n))
        words = self._next_line()
        if words[0] != "CONNECTIVITY":
            raise FileError(f"expected CONNECTIVITY after OFFSETS, found {words[0][:20]!r}")
        entries = frozen_int(self._array(_word(words, 1), size))
        if not n or offsets[0] != 0 or (np.diff(offsets) < 0).any() or offsets[-1] != size:
            raise FileError(f"OFFSETS must increase from 0 to {size}")
        return frozen_int(offsets[1:]), entries

    def _grid(self, types: Int) -> StoredArrays:
        """Convert the cells of an unstructured grid to the arrays of the newer XML format.

        The lists of polyhedra are their faces.
        """
        ends, entries = self.lists.get("CELLS", (frozen_int([]), frozen_int([])))
        if len(ends) != len(types):
            raise FileError(f"there are {len(ends)} CELLS, but {len(types)} CELL_TYPES")
        sizes, solid = np.diff(ends, prepend=0), types == _POLYHEDRON
        of_solid = np.repeat(solid, sizes)
        return StoredArrays(
            types=types,
            offsets=frozen_int(np.cumsum(np.where(solid, 0, sizes))),
            connectivity=frozen_int(entries[~of_solid]),
            faceoffsets=frozen_int(np.where(solid, np.cumsum(np.where(solid, sizes, 0)), -1)),
            faces=frozen_int(entries[of_solid]),
        )

    def _array(self, kind: str, n: int) -> NDArray[Any]:
        """Read n numbers of a given VTK type, as text or binary."""
        kind = kind.lower()
        if kind not in _NUMBERS and kind != "bit":
            raise FileError(f"unknown number type {kind[:30]!r}")
        dtype = np.dtype(_NUMBERS.get(kind, "u1"))
        packed = kind == "bit" and not self.text
        n_items = -(-n // 8) if packed else n
        if n_items * (1 if self.text else dtype.itemsize) > self.size:
            raise _short(n, kind)
        if self.text:
            values = self._numbers(np.dtype("f8" if dtype.kind == "f" else "i8"), n)
        else:
            values = np.fromfile(self.file, dtype.newbyteorder(">"), n_items).astype(dtype)
        if len(values) != n_items:
            raise _short(n, kind)
        return np.unpackbits(values)[:n] if packed else values

    def _numbers(self, dtype: np.dtype[Any], n: int) -> NDArray[Any]:
        """Read n numbers of a text file, or fewer if other text follows before the n-th."""
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # numpy before 2.4 warns about invalid numbers
            try:
                return np.fromfile(self.file, dtype, n, sep=" ")
            except (ValueError, DeprecationWarning):
                return np.empty(0, dtype)


def _word(words: list[str], place: int) -> str:
    if len(words) <= place:
        raise FileError(f"line {' '.join(words)[:40]!r} is incomplete")
    return words[place]


def _count(words: list[str], place: int) -> int:
    word = _word(words, place)
    if not (word.isascii() and word.isdigit() and len(word) < 19):
        raise FileError(f"line {' '.join(words)[:40]!r}: expected a count, found {word[:20]!r}")
    return int(word)


def _short(n: int, kind: str) -> FileError:
    return FileError(f"truncated, or not in the declared format: expected {n} numbers of type {kind}")
