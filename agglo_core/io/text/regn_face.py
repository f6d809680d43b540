"""Read and write pairs of a point file and a cell file: REGN_FACE polyhedra, Triangle, TetGen.

Line breaks are arbitrary, so files with one line per face are also read. Points are numbered from 0, or
from the first number in the point file.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, label_order
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integer_lines, integers, real_lines, reals
from agglo_core.io.tags import note_left_out
from agglo_core.io.text.cell_lines import find_tags, tag_count, tag_lines
from agglo_core.io.text.counted_lists import locate_solids
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.to_mesh.plain_cells import solids_of, write_levels
from agglo_core.io.to_mesh.soup import Soup, mesh_from_soup
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, concatenate

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_COMMENT = "# "
_SIMPLICES = {2: 5, 3: 10}  # VTK types of triangles and tetrahedra

_log = logging.getLogger("agglo")


class RegnFace(Reading):
    """Polyhedra as lists of faces in ``NAME.ele`` with points in ``NAME.node``.

    Either name is accepted.

    Triangle's triangles and TetGen's tetrahedra with the same suffixes are also read.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read ``NAME.node`` and ``NAME.ele``.

        Cell data in agglo's own files become tags again.

        Integer cell attributes of Triangle and TetGen become tags ``triangle:ref`` and ``tetgen:ref``,
        further attributes ``triangle:ref2``, ….

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh.
        """
        cells = _content(path, ".ele")
        first, body = _head(cells, path.with_suffix(".ele"))
        if len(first) not in (2, 3):
            raise FileError(
                f"{path.stem}.ele begins with {len(first)} numbers, expected 2 (polyhedra as lists of faces) "
                "or 3 (triangles, tetrahedra)"
            )
        number, points = _points(_content(path, ".node"), path.with_suffix(".node"))
        if len(first) == 3:
            soup, skipped_names = _simplices(body, first, number, points, f"{path.stem}.ele")
            mesh = mesh_from_soup(soup, weak=False, name=path.stem, **self.reading)
            return note_left_out(mesh, skipped_names)
        if points.shape[1] != 3:
            raise FileError(f"{path.stem}.node has 2-D points, but {path.stem}.ele has polyhedra")
        solids = _solids(body, first, number, len(points), path.stem)
        tags = find_tags(cells, len(solids.cell_offsets) - 1, _COMMENT)
        return Mesh.from_polyhedra(points, solids, cell_tags=tags, **self.reading, name=path.stem)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write ``NAME.node`` and ``NAME.ele``, and ``NAME_level0.node``, ``.ele``, ``.partition`` per level.

        Raises
        ------
        FileError
            For a 2-D mesh.
        MeshError
            If files cannot hold a tag name.
        """
        write_levels(path, mesh, hierarchy, _write)
        for level, labels in enumerate(hierarchy.levels if hierarchy is not None else ()):
            sizes = np.bincount(labels)
            offsets = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
            rows = np.insert(label_order(labels), offsets[:-1], sizes)
            text = integer_lines(frozen_int(offsets + np.arange(len(offsets))), frozen_int(rows))
            path.with_name(f"{path.stem}_level{level}.partition").write_text(text)


def _content(path: Path, suffix: str) -> bytes:
    file = path if path.suffix.lower() == suffix else path.with_suffix(suffix)
    try:
        return whole_text(file)
    except FileError as error:
        raise FileError(f"its companion file {file.name}: {error}") from None


def _head(content: bytes, file: Path) -> tuple[Int, bytes]:
    """Split a file without its comments into the numbers in the first line and the remaining text."""
    text = re.sub(rb"#[^\n]*", b"", content).lstrip()
    line, _, body = text.partition(b"\n")
    try:
        return integers(line), body
    except FileError as error:
        raise FileError(f"{file.name}: {error}") from None


def _points(content: bytes, file: Path) -> tuple[int, Float]:
    """Read the points, and return also the number of the first (0 or 1)."""
    head, body = _head(content, file)
    if len(head) != 4 or head[1] not in (2, 3) or head.min() < 0:
        raise FileError(
            f"{file.name} begins with {head.tolist()}, expected the number of points, 2 or 3 coordinates, "
            "and the numbers of attributes and boundary markers"
        )
    n, dim, width = int(head[0]), int(head[1]), int(1 + head[1] + head[2] + head[3])
    try:
        numbers = reals(body)
    except FileError as error:
        raise FileError(f"{file.name}: {error}") from None
    if len(numbers) != n * width:
        raise FileError(
            f"{file.name}: {n} points with {width} numbers each are declared, but {len(numbers)} follow"
        )
    rows = numbers.reshape(n, width)
    if not n or not np.array_equal(rows[:, 0], rows[0, 0] + np.arange(n)) or rows[0, 0] not in (0, 1):
        raise FileError(f"{file.name}: points must be numbered consecutively from 0 or 1")
    if head[3]:
        _log.info("%s: boundary markers of points are left out", file.name)
    return int(rows[0, 0]), frozen_float(rows[:, 1 : 1 + dim])


