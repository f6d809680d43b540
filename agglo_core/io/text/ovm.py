"""Read and write OpenVolumeMesh's text format .ovm: points, edges, half-edges, half-faces.

Half-edge 2 e runs from the first to the second point of edge e, 2 e + 1 in the opposite direction. Half-face
2 f has the half-edges of face f in order, 2 f + 1 is seen from the other side.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integer_lines, integers, line_of, real_lines, reals
from agglo_core.io.text.cell_lines import find_tags, tag_count, tag_lines
from agglo_core.io.text.counted_lists import locate_lists
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.to_mesh.plain_cells import used_points, write_levels
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_TITLES = ("vertices", "edges", "faces", "polyhedra")
_TITLE = re.compile(rb"(?mi)^[ \t]*(vertices|edges|faces|polyhedra)[ \t\r]*$")
_PROPERTY = re.compile(rb"(?mi)^[ \t]*\w*prop\w*[ \t]")
_COMMENT = "# "


class _Section(NamedTuple):
    """A section of a file: title, line number, and offsets of its rows."""

    title: str
    line: int
    start: int
    stop: int


class Ovm(Reading):
    """OpenVolumeMesh as text: points, edges, faces with half-edges, and polyhedra with half-faces."""

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read the mesh in an ``.ovm`` file.

        Properties of other programs are ignored.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh, or a binary file.
        """
        content = whole_text(path)
        text = re.sub(rb"#[^\n]*", b"", content)
        points, edges, faces, cells = (_sections(text)[title] for title in _TITLES)
        count, rows = _numbers(text, points)
        if len(rows) != 3 * count:
            raise FileError(
                f"line {points.line}: {count} points are declared, but {len(rows)} coordinates follow"
            )
        # Expand the half-faces of each cell to vertex loops.
        loop_offsets, loops = _faces(text, faces, _edges(text, edges, count))
        cell_offsets, halves = _lists(text, cells, 2 * (len(loop_offsets) - 1))
        sides, places = gather(loop_offsets, frozen_int(halves >> 1))
        ends = np.repeat(sides[:-1] + sides[1:] - 1, np.diff(sides))
        turned = np.repeat(halves & 1 == 0, np.diff(sides))  # even half-faces look inward by this convention
        rank = np.arange(len(places))
        vertices = loops[places][np.where(turned, ends - rank, rank)]
        solids = Polyhedra(cell_offsets, sides, frozen_int(vertices))
        return Mesh.from_polyhedra(
            frozen_float(rows.reshape(-1, 3)),
            solids,
            cell_tags=find_tags(content, len(cell_offsets) - 1, _COMMENT),
            **self.reading,
            name=path.stem,
        )

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 3-D mesh with its tags and labels, and each coarse mesh to a file beside it.

        Raises
        ------
        FileError
            For a 2-D mesh.
        MeshError
            If files cannot hold a tag name.
        """
        write_levels(path, mesh, hierarchy, _write)


def _sections(content: bytes) -> dict[str, _Section]:
    """Return the sections with points, edges, faces and polyhedra, by title."""
    if content.split(maxsplit=2)[:2] != [b"OVM", b"ASCII"]:
        raise FileError("it does not begin with 'OVM ASCII'; binary OpenVolumeMesh files are not supported")
    first_property = _PROPERTY.search(content)
    end = first_property.start() if first_property is not None else len(content)
    matches = list(_TITLE.finditer(content, 0, end))
    titles = [match[1].decode().lower() for match in matches]
    if titles != list(_TITLES):
        raise FileError(f"its sections are {titles}, expected {', '.join(_TITLES)}")
    stops = [*(match.start() for match in matches[1:]), end]
    return {
        title: _Section(title, line_of(content, match.start()), match.end(), stop)
        for title, match, stop in zip(titles, matches, stops, strict=True)
    }


def _numbers(content: bytes, section: _Section) -> tuple[int, Float]:
    numbers = reals(content, section.start, section.stop)
    if not len(numbers) or not (0 <= numbers[0] < 2**53 and numbers[0] == int(numbers[0])):
        raise FileError(f"line {section.line}: expected the number of {section.title} after this title")
    return int(numbers[0]), frozen_float(numbers[1:])


def _whole(content: bytes, section: _Section) -> tuple[int, Int]:
    numbers = integers(content, section.start, section.stop)
    if not len(numbers) or numbers[0] < 0:
        raise FileError(f"line {section.line}: expected the number of {section.title} after this title")
    return int(numbers[0]), frozen_int(numbers[1:])


def _edges(content: bytes, section: _Section, n_points: int) -> Int:
    """Read the edges and return the first point of each half-edge."""
    count, ends = _whole(content, section)
    if len(ends) != 2 * count:
        raise FileError(f"line {section.line}: {count} edges are declared, but {len(ends)} end points follow")
    if ends.min(initial=0) < 0 or ends.max(initial=-1) >= n_points:
        raise FileError(f"line {section.line}: edges use points outside 0..{n_points - 1}")
    return ends


def _lists(content: bytes, section: _Section, most: int) -> tuple[Int, Int]:
    count, stream = _whole(content, section)
    try:
        offsets, places, length = locate_lists(stream, count)
    except FileError as error:
        raise FileError(f"line {section.line}: {section.title}: {error}") from None
    if length != len(stream):
        raise FileError(
            f"line {section.line}: {count} {section.title} take {length} numbers, but {len(stream)} follow"
        )
    values = stream[places]
    if values.min(initial=0) < 0 or values.max(initial=-1) >= most:
        raise FileError(
            f"line {section.line}: {section.title} use half-edges or half-faces outside 0..{most - 1}"
        )
    return offsets, frozen_int(values)


def _faces(content: bytes, section: _Section, first: Int) -> tuple[Int, Int]:
    """Read the faces as lists of half-edges and convert these to lists of points."""
    offsets, halves = _lists(content, section, len(first))
    if (np.diff(offsets) < 3).any():
        raise FileError(
            f"line {section.line}: face {int(np.argmax(np.diff(offsets) < 3))} has fewer than 3 edges"
        )
    after = np.roll(halves, -1)
    after[offsets[1:] - 1] = halves[offsets[:-1]]
    broken = np.flatnonzero(first[halves ^ 1] != first[after])
    if len(broken):
        face = int(np.searchsorted(offsets, broken[0], side="right")) - 1
        raise FileError(f"line {section.line}: the half-edges of face {face} do not form a closed loop")
    return offsets, frozen_int(first[halves])


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    if mesh.dim != 3:
        raise FileError(f".ovm needs a 3-D mesh, given a {mesh.dim}-D one; write .vtu or .npz instead")
    points, number = used_points(mesh)
    tail = mesh.face_vertices if number is None else frozen_int(number[mesh.face_vertices])
    head = np.roll(tail, -1)
    head[mesh.face_offsets[1:] - 1] = tail[mesh.face_offsets[:-1]]
    key, edge = np.unique(np.minimum(tail, head) * len(points) + np.maximum(tail, head), return_inverse=True)
    halves = 2 * edge.ravel() + (tail > head)
    offsets, faces = mesh.cell_faces
    cell = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    sides = 2 * faces.astype(np.int64) + (mesh.face_cells[faces, 0] == cell)
    with open(path, "w", encoding="utf-8") as stream:
        stream.write(f"OVM ASCII\n{tag_count(tags, _COMMENT)}Vertices\n{len(points)}\n{real_lines(points)}")
        stream.write(f"Edges\n{len(key)}\n")
        ends = np.stack((key // len(points), key % len(points)), axis=1)
        stream.write(integer_lines(frozen_int(2 * np.arange(len(key) + 1)), frozen_int(ends.ravel())))
        for title, starts, values in (("Faces", mesh.face_offsets, halves), ("Polyhedra", offsets, sides)):
            forms = [f"{k} " + " ".join(["%d"] * k) + "\n" for k in range(int(np.diff(starts).max()) + 1)]
            stream.write(f"{title}\n{len(starts) - 1}\n")
            stream.write(integer_lines(frozen_int(starts), frozen_int(values), forms))
        stream.write(tag_lines(tags, _COMMENT))
