"""Read and write 2-D polygons as .off and .obj files, with tags and labels in comments."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integer_lines, integers, real_lines, reals, words_per_line
from agglo_core.io.text.cell_lines import find_tags, tag_count, tag_lines
from agglo_core.io.text.counted_lists import locate_lists
from agglo_core.io.to_mesh.options import Reading, ReadOptions
from agglo_core.io.to_mesh.plain_cells import loops_of, write_levels
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_COMMENT = "# "
_OFF = re.compile(rb"\s*(?:((?:ST)?C?N?)OFF)?\s+(?=\d)")


class Off(Reading):
    """OFF files: points and polygons.

    The coordinate z must be constant (2-D); surfaces are rejected.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read an OFF file and ignore normals, texture coordinates and colours.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh, a binary or four-dimensional file, or a surface.
        """
        # Header and counts.
        content = whole_text(path)
        text = re.sub(rb"#[^\n]*", b"", content)
        head = _OFF.match(text)
        if head is None:
            raise FileError("it does not begin with OFF and the numbers of points and faces, as text")
        body = text[head.end() :]
        numbers = reals(text, head.end())
        counts = numbers[:3]
        if len(counts) < 3 or not all(0 <= n < 2**53 and n == int(n) for n in counts.tolist()):
            raise FileError(
                f"its header is {counts.tolist()}, expected the numbers of points, faces and edges"
            )
        n_points, n_faces = (int(n) for n in counts[:2])
        # One line per point and face if possible, otherwise a free stream of numbers.
        rows = _off_rows(numbers, words_per_line(body), n_points, n_faces)
        if rows is None:
            if head[1]:
                raise FileError(
                    f"{head[1].decode()}OFF needs one line for each of the {n_points} points, all with "
                    f"equally many numbers, and one line for each of the {n_faces} faces"
                )
            rows = _off_stream(numbers[3:], n_points, n_faces)
        return _mesh(path, content, *rows, self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 2-D mesh with its tags and labels, and each coarse mesh to a file beside it.

        Raises
        ------
        FileError
            For a mesh in 3-D, or cells with holes.
        MeshError
            If files cannot hold a tag name.
        """
        write_levels(path, mesh, hierarchy, _write_off)


def _off_rows(
    numbers: Float, widths: Int, n_points: int, n_faces: int
) -> tuple[Float, tuple[Int, Int]] | None:
    """Read one point or face from each line, and ignore further numbers such as colours.

    Return None if the lines are broken differently.
    """
    points, faces = widths[1 : 1 + n_points], widths[1 + n_points :]
    if len(faces) != n_faces or len(points) != n_points or widths[0] != 3:
        return None
    if not n_points or points.min() < 3 or points.min() != points.max():
        return None
    first = 3 + int(points.sum())
    starts = first + np.cumsum(faces) - faces
    sizes = _whole(numbers[starts])
    if (sizes < 1).any() or (sizes >= faces).any():
        return None
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    places = np.arange(offsets[-1]) + np.repeat(starts + 1 - offsets[:-1], sizes)
    table = numbers[3:first].reshape(n_points, -1)[:, :3]
    return frozen_float(table), (frozen_int(offsets), _whole(numbers[places]))


def _off_stream(numbers: Float, n_points: int, n_faces: int) -> tuple[Float, tuple[Int, Int]]:
    """Read points and faces from numbers with arbitrary line breaks, without colours or normals."""
    rows, face_numbers = numbers[: 3 * n_points], numbers[3 * n_points :]
    if len(rows) != 3 * n_points:
        raise FileError(f"{n_points} points are declared, but {len(rows)} coordinates follow")
    stream = _whole(face_numbers)
    offsets, places, length = locate_lists(stream, n_faces)
    if length != len(stream):
        raise FileError(f"{n_faces} faces take {length} numbers, but {len(stream)} follow")
    return frozen_float(rows.reshape(-1, 3)), (offsets, frozen_int(stream[places]))


def _whole(numbers: Float) -> Int:
    """Convert numbers to integers, with −1 for those that are not integers."""
    whole = np.where(np.abs(numbers) < 2**53, numbers, -1).astype(np.int64)
    return frozen_int(np.where(whole == numbers, whole, -1))


