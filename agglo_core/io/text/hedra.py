"""Read and write cinolib's .hedra: three counts, then points, faces, and cells as lists of faces."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integer_lines, real_lines, reals
from agglo_core.io.text.cell_lines import find_tags, tag_count, tag_lines, tags_begin
from agglo_core.io.text.counted_lists import locate_lists
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.to_mesh.plain_cells import used_points, write_levels
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


class Hedra(Reading):
    """Files ``.hedra``: points, faces, and polyhedra as lists of face numbers.

    The number of a face seen from inside the polyhedron is negative.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read the mesh in a ``.hedra`` file.

        Cell data in agglo's own files become tags again. A file that is truncated after its cells has none.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh.
        """
        content = whole_text(path)
        # Read the counts and the points.
        numbers = reals(content, 0, tags_begin(content))
        counts = numbers[:3].tolist()
        if len(counts) < 3 or not all(0 <= n < 2**53 and n == int(n) for n in counts):
            raise FileError(f"begins with {counts}, expected the numbers of points, faces and cells")
        n_points, n_faces, n_cells = (int(n) for n in counts)
        rows = numbers[3 : 3 + 3 * n_points]
        if len(rows) != 3 * n_points:
            raise FileError(f"{n_points} points are declared, but {len(rows)} coordinates follow")
        # Read the faces, then the cells; the orientation of faces is determined later.
        topology = numbers[3 + 3 * n_points :]
        if (np.abs(topology) >= 2**53).any() or (topology != np.floor(topology)).any():
            raise FileError("its lists of faces and cells must hold whole numbers")
        stream = frozen_int(topology.astype(np.int64))
        offsets, vertices, faces_length = _lists(stream, n_faces, n_points, "faces", "point")
        cells = frozen_int(stream[faces_length:])
        cell_offsets, faces, cells_length = _lists(cells, n_cells, n_faces, "cells", "face")
        if cells_length != len(cells):
            raise FileError(f"{n_cells} cells take {cells_length} numbers, but {len(cells)} follow")
        loop_offsets, places = gather(offsets, faces)
        return Mesh.from_polyhedra(
            frozen_float(rows.reshape(-1, 3)),
            Polyhedra(cell_offsets, loop_offsets, frozen_int(vertices[places])),
            cell_tags=find_tags(content, n_cells),
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


def _lists(stream: Int, n: int, most: int, title: str, item: str) -> tuple[Int, Int, int]:
    """Read lists of point or face numbers, drop their signs, and shift them to start from 0."""
    try:
        offsets, places, length = locate_lists(stream, n)
    except FileError as error:
        raise FileError(f"{title}: {error}") from None
    values = np.abs(stream[places]) - 1
    if values.min(initial=0) < 0 or values.max(initial=-1) >= most:
        wrong = int(np.argmax((values < 0) | (values >= most)))
        row = int(np.searchsorted(offsets, wrong, side="right")) - 1
        raise FileError(
            f"{title}: entry {row} (counted from 0) uses {item} {values[wrong] + 1}, expected 1 to {most}"
        )
    return offsets, frozen_int(values), length


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    if mesh.dim != 3:
        raise FileError(f".hedra needs a 3-D mesh, given a {mesh.dim}-D one; write .vtu or .npz instead")
    points, number = used_points(mesh)
    vertices = mesh.face_vertices if number is None else number[mesh.face_vertices]
    offsets, faces = mesh.cell_faces
    cell = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    sign = np.where(mesh.face_cells[faces, 0] == cell, 1, -1)
    with open(path, "w", encoding="utf-8") as stream:
        stream.write(f"{len(points)} {mesh.n_faces} {mesh.n_cells}\n")
        stream.write(real_lines(points))
        for starts, values in ((mesh.face_offsets, vertices + 1), (offsets, sign * (faces + 1))):
            widest = int(np.diff(starts).max())
            forms = [f"{k} " + " ".join(["%d"] * k) + "\n" for k in range(widest + 1)]
            stream.write(integer_lines(frozen_int(starts), frozen_int(values), forms))
        stream.write(tag_count(tags) + tag_lines(tags))
