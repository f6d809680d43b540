"""Identify mesh faces that a file gives by their points, and transfer their tags to the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.mesh import Mesh
from agglo_core.mesh.construction.repeated_vertices import simple_loops
from agglo_core.mesh.elements import gather

_CELLS, _OFFSETS, _POINTS = "agglo_face_cells", "agglo_face_offsets", "agglo_face_points"
_TAG = "agglo_face_tag "


class ListedFaces(NamedTuple):
    """Faces given by their points, in files of agglo: those with an uncommon value of some tag."""

    cells: Int  # (k,) smaller number of the adjacent cells
    offsets: Int  # (k + 1,)
    vertices: Int  # point numbers in the file
    tags: Mapping[str, Int]  # name -> (k + 1,) value of all other faces, then the value of each listed face


def face_fields(
    mesh: Mesh,
    number: Int | None,
    cells: Int | None = None,
    usual: Mapping[str, int] | None = None,
) -> dict[str, Int]:
    """Return the arrays in which agglo's files store the face tags of a mesh, by name.

    The mapping is empty without tags.

    Parameters
    ----------
    mesh : Mesh
    number : (n_points,) int or None
        Point numbers in the file, if they differ.
    cells : (k,) int, optional
        Cells in the file, in its order, if not all; faces without such a cell are not listed.
    usual : mapping of str to int, optional
        Value on all unlisted faces, by tag; by default the most common value.
    """
    if not mesh.face_tags:
        return {}
    usual = usual_values(mesh) if usual is None else usual
    adjacent_cell = _smaller_cell(mesh) if cells is None else _smaller_among(mesh, cells)
    # List the faces with an uncommon value in some tag.
    is_listed = np.zeros(mesh.n_faces, bool)
    for name, values in mesh.face_tags.items():
        is_listed |= values != usual[name]
    faces = frozen_int(np.flatnonzero(is_listed & (adjacent_cell >= 0)))
    offsets, places = gather(mesh.face_offsets, faces)
    vertices = mesh.face_vertices[places]
    fields = {
        _CELLS: frozen_int(adjacent_cell[faces]),
        _OFFSETS: offsets,
        _POINTS: vertices if number is None else frozen_int(number[vertices]),
    }
    for name, values in mesh.face_tags.items():
        fields[f"{_TAG}{name}"] = frozen_int(np.concatenate(([usual[name]], values[faces])))
    return fields


def usual_values(mesh: Mesh) -> dict[str, int]:
    """Return the most common value of each face tag."""
    return {name: int(_most_common(values)) for name, values in mesh.face_tags.items()}


def _most_common(values: Int) -> Any:
    unique_values, counts = np.unique(values, return_counts=True)
    return unique_values[np.argmax(counts)] if len(unique_values) else 0


def _smaller_cell(mesh: Mesh) -> Int:
    owner, neighbour = mesh.face_cells.T
    return frozen_int(np.where(neighbour >= 0, np.minimum(owner, neighbour), owner))


def _smaller_among(mesh: Mesh, cells: Int) -> Int:
    """Return the smaller index in ``cells`` of the two cells at each face, −1 if neither is in it."""
    place = np.full(mesh.n_cells + 1, len(cells))  # the last entry stands for the outside
    place[cells] = np.arange(len(cells))
    smaller = place[mesh.face_cells].min(axis=1)
    return frozen_int(np.where(smaller < len(cells), smaller, -1))


def parse_listed_faces(fields: Mapping[str, NDArray[Any]], n_points: int, n_cells: int) -> ListedFaces | None:
    """Check the arrays of :func:`face_fields`, read from a file, and convert them to tagged faces.

    Return None if there are none.

    Raises
    ------
    FileError
        If the arrays do not fit one another.
    """
    if not {_CELLS, _OFFSETS, _POINTS} <= fields.keys():
        return None
    cells, offsets, vertices = (frozen_int(fields[name]) for name in (_CELLS, _OFFSETS, _POINTS))
    tags = {
        name.removeprefix(_TAG): frozen_int(values)
        for name, values in fields.items()
        if name.startswith(_TAG)
    }
    if len(offsets) != len(cells) + 1 or offsets[0] != 0 or offsets[-1] != len(vertices):
        raise FileError(f"array {_OFFSETS!r} must increase from 0 to {len(vertices)} in {len(cells)} steps")
    if (np.diff(offsets) < 2).any():
        raise FileError(f"array {_OFFSETS!r} has a face with fewer than two points")
    for name, values, most in ((_CELLS, cells, n_cells), (_POINTS, vertices, n_points)):
        if values.min(initial=0) < 0 or values.max(initial=-1) >= most:
            raise FileError(f"array {name!r} holds numbers outside 0..{most - 1}")
    for name, values in tags.items():
        if len(values) != len(cells) + 1:
            raise FileError(f"face tag {name!r} has {len(values)} values, expected {len(cells) + 1}")
    return ListedFaces(cells, offsets, vertices, tags)


def join_listed_faces(listed: Sequence[ListedFaces | None], cells: Int, points: Int) -> ListedFaces | None:
    """Concatenate the tagged faces of several files, given the first cell and point number of each.

    Return None if the pieces disagree.

    They agree if their tags have the same names, and the same value on all other faces.
    """
    pieces = [entry for entry in listed if entry is not None]
    alike = [{name: int(values[0]) for name, values in entry.tags.items()} for entry in pieces]
    if len(pieces) < len(listed) or any(entry != alike[0] for entry in alike):
        return None
    sizes = np.concatenate([np.diff(entry.offsets) for entry in pieces])
    return ListedFaces(
        frozen_int(np.concatenate([entry.cells + start for entry, start in zip(pieces, cells, strict=True)])),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(
            np.concatenate([entry.vertices + start for entry, start in zip(pieces, points, strict=True)])
        ),
        {
            name: frozen_int(np.concatenate(([usual], *(entry.tags[name][1:] for entry in pieces))))
            for name, usual in alike[0].items()
        },
    )


def tags_of_faces(mesh: Mesh, points: Float, listed: ListedFaces) -> dict[str, Int]:
    """Return the face tags ``(n_faces,)`` of a mesh from tagged faces given by their points."""
    face = faces_with(mesh, points, listed.offsets, listed.vertices, listed.cells)
    matches = np.flatnonzero(face >= 0)
    tags = {}
    for name, values in listed.tags.items():
        tag = np.full(mesh.n_faces, values[0])
        tag[face[matches]] = values[1:][matches]
        tags[name] = frozen_int(tag)
    return tags


def faces_with(mesh: Mesh, points: Float, offsets: Int, vertices: Int, cells: Int | None = None) -> Int:
    """Return for each of k vertex loops the mesh face with the same points ``(k,)``, or −1.

    Points are compared by coordinates, because the construction of a mesh renumbers them. Repeated
    consecutive points count once (triangles stored as quadrilaterals). With ``cells``, the smaller number of
    the cells at the face must also agree.
    """
    # Number the points of mesh and file by coordinates.
    file_points = points[:, : mesh.dim]
    point = _row_numbers(np.concatenate((mesh.points, file_points)) + 0.0)
    face_offsets, face_vertices = simple_loops(mesh.face_offsets, point[mesh.face_vertices])
    offsets, loop_vertices = simple_loops(offsets, point[mesh.n_points :][vertices])
    sizes, face_sizes = np.diff(offsets), np.diff(face_offsets)
    adjacent_cell = np.zeros(mesh.n_faces, np.int64) if cells is None else _smaller_cell(mesh)
    cells = frozen_int(np.zeros(len(sizes))) if cells is None else cells
    face = np.full(len(sizes), -1)
    # Compare the faces of equal size by their sorted points.
    for size in np.intersect1d(sizes[sizes >= mesh.dim], face_sizes):
        loops, faces = np.flatnonzero(sizes == size), np.flatnonzero(face_sizes == size)
        rows = (
            _keys(adjacent_cell, face_offsets, face_vertices, frozen_int(faces), int(size)),
            _keys(cells, offsets, loop_vertices, frozen_int(loops), int(size)),
        )
        number = _row_numbers(np.concatenate(rows))
        owner = np.full(number.max(initial=-1) + 1, -1)
        owner[number[: len(faces)]] = faces
        face[loops] = owner[number[len(faces) :]]
    return frozen_int(face)


def _keys(cells: Int, offsets: Int, vertices: Int, loops: Int, size: int) -> Int:
    """Return adjacent cell and sorted vertices ``(k, 1 + size)`` of loops with ``size`` vertices each."""
    points = np.sort(vertices[gather(offsets, loops)[1]].reshape(-1, size), axis=1)
    return frozen_int(np.column_stack((cells[loops], points)))


def _row_numbers(rows: Float | Int) -> Int:
    """Return a number for each row ``(n,)``, equal for equal rows."""
    order = np.lexsort(rows.T)
    new = np.concatenate(([True], (np.diff(rows[order], axis=0) != 0).any(axis=1)))[: len(rows)]
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(new) - 1
    return frozen_int(number)
