"""Faces that a file lists by their points: which faces of the mesh they are, and the tags that they carry."""

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
    """Faces that differ from most in some tag, as files of agglo's own list them beside the mesh."""

    cells: Int  # (k,) the smaller number of the cells beside
    offsets: Int  # (k + 1,)
    vertices: Int  # numbers of the points in the file
    tags: Mapping[str, Int]  # name -> (k + 1,) the value of all other faces, then that of each


def face_fields(
    mesh: Mesh,
    number: Int | None,
    cells: Int | None = None,
    usual: Mapping[str, int] | None = None,
) -> dict[str, Int]:
    """Arrays that hold the face tags of a mesh; none if it has no tags.

    Parameters
    ----------
    mesh : Mesh
    number : (n_points,) int or None
        The number of each point in the file, where it differs.
    cells : (k,) int, optional
        The cells that the file holds, in its order, if not all; faces beside none of them are not listed.
    usual : mapping of str to int, optional
        The value of all faces that are not listed, by tag; by default the most common one.
    """
    if not mesh.face_tags:
        return {}
    usual = usual_values(mesh) if usual is None else usual
    beside = _smaller_cell(mesh) if cells is None else _smaller_among(mesh, cells)
    chosen = np.zeros(mesh.n_faces, bool)
    for name, values in mesh.face_tags.items():
        chosen |= values != usual[name]
    faces = frozen_int(np.flatnonzero(chosen & (beside >= 0)))
    offsets, places = gather(mesh.face_offsets, faces)
    vertices = mesh.face_vertices[places]
    found = {
        _CELLS: frozen_int(beside[faces]),
        _OFFSETS: offsets,
        _POINTS: vertices if number is None else frozen_int(number[vertices]),
    }
    for name, values in mesh.face_tags.items():
        found[f"{_TAG}{name}"] = frozen_int(np.concatenate(([usual[name]], values[faces])))
    return found


def usual_values(mesh: Mesh) -> dict[str, int]:
    """The most common value of each face tag."""
    return {name: int(_most_common(values)) for name, values in mesh.face_tags.items()}


def _most_common(values: Int) -> Any:
    known, counts = np.unique(values, return_counts=True)
    return known[np.argmax(counts)] if len(known) else 0


def _smaller_cell(mesh: Mesh) -> Int:
    owner, neighbour = mesh.face_cells.T
    return frozen_int(np.where(neighbour >= 0, np.minimum(owner, neighbour), owner))


def _smaller_among(mesh: Mesh, cells: Int) -> Int:
    """The smaller place among ``cells`` of the two cells beside each face, −1 where neither is one."""
    place = np.full(mesh.n_cells + 1, len(cells))  # the last one is what lies outside
    place[cells] = np.arange(len(cells))
    smaller = place[mesh.face_cells].min(axis=1)
    return frozen_int(np.where(smaller < len(cells), smaller, -1))