def _simplices(body: bytes, head: Int, first: int, points: Float, file: str) -> tuple[Soup, list[str]]:
    """Read triangles or tetrahedra, with integer attributes as tags and the names of skipped attributes."""
    n, width, n_attributes = head.tolist()
    dim = points.shape[1]
    if width not in (dim + 1, (dim + 1) * (dim + 2) // 2) or n_attributes < 0:
        raise FileError(
            f"{file} begins with {head.tolist()}; {dim}-D cells have {dim + 1} or "
            f"{(dim + 1) * (dim + 2) // 2} nodes"
        )
    # Read the rows: number, nodes, attributes.
    try:
        numbers = reals(body)
    except FileError as error:
        raise FileError(f"{file}: {error}") from None
    columns = 1 + width + n_attributes
    if len(numbers) != n * columns:
        raise FileError(
            f"{file}: {n} cells with {columns} numbers each are declared, but {len(numbers)} follow"
        )
    rows = numbers.reshape(n, columns)
    nodes = rows[:, 1 : 1 + width] - first
    wrong = np.flatnonzero(~((nodes >= 0) & (nodes < len(points)) & (nodes == np.floor(nodes))).all(axis=1))
    if len(wrong):
        raise FileError(f"{file}: cell {wrong[0]} uses points outside {first}..{len(points) - 1 + first}")
    # Integer attributes become tags.
    tags, skipped_names = {}, []
    for k, values in enumerate(rows[:, 1 + width :].T, 1):
        name = f"{'triangle' if dim == 2 else 'tetgen'}:ref{k if k > 1 else ''}"
        if (np.abs(values) < 1 << 53).all() and (values == np.floor(values)).all():
            tags[name] = frozen_int(values.astype(np.int64))
        else:
            skipped_names.append(name)
    types = np.full(n, _SIMPLICES[dim])
    offsets = frozen_int(np.arange(0, n * width + 1, width))
    vertices = frozen_int(nodes.astype(np.int64).ravel())
    return Soup(points, frozen_int(types), offsets, vertices, concatenate([]), tags), skipped_names


def _solids(body: bytes, head: Int, first: int, n_points: int, name: str) -> Polyhedra:
    if head[1] != 0:
        raise FileError(f"{name}.ele: {head[1]} attributes per cell are declared, which are not supported")
    try:
        stream = integers(body)
        cell_offsets, loop_offsets, places, length = locate_solids(stream, int(head[0]), 1)
    except FileError as error:
        raise FileError(f"{name}.ele: {error}") from None
    if length != len(stream):
        raise FileError(f"{name}.ele: {head[0]} cells take {length} numbers, but {len(stream)} follow")
    vertices = stream[places] - first
    if vertices.min(initial=0) < 0 or vertices.max(initial=0) >= n_points:
        loop = (
            np.searchsorted(loop_offsets, np.argmax((vertices < 0) | (vertices >= n_points)), side="right")
            - 1
        )
        cell = int(np.searchsorted(cell_offsets, loop, side="right")) - 1
        raise FileError(f"{name}.ele: cell {cell} uses points outside {first}..{n_points - 1 + first}")
    return Polyhedra(cell_offsets, loop_offsets, frozen_int(vertices))


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    points, solids = solids_of(mesh, path.suffix)
    n = len(points)
    rows = real_lines(points).splitlines()
    numbered = "".join(f"{i} {row}\n" for i, row in enumerate(rows))
    text = f"# points of {path.stem}.ele\n{n} 3 0 0\n{numbered}"
    path.with_suffix(".node").write_text(text, encoding="utf-8", errors="surrogateescape")
    # Insert the head (number, size) before each face, then the head before each cell.
    counts, sizes = np.diff(solids.cell_offsets), np.diff(solids.loop_offsets)
    rank = np.arange(len(sizes)) - np.repeat(solids.cell_offsets[:-1], counts)
    heads = np.stack((rank, sizes), axis=1).ravel()
    stream = np.insert(solids.vertices, np.repeat(solids.loop_offsets[:-1], 2), heads)
    starts = solids.loop_offsets + 2 * np.arange(len(solids.loop_offsets))
    cells = np.stack((np.arange(len(counts)), counts), axis=1).ravel()
    stream = np.insert(stream, np.repeat(starts[solids.cell_offsets[:-1]], 2), cells)
    lengths = np.insert(sizes + 2, solids.cell_offsets[:-1], 2)
    offsets = frozen_int(np.concatenate(([0], np.cumsum(lengths))))
    with open(path.with_suffix(".ele"), "w", encoding="utf-8") as file:
        file.write(f"# cells as lists of faces (REGN_FACE)\n{tag_count(tags, _COMMENT)}{len(counts)} 0\n")
        file.write(integer_lines(offsets, frozen_int(stream)))
        file.write(tag_lines(tags, _COMMENT))
