"""Read the arrays in an OpenFOAM folder ``polyMesh`` and check their indices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.openfoam.dictionaries import FoamParser, Table, labels_in, number_in, word_in
from agglo_core.io.openfoam.files import faces_of, has_foam, labels_of, open_foam, parser_of, points_of
from agglo_core.mesh.checks import name_cells
from agglo_core.mesh.elements import gather


class FoamPart(NamedTuple):
    """Mesh in one folder ``polyMesh``: the whole mesh, or the part on one processor."""

    points: Float  # (n_points, 3)
    offsets: Int  # (n_faces + 1,)
    vertices: Int
    sides: Int  # (n_faces, 2), owner and neighbour, −1 outside
    n_cells: int
    patches: Mapping[str, Int]  # faces by name
    zones: Mapping[str, Int]  # cells by name
    processors: Mapping[int, Int]  # faces by adjacent processor
    whole: Mapping[str, str]  # periodic patch by the name of its piece between processors
    kinds: Mapping[str, str]  # type of each patch


def read_part(poly: Path) -> FoamPart:
    """Read the files of a folder ``polyMesh`` and check all indices.

    Raises
    ------
    FileError
        For a missing or broken file.
    """
    points = points_of(open_foam(poly, "points"))
    offsets, vertices = faces_of(open_foam(poly, "faces"))
    n_faces = len(offsets) - 1
    owner = labels_of(open_foam(poly, "owner"), n_faces)
    neighbour = labels_of(open_foam(poly, "neighbour"), n_faces)
    if len(owner) != n_faces or len(neighbour) > n_faces:
        raise FileError(
            f"{n_faces} faces have {len(owner)} owners and {len(neighbour)} neighbours, "
            "expected one owner per face"
        )
    _check_ranges(offsets, vertices, len(points), owner, neighbour)
    sides = np.full((n_faces, 2), -1)
    sides[:, 0] = owner
    sides[: len(neighbour), 1] = neighbour
    n_cells = int(sides.max(initial=-1)) + 1
    part = FoamPart(
        points, offsets, vertices, frozen_int(sides), n_cells, {}, _zones(poly, n_cells), {}, {}, {}
    )
    return _add_patches(part, dict(_unique_entries("boundary", parser_of(open_foam(poly, "boundary"), 0))))


def _check_ranges(offsets: Int, vertices: Int, n_points: int, owner: Int, neighbour: Int) -> None:
    if vertices.min(initial=0) < 0 or vertices.max(initial=-1) >= n_points:
        face = (
            int(np.searchsorted(offsets, np.argmax((vertices < 0) | (vertices >= n_points)), side="right"))
            - 1
        )
        raise FileError(f"faces: face {face} uses points outside 0..{n_points - 1}")
    violations = np.flatnonzero(np.diff(offsets) < 3)
    if len(violations):
        raise FileError(f"faces: face {violations[0]} has fewer than 3 points")
    n_cells = int(max(owner.max(initial=-1), neighbour.max(initial=-1))) + 1
    if owner.min(initial=0) < 0 or neighbour.min(initial=0) < -1 or n_cells > len(owner):
        raise FileError(
            f"owner and neighbour list cells {owner.min()} to {n_cells - 1}, but there are {len(owner)} faces"
        )
    repeats = _faces_with_repeats(offsets, vertices)
    if len(repeats):
        raise FileError(f"faces: face {repeats[0]} has a repeated point")
    violations = np.flatnonzero(
        np.bincount(np.concatenate((owner, neighbour[neighbour >= 0])), minlength=n_cells) < 4
    )
    if len(violations):
        raise FileError(f"{name_cells(violations)}: fewer than 4 faces")


def _faces_with_repeats(offsets: Int, vertices: Int) -> Int:
    """Return the indices of the faces that list a point twice."""
    sizes = np.diff(offsets)
    repeats = [np.empty(0, np.int64)]
    for size in np.unique(sizes).tolist():
        faces = np.flatnonzero(sizes == size)
        rows = vertices[gather(offsets, frozen_int(faces))[1]].reshape(-1, size)
        has_repeat = np.zeros(len(faces), bool)
        if size > 8:
            has_repeat = (np.diff(np.sort(rows, axis=1), axis=1) == 0).any(axis=1)
        else:  # comparing columns takes a tenth of the time
            for i in range(size):
                for j in range(i):
                    has_repeat |= rows[:, i] == rows[:, j]
        repeats.append(faces[has_repeat])
    return frozen_int(np.sort(np.concatenate(repeats)))


def _unique_entries(file: str, parser: FoamParser) -> Iterator[tuple[str, Table]]:
    """Yield the names and dictionaries in a list, and check that no name occurs twice.

    Duplicate names raise FileError.
    """
    names = set[str]()
    for name, table in parser.named_tables():
        if name in names:
            raise FileError(f"{file}: two entries have the name {name!r}")
        names.add(name)
        yield name, table


def _add_patches(part: FoamPart, tables: Mapping[str, Table]) -> FoamPart:
    """Add the boundary patches, given by first face and number of faces, to the mesh."""
    patches, processors, whole = dict[str, Int](), dict[int, Int](), dict[str, str]()
    n_faces = len(part.sides)
    for name, table in tables.items():
        start, count = number_in(table, "startFace"), number_in(table, "nFaces")
        if start < 0 or count < 0 or start + count > n_faces:
            entries = ", ".join(f"{key} {word_in(table, key) or 'none'}" for key in ("startFace", "nFaces"))
            raise FileError(f"boundary: patch {name!r} must lie within {n_faces} faces, given {entries}")
        inner = np.flatnonzero(part.sides[start : start + count, 1] >= 0)
        if len(inner):
            raise FileError(f"boundary: face {start + inner[0]} of patch {name!r} lies between two cells")
        patches[name] = frozen_int(np.arange(start, start + count))
        kind = word_in(table, "type")
        if kind == "processor":
            processors[number_in(table, "neighbProcNo")] = patches[name]
        if kind in ("processor", "processorCyclic"):
            whole[name] = word_in(table, "referPatch")
    kinds = {name: word_in(table, "type") for name, table in tables.items()}
    return part._replace(patches=patches, processors=processors, whole=whole, kinds=kinds)


def _zones(poly: Path, n_cells: int) -> dict[str, Int]:
    """Read the cell zones: the indices of the cells in each, by name."""
    zones: dict[str, Int] = {}
    if not has_foam(poly, "cellZones"):
        return zones
    for name, table in _unique_entries("cellZones", parser_of(open_foam(poly, "cellZones"), n_cells)):
        cells = labels_in(table, "cellLabels")
        if cells is None:
            raise FileError(f"cellZones: {name!r} has no list cellLabels")
        if cells.min(initial=0) < 0 or cells.max(initial=-1) >= n_cells:
            raise FileError(f"cellZones: {name!r} lists cells outside 0..{n_cells - 1}")
        zones[name] = cells
    return zones