def listed_faces(fields: Mapping[str, NDArray[Any]], n_points: int, n_cells: int) -> ListedFaces | None:
    """Read the arrays of :func:`face_fields`; None if there are none.

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
        raise FileError(f"array {_OFFSETS!r} must rise from 0 to {len(vertices)} in {len(cells)} steps")
    if (np.diff(offsets) < 2).any():
        raise FileError(f"array {_OFFSETS!r} has a face of fewer than two points")
    for name, values, most in ((_CELLS, cells, n_cells), (_POINTS, vertices, n_points)):
        if values.min(initial=0) < 0 or values.max(initial=-1) >= most:
            raise FileError(f"array {name!r} holds numbers outside 0..{most - 1}")
    for name, values in tags.items():
        if len(values) != len(cells) + 1:
            raise FileError(f"face tag {name!r} has {len(values)} values, expected {len(cells) + 1}")
    return ListedFaces(cells, offsets, vertices, tags)


def joined_faces(listed: Sequence[ListedFaces | None], cells: Int, points: Int) -> ListedFaces | None:
    """The faces that pieces list, whose cells and points begin with those numbers; None unless all agree.

    They do if they list faces by the same tags, with the same value for all others.
    """
    given = [each for each in listed if each is not None]
    alike = [{name: int(values[0]) for name, values in each.tags.items()} for each in given]
    if len(given) < len(listed) or any(each != alike[0] for each in alike):
        return None
    sizes = np.concatenate([np.diff(each.offsets) for each in given])
    return ListedFaces(
        frozen_int(np.concatenate([each.cells + start for each, start in zip(given, cells, strict=True)])),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(
            np.concatenate([each.vertices + start for each, start in zip(given, points, strict=True)])
        ),
        {
            name: frozen_int(np.concatenate(([usual], *(each.tags[name][1:] for each in given))))
            for name, usual in alike[0].items()
        },
    )


def tags_of_faces(mesh: Mesh, points: Float, listed: ListedFaces) -> dict[str, Int]:
    """Tags of a mesh ``(n_faces,)`` by faces that are listed by the given points ``(n, d)`` of the file."""
    face = faces_with(mesh, points, listed.offsets, listed.vertices, listed.cells)
    kept = np.flatnonzero(face >= 0)
    tags = {}
    for name, values in listed.tags.items():
        tag = np.full(mesh.n_faces, values[0])
        tag[face[kept]] = values[1:][kept]
        tags[name] = frozen_int(tag)
    return tags


def faces_with(mesh: Mesh, points: Float, offsets: Int, vertices: Int, cells: Int | None = None) -> Int:
    """The face with the same points as each of k loops ``(k,)``, −1 where there is none.

    Points are compared by their coordinates, because building a mesh renumbers them, and those that follow
    themselves count once: triangles that are stored as quadrilaterals. With ``cells`` a face
    must also lie beside that cell, and beside none of a smaller number.
    """
    given = points[:, : mesh.dim]
    point = _row_numbers(np.concatenate((mesh.points, given)) + 0.0)
    face_offsets, own = simple_loops(mesh.face_offsets, point[mesh.face_vertices])
    offsets, theirs = simple_loops(offsets, point[mesh.n_points :][vertices])
    sizes, face_sizes = np.diff(offsets), np.diff(face_offsets)
    beside = np.zeros(mesh.n_faces, np.int64) if cells is None else _smaller_cell(mesh)
    cells = frozen_int(np.zeros(len(sizes))) if cells is None else cells
    face = np.full(len(sizes), -1)
    for size in np.intersect1d(sizes[sizes >= mesh.dim], face_sizes):
        loops, faces = np.flatnonzero(sizes == size), np.flatnonzero(face_sizes == size)
        rows = (
            _keys(beside, face_offsets, own, frozen_int(faces), int(size)),
            _keys(cells, offsets, theirs, frozen_int(loops), int(size)),
        )
        number = _row_numbers(np.concatenate(rows))
        owner = np.full(number.max(initial=-1) + 1, -1)
        owner[number[: len(faces)]] = faces
        face[loops] = owner[number[len(faces) :]]
    return frozen_int(face)


def _keys(cells: Int, offsets: Int, vertices: Int, which: Int, size: int) -> Int:
    """Of loops of one size the cell and the sorted points ``(k, 1 + size)``."""
    points = np.sort(vertices[gather(offsets, which)[1]].reshape(-1, size), axis=1)
    return frozen_int(np.column_stack((cells[which], points)))


def _row_numbers(rows: Float | Int) -> Int:
    """A number for each distinct row."""
    order = np.lexsort(rows.T)
    new = np.concatenate(([True], (np.diff(rows[order], axis=0) != 0).any(axis=1)))[: len(rows)]
    number = np.empty(len(rows), np.int64)
    number[order] = np.cumsum(new) - 1
    return frozen_int(number)
