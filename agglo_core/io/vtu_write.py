"""Writing VTU: the mesh with the labels of its levels, and beside it each coarse mesh."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.io.atomic import staging
from agglo_core.io.level_values import (
    LevelValues,
    about_agglomerates,
    check_level_values,
    under_free_names,
)
from agglo_core.io.plain_cells import used_points
from agglo_core.io.tags import BRIDGES, cell_data, check_names, is_level
from agglo_core.io.vtu_arrays import DERIVED
from agglo_core.io.vtu_cells import POLYHEDRON, Cells, cells_of
from agglo_core.io.vtu_document import HEADS, Piece, write_document
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
from agglo_core.progress import Tell, part, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

__all__ = ["write_vtu"]

_log = logging.getLogger("agglo")


def write_vtu(
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    level_values: LevelValues | None = None,
    tell: Tell = to_nobody,
    *,
    compress: bool = False,
) -> None:
    """Write ``path``, and with a hierarchy each coarse mesh beside it as ``NAME_level0.vtu``, ….

    The fine mesh carries its cell tags and the labels of every level (``level_0``, …), a coarse mesh its
    tags and what is known of each agglomerate: ``agglomerate``, ``parent``, ``cells``, ``measure``,
    ``diameter`` and the ``level_values``. These are marked as derived, so that reading does not take
    them for tags; one whose name a tag has is written with ``agglo_`` before it.

    A cell of several boundary loops (a hole) is one polygon that traverses a bridge between them both ways;
    then integer cell data ``agglo_loops`` say how many loops each cell has. VTK reads such polygons but
    its triangulation does not fill them: colour the fine mesh by ``level_i`` to see a level whole.

    With a hierarchy of k levels, tags ``level_<number>`` of an earlier one are not written, and files
    ``NAME_level<number>.vtu`` with a number of k or more are removed from the folder if they begin as
    this writer's files do.

    Parameters
    ----------
    path : Path
    mesh : Mesh
    hierarchy : Hierarchy or None
    level_values : sequence of mappings of name to (k,) float, optional
        What was measured on the k agglomerates of each level, finest first; NaN and infinities are kept.
    tell : callable
    compress : bool
        Store zlib of the arrays instead of the arrays.

    Raises
    ------
    MeshError
        For a cell tag of the name ``agglo_loops``, or a name that XML cannot hold.
    OptionError
        If the values do not fit the levels.
    """
    levels = list(hierarchy.levels) if hierarchy is not None else []
    values = check_level_values(hierarchy, [{}] * len(levels) if level_values is None else level_values)
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    taken = {BRIDGES, *(name for name in mesh.cell_tags if not is_level(name))}
    with staging(path) as folder:
        own = part(tell, 0, 1 + len(levels))
        write_document(folder / path.name, _piece(mesh, tags, {}), compress=compress, tell=own)
        for i, labels in enumerate(levels):
            own = part(tell, 1 + i, 1 + len(levels), f"level {i}")
            piece = _coarse_piece(mesh.coarsen(labels), levels, i, values[i], taken)
            write_document(folder / f"{path.stem}_level{i}{path.suffix}", piece, compress=compress, tell=own)
            del piece  # or it would be there while the next one is made
    if levels:
        _remove_stale(path, len(levels))


def _remove_stale(path: Path, count: int) -> None:
    """Remove the coarse meshes of an earlier, deeper hierarchy, which would pass for levels of this one."""
    pattern = re.compile(re.escape(f"{path.stem}_level") + r"(0|[1-9]\d*)" + re.escape(path.suffix), re.ASCII)
    for file in sorted(path.parent.iterdir()):
        found = pattern.fullmatch(file.name)
        if found is None or int(found[1]) < count or file.is_symlink() or not file.is_file():
            continue
        try:
            with open(file, "rb") as stream:
                ours = stream.read(max(map(len, HEADS))).startswith(HEADS)
            if ours:
                file.unlink()
                _log.info("removed %s, a level of an earlier hierarchy", file)
        except OSError as error:  # the mesh and its levels are written: this is not a reason to fail
            _log.warning("cannot remove %s, a level of an earlier hierarchy: %s", file, error.strerror)


def _piece(mesh: Mesh, tags: Mapping[str, Int], derived: Mapping[str, NDArray[Any]]) -> Piece:
    cells, data = cells_of(mesh), dict(tags)
    if (cells.loops > 1).any():
        data[BRIDGES] = cells.loops
    points, number = used_points(mesh)
    return Piece(points, _cell_arrays(cells, number), {}, data, derived, DERIVED)


def _coarse_piece(
    coarse: Mesh, levels: Sequence[Int], level: int, values: Mapping[str, Float], taken: Collection[str]
) -> Piece:
    kept = {key: each for key, each in coarse.cell_tags.items() if not is_level(key)}
    return _piece(coarse, kept, under_free_names(about_agglomerates(levels, level, coarse, values), taken))


def _cell_arrays(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
    faces = _face_stream(cells, number) if (cells.types == POLYHEDRON).any() else {}
    corners = {"connectivity": _numbered(cells.vertices, number), "offsets": cells.offsets[1:]}
    return {**corners, "types": cells.types, **faces}


def _numbered(vertices: Int, number: Int | None) -> Int:
    return vertices if number is None else frozen_int(number[vertices])


def _face_stream(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
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
    stream[starts[:-1]], stream[loops], stream[rest] = counts, sizes, _numbered(vertices, number)
    ends = np.full(len(cells.types), -1)
    ends[own] = starts[1:]
    return {"faces": stream, "faceoffsets": ends}
