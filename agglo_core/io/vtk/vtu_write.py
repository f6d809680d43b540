"""Writing VTU: VTK's grids as XML with the bytes of all arrays after it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.io.level_values import LevelValues
from agglo_core.io.vtk.cells import POLYHEDRON, Cells
from agglo_core.io.vtk.document import HEADS, SOLUTION, write_document
from agglo_core.io.vtk.grid_pieces import numbered
from agglo_core.io.vtk.grids import Storage, write_grids
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
from agglo_core.progress import Tell, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


def write_vtu(
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    level_values: LevelValues | None = None,
    tell: Tell = to_nobody,
    *,
    compress: bool = False,
) -> None:
    """Write ``path``, and with a hierarchy each coarse mesh beside it: see :func:`write_grids`."""
    storage = Storage(write_document, face_stream, written_by_agglo)
    write_grids(storage, path, mesh, hierarchy, level_values, tell, compress=compress)


def written_by_agglo(file: Path, *, solutions: bool = False) -> bool:
    """Whether a file begins as our meshes do, or also as our solutions; may raise OSError."""
    heads = (*HEADS, SOLUTION) if solutions else HEADS
    with open(file, "rb") as stream:
        return stream.read(max(map(len, heads))).startswith(heads)


def face_stream(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
    """Per polyhedron: number of faces, then each face's size and vertices, seen from outside the cell.

    Other cells end nowhere in the stream, which is -1.
    """
    own = np.flatnonzero(cells.types == POLYHEDRON)
    offsets, loop_offsets, vertices = take_cells(cells.solids, frozen_int(own))
    counts, sizes = np.diff(offsets), np.diff(loop_offsets)
    starts = loop_offsets[offsets] + offsets + np.arange(len(offsets))  # of each cell, and the end
    loops = loop_offsets[:-1] + np.arange(len(sizes)) + np.repeat(np.arange(1, len(counts) + 1), counts)
    stream = np.empty(starts[-1], np.int64)
    rest = np.ones(len(stream), bool)
    rest[starts[:-1]] = rest[loops] = False
    stream[starts[:-1]], stream[loops], stream[rest] = counts, sizes, numbered(vertices, number)
    ends = np.full(len(cells.types), -1)
    ends[own] = starts[1:]
    return {"faces": stream, "faceoffsets": ends}