class Obj(Reading):
    """Wavefront OBJ files: points and polygons.

    The coordinate z must be constant (2-D); surfaces are rejected.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read an OBJ file and ignore normals, texture coordinates and groups.

        Files of other programs do not declare their size: one that is truncated after a line has fewer cells.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh, or a surface.
        """
        content = whole_text(path)
        # Points: lines "v x y z"; backslashes continue lines.
        text = content.replace(b"\\\n", b" ")
        rows = b"\n".join(re.findall(rb"(?m)^v[ \t]+([^\n#]*)", text))
        widths = words_per_line(rows)
        if not len(widths) or widths.min() != widths.max() or widths[0] < 3:
            widths_found = sorted(set(widths.tolist()))[:3]
            raise FileError(
                f"its points (lines 'v x y z') have {widths_found} coordinates, expected 3 or more per point"
            )
        points = frozen_float(reals(rows).reshape(-1, int(widths[0]))[:, :3])
        # Faces: lines "f v/vt/vn …", of which only v is kept.
        lines = b"\n".join(re.findall(rb"(?m)^f[ \t]+([^\n#]*)", text))
        lines = re.sub(rb"/[^\s]*", b"", lines)
        offsets = frozen_int(np.concatenate(([0], np.cumsum(words_per_line(lines)))))
        _check_own_counts(content, len(points), len(offsets) - 1)
        values = integers(lines)
        vertices = np.where(values > 0, values - 1, values + len(points))  # negative: counted from the end
        vertices[values == 0] = -1
        return _mesh(path, content, points, (offsets, frozen_int(vertices)), self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 2-D mesh with its tags and labels, and each coarse mesh to a file beside it.

        Raises
        ------
        FileError
            For a mesh in 3-D, or cells with holes.
        MeshError
            If files cannot hold a tag name.
        """
        write_levels(path, mesh, hierarchy, _write_obj)


def _check_own_counts(content: bytes, n_points: int, n_faces: int) -> None:
    """Reject files written by agglo that are truncated, by the counts in their first line.

    Files of other programs do not declare their size.
    """
    match = re.match(rb"# agglo: (\d{1,18}) points, (\d{1,18}) polygons\n", content)
    if match is None:
        return
    if (int(match[1]), int(match[2])) != (n_points, n_faces):
        raise FileError(
            f"truncated: {match[1].decode()} points and {match[2].decode()} polygons are declared, "
            f"but {n_points} and {n_faces} were found"
        )


def _mesh(path: Path, content: bytes, points: Float, cells: tuple[Int, Int], options: ReadOptions) -> Mesh:
    tags = find_tags(content, len(cells[0]) - 1, _COMMENT)
    return Mesh.from_polygons(points, cells, cell_tags=tags, **options, name=path.stem)


def _write_off(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    loops = loops_of(mesh, ".off")
    sizes = np.diff(loops.offsets)
    forms = [f"{k} " + " ".join(["%d"] * k) + "\n" for k in range(int(sizes.max()) + 1)]
    with open(path, "w", encoding="utf-8") as stream:
        # The number of tags follows on the line of the counts, because some readers expect no comment line.
        stream.write(f"OFF\n{len(loops.points)} {len(sizes)} 0 {tag_count(tags, _COMMENT)}".rstrip() + "\n")
        stream.write(real_lines(_flat(loops.points)))
        stream.write(integer_lines(loops.offsets, loops.vertices, forms))
        stream.write(tag_lines(tags, _COMMENT))


def _write_obj(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    loops = loops_of(mesh, ".obj")
    widest = int(np.diff(loops.offsets).max())
    forms = ["f " + " ".join(["%d"] * k) + "\n" for k in range(widest + 1)]
    with open(path, "w", encoding="utf-8") as stream:
        stream.write(f"# agglo: {len(loops.points)} points, {len(loops.offsets) - 1} polygons\n")
        stream.write(tag_count(tags, _COMMENT))
        stream.write(real_lines(_flat(loops.points), "v "))
        stream.write(integer_lines(loops.offsets, frozen_int(loops.vertices + 1), forms))
        stream.write(tag_lines(tags, _COMMENT))


def _flat(points: Float) -> Float:
    return frozen_float(np.hstack((points, np.zeros((len(points), 1)))))
