"""Read meshes from the MATLAB variables of lymph, mVEM, PolyMesher and MRST."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, trusted_copy
from agglo_core.errors import FileError
from agglo_core.io.matlab.mat5 import Variable, variables
from agglo_core.io.matlab.mrst import mesh_of_grid
from agglo_core.io.matlab.write import NAMES
from agglo_core.io.tags import is_level, note_left_out
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import check_tags
from agglo_core.mesh.elements import Polyhedra, polyhedra_from_elements

_PAIRS = (("node3", "elem3"), ("node", "elem"), ("Node", "Element"), ("nodes", "elements"))
_MESH = {name for pair in _PAIRS for name in pair}
_REGION = {
    *("ne", "nedges", "BBox", "coord", "id", "coords_element", "connectivity"),
    *("area", "max_kb", "connectivity_bc", "bc_tag"),
}
"""Fields of lymph's struct ``region`` that describe the mesh."""
_NONE = (frozen_int([0]), frozen_int([]))


class _Cells(NamedTuple):
    points: Float
    plane: tuple[Int, Int]
    solid: Polyhedra | None
    tags: Mapping[str, Int]

    @property
    def number(self) -> int:
        """Cell count."""
        if self.solid is not None:
            return len(self.solid.cell_offsets) - 1
        return len(self.plane[0]) - 1


def read_matlab(path: Path, *, merge_points: bool, allow_gaps: bool, drop_flat: bool) -> Mesh:
    """Read the mesh in a MATLAB file.

    Variables and fields of ``region`` with an integer per cell become tags. Other numbers are left out,
    with a note.

    Raises
    ------
    FileError, MeshError
        For a broken file or mesh, or unknown variables.
    """
    contents = variables(path.read_bytes())
    region, lists = (
        contents.get("region"),
        any(pair[0] in contents and pair[1] in contents for pair in _PAIRS),
    )
    # MRST's grid lists faces, all other layouts list cells.
    if "G" in contents and contents["G"].is_struct and region is None and not lists:
        mesh = mesh_of_grid(contents["G"])
        tags, skipped_names = _tags(contents, mesh.n_cells)
        mesh = trusted_copy(mesh, cell_tags=check_tags("cell", tags, mesh.n_cells), name=path.stem)
        mesh = note_left_out(mesh, skipped_names)
        return mesh if allow_gaps else mesh.conforming(merge_points=merge_points)
    if region is not None:
        fields = region.fields()
        cells = _region(fields)
    else:
        fields, cells = {}, _lists(contents)
    tags, skipped_names = _tags(contents, cells.number, fields)
    given = cells.tags
    if NAMES in contents and "id" not in tags:  # written by agglo, with the id 1 for a mesh without ids
        given = {name: values for name, values in given.items() if (values != 1).any()}
    tags = {**given, **tags}
    if cells.solid is not None:
        mesh = Mesh.from_polyhedra(
            cells.points,
            cells.solid,
            cell_tags=tags,
            merge_points=merge_points,
            allow_gaps=allow_gaps,
            drop_flat=drop_flat,
            name=path.stem,
        )
        return note_left_out(mesh, skipped_names)
    mesh = Mesh.from_polygons(
        cells.points,
        cells.plane,
        cell_tags=tags,
        merge_points=merge_points,
        allow_gaps=True,
        drop_flat=drop_flat,
        name=path.stem,
    )
    # Gaps stay open until the boundary edges are tagged by their points.
    mesh = note_left_out(_add_boundary_tags(mesh, cells.points, fields), skipped_names)
    return mesh if allow_gaps else mesh.conforming(merge_points=merge_points)


def _region(fields: Mapping[str, Variable]) -> _Cells:
    """Read the cells in lymph's struct ``region``."""
    for name in ("coord", "connectivity"):
        if name not in fields:
            raise FileError(f"region has no field {name!r}; it has {', '.join(fields) or 'none'}")
    points = _points(fields["coord"])
    plane = _number_from_zero(fields["connectivity"].lists(), len(points), "region.connectivity")
    count = len(plane[0]) - 1
    ids = fields.get("id")
    if ids is None or not ids.is_numeric or 0 in ids.shape:
        return _Cells(points, plane, None, {})
    if np.prod(ids.shape) != count:
        raise FileError(f"region.id has {np.prod(ids.shape)} values, expected one for each of {count} cells")
    return _Cells(points, plane, None, {"id": ids.integers()})


