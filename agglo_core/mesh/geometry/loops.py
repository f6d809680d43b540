"""Compute the boundary of 2-D cells as closed vertex loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.mesh.counting_sort import counting_sort
from agglo_core.threads import over_ranges


class Loops(NamedTuple):
    """Boundary of each 2-D cell as closed vertex loops.

    Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]``; loop l owns
    ``vertices[loop_offsets[l]:loop_offsets[l + 1]]``. The cell lies on the left of each loop: outer
    loops run counter-clockwise, holes clockwise. No loop visits a vertex twice.

    Examples
    --------
    >>> from agglo_core import samples
    >>> loops = samples.squares(2).boundary_loops
    >>> loops.vertices[: loops.loop_offsets[1]]  # around the first cell
    array([0, 1, 4, 3])
    """

    cell_offsets: Int
    loop_offsets: Int
    vertices: Int


def faces_of_cells(face_cells: Int, n_cells: int) -> tuple[Int, Int]:
    """Return the faces per cell as CSR, in ascending order."""
    offsets, faces = _faces_of_cells(face_cells, n_cells)
    return offsets, frozen_int(faces)


def _faces_of_cells(face_cells: Int, n_cells: int) -> tuple[Int, Int]:
    """Return the faces per cell as CSR, the faces in a writable array."""
    from agglo_core.mesh.kernels.faces import cell_faces

    faces = np.empty(len(face_cells) + np.count_nonzero(face_cells[:, 1] >= 0), np.int64)

    def put(start: int, stop: int, places: Int, only_count: bool) -> None:
        cell_faces(face_cells[start:stop], start, places, faces[:0] if only_count else faces)

    return counting_sort(put, len(face_cells), n_cells, shares=1), faces


def loops_of_cells(points: Float, face_pairs: Int, face_cells: Int, n_cells: int) -> Loops:
    """Return all cell boundary loops of a 2-D mesh, given by its arrays."""
    from agglo_core.mesh.kernels.faces import chain_loops

    # The vertices replace the faces in the same array: the kernel reads the faces of a cell first.
    offsets, vertices = _faces_of_cells(face_cells, n_cells)
    faces = frozen_int(vertices)

    def chain_range(start: int, stop: int) -> tuple[Int, Int, Int]:
        ranges, workspace = offsets[start : stop + 1], vertices[offsets[start] : offsets[stop]]
        cells, loops = chain_loops(points, ranges, faces, face_pairs, face_cells, start, workspace)
        return cells, loops, workspace[: loops[-1]]

    results = over_ranges(chain_range, len(offsets) - 1, shares=1, work=len(faces))
    cells, loops, loop_vertices = zip(*results, strict=True)
    if sum(map(len, loop_vertices)) < len(vertices):  # some face has one cell on both sides
        vertices = np.concatenate(loop_vertices)
    return Loops(_join_offsets(cells), _join_offsets(loops), frozen_int(vertices))


def _join_offsets(offsets: Sequence[Int]) -> Int:
    """Concatenate CSR offsets of consecutive arrays into offsets of the joined array."""
    before = np.cumsum([0, *(part[-1] for part in offsets)])
    later = [part[1:] + start for part, start in zip(offsets[1:], before[1:], strict=False)]
    return frozen_int(np.concatenate((offsets[0], *later)) if later else offsets[0])
