"""Convert meshes to plain lists of polygons or polyhedra, and write coarse meshes to separate files."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.tags import cell_data, check_names, is_level, note_face_tags, note_varying_tags
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_log = logging.getLogger("agglo")
_CHUNK = 8192  # cells per chunk: temporary arrays stay in cache and need little memory


class Loops(NamedTuple):
    """2-D cells: cell c has the points ``vertices[offsets[c]:offsets[c + 1]]``, counter-clockwise."""

    points: Float
    offsets: Int
    vertices: Int


def loops_of(mesh: Mesh, suffix: str) -> Loops:
    """Return the cells of a 2-D mesh as polygons, without points that no cell uses.

    Raises
    ------
    FileError
        For a 3-D mesh, or a cell with a hole or a self-touching boundary.
    """
    if mesh.dim != 2:
        raise FileError(f"{suffix} needs a 2-D mesh, given a {mesh.dim}-D one; write .vtu or .npz instead")
    loops = mesh.boundary_loops
    several = np.flatnonzero(np.diff(loops.cell_offsets) > 1)
    if len(several):
        raise FileError(
            f"cell {several[0]} has several boundary loops (a hole); only .vtu and .npz can hold it"
        )
    points, number = used_points(mesh)
    vertices = loops.vertices if number is None else frozen_int(number[loops.vertices])
    return Loops(points, loops.loop_offsets, vertices)


def solids_of(mesh: Mesh, suffix: str) -> tuple[Float, Polyhedra]:
    """Return the cells of a 3-D mesh as polyhedra, without points that no cell uses.

    Raises
    ------
    FileError
        For a 2-D mesh.
    """
    if mesh.dim != 3:
        raise FileError(f"{suffix} needs a 3-D mesh, given a {mesh.dim}-D one; write .vtu or .npz instead")
    solids = half_faces(mesh)
    points, number = used_points(mesh)
    if number is None:
        return points, solids
    return points, solids._replace(vertices=frozen_int(number[solids.vertices]))


def used_points(mesh: Mesh) -> tuple[Float, Int | None]:
    """Return the points that belong to faces, and the new number of each point (None if unchanged).

    Coarse meshes keep points without faces, which are dropped here.
    """
    has_face = np.zeros(mesh.n_points, bool)
    has_face[mesh.face_vertices] = True
    if has_face.all():
        return mesh.points, None
    return frozen_float(mesh.points[has_face]), frozen_int(np.cumsum(has_face) - 1)


def half_faces(mesh: Mesh) -> Polyhedra:
    """Return the faces of each cell, counter-clockwise from outside, in the order of ``cell_faces``."""
    offsets, faces = mesh.cell_faces
    loop_offsets = np.concatenate(([0], np.cumsum(np.diff(mesh.face_offsets)[faces])))
    vertices = np.empty(loop_offsets[-1], np.int64)
    for start in range(0, mesh.n_cells, _CHUNK):
        stop = min(start + _CHUNK, mesh.n_cells)
        cells = np.repeat(np.arange(start, stop), np.diff(offsets[start : stop + 1]))
        first, last = loop_offsets[offsets[[start, stop]]]
        vertices[first:last] = _orient_outwards(mesh, cells, faces[offsets[start] : offsets[stop]])
    return Polyhedra(offsets, frozen_int(loop_offsets), frozen_int(vertices))


def _orient_outwards(mesh: Mesh, cells: Int, faces: Int) -> Int:
    """Return the vertices of ``faces``, each counter-clockwise from outside the corresponding cell."""
    loop_offsets, places = gather(mesh.face_offsets, faces)
    sizes = np.diff(loop_offsets)
    ends = np.repeat(mesh.face_offsets[faces] + mesh.face_offsets[faces + 1] - 1, sizes)
    inward = np.repeat(mesh.face_cells[faces, 0] != cells, sizes)
    return frozen_int(mesh.face_vertices[np.where(inward, ends - places, places)])


def write_levels(
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    write: Callable[[Path, Mesh, Mapping[str, Int]], None],
    *,
    face_tags: Collection[str] = (),
) -> None:
    """Write a mesh with its tags and labels, and each coarse mesh to ``NAME_level0.SUFFIX``, ….

    A coarse mesh that the format cannot hold (agglomerates with holes) is skipped with a warning; the labels
    contain the same information.

    Parameters
    ----------
    path : Path
        Path in a staging folder, whose files are put in place together.
    mesh : Mesh
    hierarchy : Hierarchy or None
    write : callable
        Function that writes a mesh with tags, and raises FileError for unsupported data.
    face_tags : collection of str
        Names of the face tags that it writes; others cause a warning.
    """
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    write(path, mesh, tags)
    note_face_tags(mesh, path.suffix, face_tags)
    for level, labels in enumerate(hierarchy.levels if hierarchy is not None else ()):
        coarse = mesh.coarsen(labels)
        note_varying_tags(mesh, coarse, level)
        name = f"{path.stem}_level{level}{path.suffix}"
        try:
            coarse_tags = {key: values for key, values in coarse.cell_tags.items() if not is_level(key)}
            write(path.with_name(name), coarse, coarse_tags)
        except FileError as error:
            _log.warning("%s is not written: %s", name, error)
