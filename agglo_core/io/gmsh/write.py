"""Write Gmsh 4.1 text files: 0/1 tags as physical groups, other tags as element data."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.text_numbers import integer_lines, real_lines
from agglo_core.io.tags import is_level
from agglo_core.io.text.cell_lines import tag_count
from agglo_core.io.to_mesh.plain_cells import used_points
from agglo_core.io.vtk.cells import POLYHEDRON, cells_of
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather

RESERVED = ("gmsh:physical", "gmsh:geometrical")
"""Tags with group and entity numbers of the source file; the written file renumbers them."""

_NO_GROUPS = (*RESERVED, "gmsh:partition")  # tags of faces

_log = logging.getLogger("agglo")
_LARGEST = 1 << 53  # larger integers are not exact as doubles
_WEDGE = (0, 2, 1, 3, 5, 4)  # Gmsh's first triangle looks inward
_TYPES = {2: 1, 3: 2, 4: 3}  # corners of a line, triangle, quadrilateral to Gmsh's type
_SOLIDS = {10: 4, 12: 5, 13: 6, 14: 7}  # VTK's type to Gmsh's


class _Elements(NamedTuple):
    """Gmsh elements of one dimension: all cells of a mesh, or its faces in named groups."""

    dim: int
    types: Int  # (n,) Gmsh's
    offsets: Int  # (n + 1,)
    nodes: Int  # numbered from 1
    groups: Mapping[str, Int]  # name -> (n,) 1 inside, 0 outside


def write_gmsh(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    """Write a mesh with its tags as a Gmsh 4.1 text file.

    0/1 tags become physical groups, other cell tags element data.

    Raises
    ------
    FileError
        For cells without a Gmsh element, names with quotes, or integers that a double cannot hold.
    """
    points, number = used_points(mesh)
    written_tags = {name: values for name, values in tags.items() if name not in RESERVED}
    _check(written_tags, mesh.face_tags)
    cells = _cells(
        mesh, number, {name: array for name, array in written_tags.items() if _is_group(name, array)}
    )
    faces = _faces(mesh, number)
    with open(path, "w", encoding="utf-8") as stream:
        stream.write("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
        data = {name: values for name, values in written_tags.items() if name not in cells.groups}
        if data:
            stream.write(f"$Comments\n{tag_count(data)}$EndComments\n")
        _write_elements(stream, points, [cells, faces] if len(faces.types) else [cells])
        for name, values in data.items():
            _write_data(stream, name, np.concatenate((values, np.full(len(faces.types), -1))))


def _is_group(name: str, values: Int) -> bool:
    return not is_level(name) and bool(np.isin(values, (0, 1)).all() and values.any())


def _check(tags: Mapping[str, Int], face_tags: Mapping[str, Int]) -> None:
    for name in (*tags, *face_tags):
        if '"' in name or "\\" in name or "\n" in name:
            raise FileError(
                f"Gmsh names cannot contain quotes, backslashes or line breaks; rename the tag {name!r}"
            )
    for name, values in tags.items():
        if np.abs(values).max(initial=0) >= _LARGEST:
            raise FileError(
                f"cell tag {name!r} has values too large for Gmsh's element data, which are doubles"
            )


def _cells(mesh: Mesh, number: Int | None, groups: Mapping[str, Int]) -> _Elements:
    cells = cells_of(mesh)
    sizes = np.diff(cells.offsets)
    is_unsupported = cells.types == POLYHEDRON if mesh.dim == 3 else (sizes > 4) | (cells.loops > 1)
    if is_unsupported.any():
        cell = int(np.argmax(is_unsupported))
        kind = "polyhedron" if mesh.dim == 3 else f"polygon with {sizes[cell]} corners"
        raise FileError(
            f"cell {cell} is a {kind}; Gmsh files hold only triangles, quadrilaterals, tetrahedra, "
            "hexahedra, prisms and pyramids; write .vtu or .npz instead"
        )
    vertices = np.array(cells.vertices)
    wedges = np.flatnonzero(cells.types == 13)
    places = cells.offsets[wedges][:, None] + np.arange(6)
    vertices[places] = vertices[places[:, _WEDGE]]
    kinds = cells.types.tolist() if mesh.dim == 3 else sizes.tolist()
    types = [(_SOLIDS if mesh.dim == 3 else _TYPES)[kind] for kind in kinds]
    return _Elements(
        mesh.dim, frozen_int(types), cells.offsets, _number_from_one(frozen_int(vertices), number), groups
    )


def _faces(mesh: Mesh, number: Int | None) -> _Elements:
    """Return the faces with a positive value in at least one tag, as Gmsh elements.

    A tag with a single positive value is a group; with several values each value is a group.
    """
    groups: dict[str, Int] = {}
    for name, values in mesh.face_tags.items():
        group_values = [] if name in _NO_GROUPS else np.unique(values[values > 0]).tolist()
        for value in group_values:
            group = name if group_values == [1] else f"{name}_{value}"
            if group in groups:
                raise FileError(
                    f"two face tags become the Gmsh group {group!r}; rename the face tag {name!r}"
                )
            groups[group] = frozen_int(values == value)
        if (values < -1).any() and name not in _NO_GROUPS:
            _log.warning("face tag %r: negative values left out; Gmsh files hold positive ones", name)
    sizes = np.diff(mesh.face_offsets)
    is_grouped = np.any([*groups.values(), np.zeros(mesh.n_faces, bool)], axis=0) & (sizes <= 4)
    faces = frozen_int(np.flatnonzero(is_grouped))
    offsets, places = gather(mesh.face_offsets, faces)
    types = [_TYPES[size] for size in sizes[faces].tolist()]
    face_groups = {name: frozen_int(values[faces]) for name, values in groups.items()}
    nodes = _number_from_one(frozen_int(mesh.face_vertices[places]), number)
    return _Elements(mesh.dim - 1, frozen_int(types), offsets, nodes, face_groups)


def _number_from_one(vertices: Int, number: Int | None) -> Int:
    return frozen_int((vertices if number is None else number[vertices]) + 1)


def _write_elements(stream: TextIO, points: Float, parts: list[_Elements]) -> None:
    """Write the sections with physical names, entities, nodes and elements.

    Each set of groups is one entity.
    """
    names = [(part.dim, name) for part in parts for name in part.groups]
    rows = "".join(f'{dim} {i} "{name}"\n' for i, (dim, name) in enumerate(names, 1))
    if names:
        stream.write(f"$PhysicalNames\n{len(names)}\n{rows}$EndPhysicalNames\n")
    # Group the elements by their set of groups; each distinct set is an entity.
    entities: dict[int, list[str]] = {0: [], 1: [], 2: [], 3: []}
    blocks, first = list[str](), 1
    space = np.zeros((len(points), 3))
    space[:, : points.shape[1]] = points
    box = " ".join(map(repr, (*space.min(axis=0).tolist(), *space.max(axis=0).tolist())))
    for part in parts:
        numbers = [i for i, (dim, _) in enumerate(names, 1) if dim == part.dim]
        table = np.stack([np.zeros(len(part.types), np.int64), *part.groups.values()], axis=1)
        sets, entity = np.unique(table, axis=0, return_inverse=True)
        for tag, members in enumerate(sets[:, 1:], 1):
            ids = [i for i, inside in zip(numbers, members.tolist(), strict=True) if inside]
            ids = ids or [len(names) + 1] * bool(
                names
            )  # readers expect a group for all entities, or for none
            entities[part.dim].append(f"{tag} {box} {len(ids)} {' '.join(map(str, ids))} 0\n")
        blocks += _blocks(part, entity.ravel() + 1, first)
        first += len(part.types)
    # Write entities, nodes (one block) and elements.
    counts = " ".join(str(len(entities[dim])) for dim in range(4))
    stream.write(
        f"$Entities\n{counts}\n{''.join(line for dim in range(4) for line in entities[dim])}$EndEntities\n"
    )
    n = len(points)
    stream.write(f"$Nodes\n1 {n} 1 {n}\n{parts[0].dim} 1 0 {n}\n")
    stream.write("".join(f"{i}\n" for i in range(1, n + 1)) + real_lines(space) + "$EndNodes\n")
    stream.write(f"$Elements\n{len(blocks)} {first - 1} 1 {first - 1}\n{''.join(blocks)}$EndElements\n")


def _blocks(part: _Elements, entity: NDArray[Any], first: int) -> Iterator[str]:
    """Yield blocks of consecutive elements with equal entity and type, as text in the original order."""
    turns = np.flatnonzero((np.diff(entity) != 0) | (np.diff(part.types) != 0)) + 1
    for a, b in pairwise([0, *turns.tolist(), len(entity)]):
        size = int(part.offsets[a + 1] - part.offsets[a])
        nodes = part.nodes[part.offsets[a] : part.offsets[b]].reshape(b - a, size)
        rows = frozen_int(np.column_stack((np.arange(first + a, first + b), nodes)))
        offsets = frozen_int((size + 1) * np.arange(b - a + 1))
        lines = integer_lines(offsets, frozen_int(rows.ravel()))
        yield f"{part.dim} {entity[a]} {part.types[a]} {b - a}\n{lines}"


def _write_data(stream: TextIO, name: str, values: NDArray[Any]) -> None:
    """Write an ``$ElementData`` section with one value per element (cells, then faces)."""
    rows = "".join(f"{i} {value}\n" for i, value in enumerate(values.tolist(), 1))
    stream.write(f'$ElementData\n1\n"{name}"\n1\n0.0\n3\n0\n1\n{len(values)}\n{rows}$EndElementData\n')
