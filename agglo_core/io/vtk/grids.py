"""Convert meshes to the arrays of a VTK file, and write a mesh and its coarse meshes to separate files."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.io.atomic import staging
from agglo_core.io.levels import (
    LevelValues,
    check_level_values,
    coarse_cell_data,
    under_free_names,
)
from agglo_core.io.tags import BRIDGES, cell_data, check_names, is_level, note_varying_tags
from agglo_core.io.to_mesh.listed_faces import face_fields
from agglo_core.io.to_mesh.plain_cells import used_points
from agglo_core.io.vtk.cells import POLYHEDRON, Cells, cells_of, select_cells
from agglo_core.io.vtk.xml_read import DERIVED
from agglo_core.io.vtk.xml_write import Piece
from agglo_core.mesh import Mesh
from agglo_core.progress import Notify, part

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

FaceArrays = Callable[[Cells, Int | None], dict[str, NDArray[Any]]]
"""Function of cells and file point numbers that returns named arrays with the faces of polyhedra."""


class Share(NamedTuple):
    """Cells of a mesh that go into one of the files of a larger distributed mesh.

    Attributes
    ----------
    cells : (n_own,) int
        Cell numbers in the given mesh, in its order.
    cell_ids : (n_own,) int
        Cell numbers in the larger mesh.
    point_ids : (n_points,) int
        Point numbers in the larger mesh.
    usual : mapping of str to int
        Value on all unlisted faces, by face tag.
    """

    cells: Int
    cell_ids: Int
    point_ids: Int
    usual: Mapping[str, int]


def piece_of(
    mesh: Mesh,
    faces_of: FaceArrays,
    tags: Mapping[str, Int],
    derived: Mapping[str, NDArray[Any]],
    share: Share | None = None,
) -> Piece:
    """Return VTK file contents with all cells of a mesh, or with the cells of ``share``."""
    cells = cells_of(mesh) if share is None else select_cells(cells_of(mesh), share.cells)
    data = dict(tags)
    if (cells.loops > 1).any():
        data[BRIDGES] = cells.loops
    if share is None:
        points, number = used_points(mesh)
        ids: tuple[Int | None, Int | None] = (None, None)
        fields = face_fields(mesh, number)
    else:
        point_ids, number = _points_of(cells, mesh.n_points)
        points, ids = (
            frozen_float(mesh.points[point_ids]),
            (frozen_int(share.point_ids[point_ids]), share.cell_ids),
        )
        fields = face_fields(mesh, number, share.cells, share.usual)
    faces = faces_of(cells, number) if (cells.types == POLYHEDRON).any() else {}
    corners = {"connectivity": renumber_vertices(cells.vertices, number), "offsets": cells.offsets[1:]}
    arrays: dict[str, NDArray[Any]] = {**corners, "types": cells.types, **faces}
    piece = Piece(points, arrays, {}, data, derived, DERIVED, fields)
    return piece._replace(point_ids=ids[0], cell_ids=ids[1])


def _points_of(cells: Cells, n_points: int) -> tuple[Int, Int]:
    """Return the mesh points that the cells use, and the new number of each mesh point."""
    is_used = np.zeros(n_points, bool)
    is_used[cells.vertices] = is_used[cells.solids.vertices] = True
    return frozen_int(np.flatnonzero(is_used)), frozen_int(np.cumsum(is_used) - 1)


def renumber_vertices(vertices: Int, number: Int | None) -> Int:
    """Convert mesh point numbers to file point numbers."""
    return vertices if number is None else frozen_int(number[vertices])


_log = logging.getLogger("agglo")


class WritePiece(Protocol):
    """Type of functions that write the contents of a VTK file."""

    def __call__(self, path: Path, piece: Piece, *, compress: bool, notify: Notify) -> None:
        """Write the contents to a file."""


class Storage(NamedTuple):
    """Functions that one VTK format provides: write a file, arrange polyhedra, recognise own files.

    Attributes
    ----------
    write : callable
    faces : callable
        Function of cells and file point numbers that returns named arrays with the faces of polyhedra.
    ours : callable
        Function that returns True for files written by agglo in this format; may raise OSError.
    """

    write: WritePiece
    faces: FaceArrays
    ours: Callable[[Path], bool]


def write_grids(
    storage: Storage,
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    level_values: LevelValues | None,
    notify: Notify,
    *,
    compress: bool,
) -> None:
    """Write a mesh to ``path``, and each coarse mesh of a hierarchy to ``NAME_level0.SUFFIX``, ….

    The fine mesh has its cell tags and the labels of every level (``level_0``, …). A coarse mesh has its tags
    and data on each agglomerate: ``agglomerate``, ``parent``, ``cells``, ``measure``, ``diameter`` and the
    ``level_values``. These data are marked as derived, so that they do not become tags on reading; a name
    already used by a tag gets the prefix ``agglo_``. Field data hold face tags.

    A cell with several boundary loops (a hole) is one polygon with a bridge traversed in both directions.
    Integer cell data ``agglo_loops`` then hold the loop count per cell. VTK reads such polygons, but its
    triangulation does not fill them: colour the fine mesh by ``level_i`` to see the whole level.

    With a hierarchy of k levels, old tags ``level_<number>`` are not written, and files
    ``NAME_level<number>.SUFFIX`` with a number of at least k are removed from the folder if agglo wrote them.

    Parameters
    ----------
    storage : Storage
    path : Path
    mesh : Mesh
    hierarchy : Hierarchy or None
    level_values : sequence of mappings of name to (k,) float, or None
        Values on the k agglomerates of each level, finest first; NaN and infinities are kept.
    notify : callable
    compress : bool
        Store compressed arrays.

    Raises
    ------
    MeshError
        For a cell tag named ``agglo_loops``, or a name that XML cannot hold.
    OptionError
        If the values do not fit the levels.
    """
    levels = list(hierarchy.levels) if hierarchy is not None else []
    values = check_level_values(hierarchy, [{}] * len(levels) if level_values is None else level_values)
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    check_names(mesh.face_tags, "face")
    reserved_names = {BRIDGES, *(name for name in mesh.cell_tags if not is_level(name))}
    with staging(path) as folder:
        for i, labels in enumerate(levels):  # before the fine mesh, whose derived arrays stay in memory
            notify_piece = part(notify, i, 1 + len(levels), f"level {i}")
            coarse = mesh.coarsen(labels)
            note_varying_tags(mesh, coarse, i)
            piece = _coarse_piece(storage, coarse, levels, i, values[i], reserved_names)
            storage.write(
                folder / f"{path.stem}_level{i}{path.suffix}", piece, compress=compress, notify=notify_piece
            )
            del piece, coarse  # free it before the next piece is created
        notify_piece = part(notify, len(levels), 1 + len(levels))
        piece = piece_of(mesh, storage.faces, tags, {})
        storage.write(folder / path.name, piece, compress=compress, notify=notify_piece)
    if levels:
        _remove_stale(storage, path, len(levels))


def _remove_stale(storage: Storage, path: Path, count: int) -> None:
    """Remove coarse mesh files left by an earlier hierarchy with more levels."""
    pattern = re.compile(re.escape(f"{path.stem}_level") + r"(0|[1-9]\d*)" + re.escape(path.suffix), re.ASCII)
    for file in sorted(path.parent.iterdir()):
        match = pattern.fullmatch(file.name)
        if match is None or int(match[1]) < count or file.is_symlink() or not file.is_file():
            continue
        try:
            if storage.ours(file):
                file.unlink()
                _log.info("removed %s, a level of an earlier hierarchy", file)
        except OSError as error:  # the mesh and its levels are written, so this is no failure
            _log.warning("cannot remove %s, a level of an earlier hierarchy: %s", file, error.strerror)


def _coarse_piece(
    storage: Storage,
    coarse: Mesh,
    levels: Sequence[Int],
    level: int,
    values: Mapping[str, Float],
    reserved_names: Collection[str],
) -> Piece:
    tags = {key: array for key, array in coarse.cell_tags.items() if not is_level(key)}
    data = coarse_cell_data(levels, level, coarse, values)
    return piece_of(coarse, storage.faces, tags, under_free_names(data, reserved_names))
