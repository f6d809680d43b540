"""Read and write FVCA benchmark meshes: sections, each with a title, a row count and rows.

``.typ2`` lists the points under ``Vertices`` and all cells under ``cells`` or ``Control volumes``, each with
its point count. ``.typ1`` has a title for each cell type. Points are numbered from 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integer_lines, integers, line_of, real_lines, reals
from agglo_core.io.text.cell_lines import find_tags, tag_count, tag_lines, tags_begin
from agglo_core.io.text.counted_lists import locate_lists
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.to_mesh.plain_cells import loops_of, write_levels
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_ALL_KINDS = ("cells", "control volumes")
_KINDS = {
    **{"triangles": 3, "quadrangles": 4, "quadrilaterals": 4, "pentagons": 5, "hexagons": 6, "heptagons": 7},
    **{"octagons": 8, "enneagons": 9, "ennagons": 9, "nonagons": 9, "decagons": 10, "hendecagons": 11},
    **{"dodecagons": 12},
}
_LONGEST = 40  # compared characters of a title
_OTHERS = ("centers", "centres", "edges of the boundary", "all edges", "boundary edges")


class _Section(NamedTuple):
    """A section of a file: title, line number, and offsets of its rows."""

    title: str
    line: int
    start: int
    stop: int


class Fvca(Reading):
    """2-D meshes of the FVCA benchmarks, as used by HArDCore2D and DISK++.

    They are written as ``.typ2``.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read a ``.typ1`` or ``.typ2`` file.

        Cell data in agglo's own files become tags again.

        Files do not declare their sections: one that is truncated between two sections lacks the cells or the
        cell data of the others.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh.
        """
        points, (offsets, vertices), tags = _parse_file(whole_text(path))
        return Mesh.from_polygons(
            points,
            (offsets, vertices),
            cell_tags=tags,
            **self.reading,
            name=path.stem,
        )

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 2-D mesh with its tags and labels, and each coarse mesh to a file beside it.

        Raises
        ------
        FileError
            For a 3-D mesh, or cells with holes.
        MeshError
            If files cannot hold a tag name.
        """
        if path.suffix.lower() == ".typ1":
            raise FileError("a .typ1 file can be read but not written; write .typ2 instead")
        write_levels(path, mesh, hierarchy, _write)


def _parse_file(content: bytes) -> tuple[Float, tuple[Int, Int], dict[str, Int]]:
    """Return the points, the vertices of all cells as CSR, and the cell tags."""
    sections = _sections(content)
    points = _points(content, sections)
    parts = [part for section in sections if (part := _cells(content, section, len(points))) is not None]
    if not parts:
        titles = ", ".join(repr(section.title) for section in sections)
        raise FileError(f"it has no section of cells, such as 'cells' or 'triangles'; found {titles}")
    cells = parts[0]
    if len(parts) > 1:
        sizes = np.concatenate([np.diff(offsets) for offsets, _ in parts])
        offsets = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
        cells = offsets, frozen_int(np.concatenate([vertices for _, vertices in parts]))
    return points, cells, find_tags(content, len(cells[0]) - 1)


def _sections(content: bytes) -> list[_Section]:
    """Return all sections of a file, up to the cell data that agglo adds at the end."""
    end = tags_begin(content)
    titles: list[tuple[str, int, int, int]] = []  # title, line, start of the title, end of its line
    for start, stop in _wordy_lines(content[:end]):
        title = " ".join(
            content[start : min(stop, start + _LONGEST)].decode("ascii", "replace").lower().split()
        )
        line = line_of(content, start)
        if title not in ("vertices", *_ALL_KINDS, *_KINDS, *_OTHERS):
            raise FileError(f"line {line}: unknown section {title!r}")
        titles.append((title, line, start, stop))
    stops = [*(start for _, _, start, _ in titles[1:]), end][: len(titles)]
    return [
        _Section(title, line, begin, stop)
        for (title, line, _, begin), stop in zip(titles, stops, strict=True)
    ]


def _wordy_lines(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield start and end of the lines that contain a word that begins with a letter."""
    codes = np.frombuffer(content, np.uint8)
    letters = np.flatnonzero(codes > ord("9"))
    begins = letters[(letters == 0) | (codes[letters - 1] <= ord(" "))]
    after = 0
    for place in begins.tolist():
        if place >= after:
            after = content.find(b"\n", place)
            after = len(content) if after < 0 else after
            yield place, after


def _points(content: bytes, sections: list[_Section]) -> Float:
    """Read the points ``(n, 2)``, which must be the first section of the file."""
    if not sections or sections[0].title != "vertices" or not content.lstrip()[:8].isalpha():
        raise FileError("it does not begin with the title 'Vertices'")
    first = sections[0]
    numbers = reals(content, first.start, first.stop)
    n = _count(numbers[:1], first)
    if len(numbers) - 1 != 2 * n:
        raise FileError(
            f"line {first.line}: {n} points are declared, but {len(numbers) - 1} coordinates follow, "
            f"expected {2 * n}"
        )
    return frozen_float(numbers[1:].reshape(-1, 2))


def _cells(content: bytes, section: _Section, n_points: int) -> tuple[Int, Int] | None:
    """Return the cell vertices in a section as CSR, or None if the section lists no cells."""
    if section.title not in (*_ALL_KINDS, *_KINDS):
        return None
    numbers = integers(content, section.start, section.stop)
    n, rows = _count(numbers[:1], section), frozen_int(numbers[1:])
    if section.title in _KINDS:
        size = _KINDS[section.title]
        offsets, vertices, length = frozen_int(np.arange(0, len(rows) + 1, size)), rows, n * size
    else:
        offsets, vertices, length = _lists(rows, n, section)
    if length != len(rows):
        raise FileError(
            f"line {section.line}: {n} {section.title} take {length} numbers, but {len(rows)} follow"
        )
    if vertices.min(initial=1) < 1 or vertices.max(initial=1) > n_points:
        wrong = np.flatnonzero((vertices < 1) | (vertices > n_points))
        cell = int(np.searchsorted(offsets, wrong[0], side="right")) - 1
        raise FileError(
            f"line {section.line}: cell {cell} of {section.title!r} uses point {vertices[wrong[0]]}, "
            f"expected 1 to {n_points}"
        )
    return offsets, frozen_int(vertices - 1)


def _lists(rows: Int, n: int, section: _Section) -> tuple[Int, Int, int]:
    try:
        offsets, places, length = locate_lists(rows, n)
    except FileError as error:
        raise FileError(f"line {section.line}: {error}") from None
    return offsets, frozen_int(rows[places]), length


def _count(numbers: Float | Int, section: _Section) -> int:
    if not len(numbers) or not (0 <= numbers[0] < 2**53 and numbers[0] == int(numbers[0])):
        raise FileError(f"line {section.line}: expected the number of {section.title} after this title")
    return int(numbers[0])


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    loops = loops_of(mesh, ".typ2")
    sizes = np.diff(loops.offsets)
    forms = [f"{k} " + " ".join(["%d"] * k) + "\n" for k in range(int(sizes.max()) + 1)]
    with open(path, "w", encoding="utf-8") as stream:
        stream.write(f"Vertices\n{len(loops.points)}\n")
        stream.write(real_lines(loops.points))
        stream.write(f"cells\n{len(sizes)}\n")
        stream.write(integer_lines(loops.offsets, frozen_int(loops.vertices + 1), forms))
        stream.write(tag_count(tags) + tag_lines(tags))