def _lists(contents: Mapping[str, Variable]) -> _Cells:
    """Read points and cells from a pair of variables such as ``node`` and ``elem``."""
    names = next((pair for pair in _PAIRS if pair[0] in contents and pair[1] in contents), None)
    if names is None:
        expected = (
            "region (lymph), node and elem (mVEM), Node and Element (PolyMesher), node3 and elem3, G (MRST)"
        )
        raise FileError(
            f"holds the variables {', '.join(contents) or 'none'}; expected {expected}; in Python pass "
            "points and cells of other names from scipy.io.loadmat to Mesh.from_polygons"
        )
    points, cells = _points(contents[names[0]]), contents[names[1]]
    if points.shape[1] == 2:
        lists = cells.lists() if cells.is_cell else _rows(cells)
        return _Cells(points, _number_from_zero(lists, len(points), names[1]), None, {})
    if not cells.is_cell:
        return _Cells(points, _NONE, _elements(cells, len(points)), {})
    cell_offsets, loop_offsets, values = cells.nested_lists()
    _, vertices = _number_from_zero((loop_offsets, values), len(points), names[1])
    return _Cells(points, _NONE, Polyhedra(cell_offsets, loop_offsets, vertices), {})


def _points(variable: Variable) -> Float:
    points = variable.reals()
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise FileError(
            f"{variable.name} has the shape {points.shape}, expected 2 or 3 columns and one row per point"
        )
    return frozen_float(points)


def _rows(variable: Variable) -> tuple[Int, Int]:
    """Read the vertices of each cell from the rows of a matrix.

    Short rows end with NaN or zeros.
    """
    rows = variable.reals()
    if rows.ndim != 2:
        raise FileError(f"{variable.name} has the shape {rows.shape}, expected one row per cell")
    is_vertex = np.isfinite(rows) & (rows != 0)
    if (is_vertex[:, 1:] & ~is_vertex[:, :-1]).any():
        raise FileError(f"{variable.name}: a row has a number after a missing one")
    values = rows[is_vertex]
    whole = values == np.floor(values)
    if not whole.all() or np.abs(values).max(initial=0) > 2**53:
        raise FileError(f"{variable.name} holds {values[np.argmin(whole)]:g}, expected whole numbers")
    return frozen_int(np.concatenate(([0], np.cumsum(is_vertex.sum(axis=1))))), frozen_int(
        values.astype(np.int64)
    )


def _elements(variable: Variable, n_points: int) -> Polyhedra:
    """Read tetrahedra or hexahedra from the rows of a matrix."""
    kinds = {4: "tetra", 8: "hexahedron"}
    rows = _number_from_zero(_rows(variable), n_points, variable.name)[1]
    width = variable.shape[1]
    if width not in kinds or rows.size != np.prod(variable.shape):
        raise FileError(
            f"{variable.name} has rows of {width}, expected 4 (tetrahedra), 8 (hexahedra) or a cell array"
        )
    return polyhedra_from_elements({kinds[width]: rows.reshape(-1, width)})


def _number_from_zero(lists: tuple[Int, Int], n_points: int, name: str) -> tuple[Int, Int]:
    """Check the point numbers of a file, which start from 1, and shift them to start from 0."""
    offsets, values = lists
    if values.min(initial=1) < 1 or values.max(initial=1) > n_points:
        wrong = int(np.argmax((values < 1) | (values > n_points)))
        cell = int(np.searchsorted(offsets, wrong, side="right")) - 1
        raise FileError(
            f"{name}: list {cell} (counted from 0) uses point {values[wrong]}, expected 1 to {n_points}"
        )
    return offsets, frozen_int(values - 1)


def _tags(
    contents: Mapping[str, Variable], count: int, fields: Mapping[str, Variable] | None = None
) -> tuple[dict[str, Int], list[str]]:
    """Convert variables with one integer per cell to tags, and list other numbers that the mesh lacks.

    ``fields`` are those of ``region``. Level numbers start from 1 in MATLAB.
    """
    others = {name: array for name, array in (fields or {}).items() if name not in _REGION}
    listed: dict[str, Variable] = {}
    if NAMES in contents:
        for variable, name in _own_names(contents[NAMES]).items():
            if variable not in contents or contents[variable].shape[:1] != (count,):
                raise FileError(
                    f"{NAMES} lists the variable {variable!r}, which does not have one row per cell"
                )
            listed[name] = contents[variable]
    else:
        others |= {name: array for name, array in contents.items() if name not in _MESH}
    listed |= {name: array for name, array in others.items() if array.is_numeric and _is_list(array, count)}
    skipped_names = [
        array.name
        for name, array in others.items()
        if array.is_numeric and name not in listed and np.prod(array.shape, dtype=object) > 1
    ]
    tags = {}
    for name, array in listed.items():
        try:
            tags[name] = frozen_int(array.integers() - (1 if is_level(name) else 0))
        except FileError:  # real values are no tags
            skipped_names.append(array.name)
    return tags, skipped_names


def _is_list(variable: Variable, count: int) -> bool:
    """Return True for a row or column vector with one number per cell, if there are several cells."""
    return count > 1 and sorted(variable.shape) == [1] * (len(variable.shape) - 1) + [count]


def _own_names(variable: Variable) -> dict[str, str]:
    """Read agglo's tag name table, a mapping from variable to tag."""
    try:
        names = json.loads(bytes(variable.integers().astype(np.uint8)))
    except (ValueError, RecursionError):
        names = None
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise FileError(f"{NAMES} is damaged")
    return names


def _add_boundary_tags(mesh: Mesh, points: Float, fields: Mapping[str, Variable]) -> Mesh:
    """Add lymph's boundary edge tags to the mesh as the face tag ``bc_tag``."""
    if "connectivity_bc" not in fields or "bc_tag" not in fields:
        return mesh
    ends, values = fields["connectivity_bc"], fields["bc_tag"].integers()
    if not ends.is_numeric or ends.shape != (len(values), 2):
        raise FileError(
            f"region.connectivity_bc has the shape {ends.shape}, but bc_tag has {len(values)} values"
        )
    pairs = _number_from_zero((frozen_int([0, 2 * len(values)]), ends.integers()), len(points), ends.name)[1]
    tag = _tag_outer_edges(mesh, points, frozen_int(pairs.reshape(2, -1).T), values)
    return trusted_copy(mesh, face_tags={**mesh.face_tags, "bc_tag": tag})


def _tag_outer_edges(mesh: Mesh, points: Float, pairs: Int, values: Int) -> Int:
    """Return a face tag ``(n_faces,)`` with given values on boundary edges, −1 on all other edges.

    Parameters
    ----------
    mesh : Mesh
    points : (n, 2) float
        Points of the file; the mesh may number its points differently.
    pairs : (k, 2) int
        End points of edges, in either order; inner edges are ignored.
    values : (k,) int
        Edge tags.
    """
    tag = np.full(mesh.n_faces, -1)
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    # Match edges by the coordinates of their ends.
    mesh_ends = _order_ends(mesh.points[mesh.face_pairs[outer]])
    file_ends = _order_ends(points[pairs])
    order = np.lexsort(mesh_ends.T)
    rows = np.concatenate((mesh_ends[order], file_ends))
    number = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    face = np.full(number.max(initial=-1) + 1, -1)
    face[number[: len(outer)]] = outer[order]
    pair_faces = face[number[len(outer) :]]
    tag[pair_faces[pair_faces >= 0]] = values[pair_faces >= 0]
    return frozen_int(tag)


def _order_ends(ends: Float) -> Float:
    """Return the end coordinates of edges ``(k, 4)``, with the smaller point (by x, then y) first."""
    first, second = ends[:, 0] + 0.0, ends[:, 1] + 0.0
    swap = (first[:, 0] > second[:, 0]) | ((first[:, 0] == second[:, 0]) & (first[:, 1] > second[:, 1]))
    return frozen_float(
        np.where(swap[:, None], np.hstack((second, first)), np.hstack((first, second))).reshape(-1, 4)
    )
