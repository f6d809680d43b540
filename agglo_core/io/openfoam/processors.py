"""Join the processor meshes of a decomposed OpenFOAM case to one mesh."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.openfoam.files import has_foam, labels_of, open_foam
from agglo_core.io.openfoam.parts import FoamPart, read_part
from agglo_core.mesh.elements import gather

_GAP = 1e-3  # largest distance between merged points, relative to the face size


def read_processors(folders: Sequence[Path]) -> tuple[FoamPart, Int]:
    """Join the meshes of ``processor0``, ``processor1``, … at their common faces.

    Cells keep their numbers from before the decomposition if all folders have a ``cellProcAddressing``;
    otherwise they are numbered processor by processor.

    Parameters
    ----------
    folders : sequence of Path
        Processor folders in order.

    Returns
    -------
    part : FoamPart
        Mesh without the patches between processors; pieces of periodic patches rejoin their patch.
    processor : (n_cells,) int
        Processor per cell.

    Raises
    ------
    FileError
        With the processor whose mesh is missing, broken or incompatible with another.
    """
    parts = [_read_named(folder) for folder in folders]
    number = _cell_numbers(folders, parts)
    # Concatenate the parts, then identify points and faces across processors.
    union = _concatenate_parts(parts)
    lower_faces, upper_faces = _pairs(parts)
    vertex = _merge_points(union, lower_faces, upper_faces)
    sides = np.where(union.sides >= 0, number[union.sides], -1)
    sides[lower_faces, 1] = sides[upper_faces, 0]
    # Keep the face of the lower processor in each pair.
    is_kept = np.ones(len(sides), bool)
    is_kept[upper_faces] = False
    face = np.cumsum(is_kept) - 1
    offsets, places = gather(union.offsets, frozen_int(np.flatnonzero(is_kept)))
    processor = np.empty(len(number), np.int64)
    processor[number] = np.repeat(np.arange(len(parts)), [part.n_cells for part in parts])
    joined_part = union._replace(
        points=frozen_float(union.points[np.unique(vertex, return_index=True)[1]]),
        offsets=offsets,
        vertices=frozen_int(vertex[union.vertices[places]]),
        sides=frozen_int(sides[is_kept]),
        patches={name: frozen_int(face[faces]) for name, faces in union.patches.items()},
        zones={name: frozen_int(number[cells]) for name, cells in union.zones.items()},
    )
    return joined_part, frozen_int(processor)


def _concatenate_parts(parts: Sequence[FoamPart]) -> FoamPart:
    """Concatenate the arrays of all processor meshes, without the patches between processors."""
    # Offsets of points, cells and faces in the joined numbering.
    first_point, first_cell = (
        _starts(counts) for counts in ([len(p.points) for p in parts], [p.n_cells for p in parts])
    )
    first_face = _first_faces(parts)
    sizes = np.concatenate([np.diff(part.offsets) for part in parts])
    # Pieces of periodic patches get the name of the whole patch.
    patches = _join_groups(
        (part.whole.get(name, name), faces + start)
        for part, start in zip(parts, first_face, strict=False)
        for name, faces in part.patches.items()
    )
    patches.pop("", None)  # inner faces of the joined mesh
    return FoamPart(
        frozen_float(np.concatenate([part.points for part in parts])),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(
            np.concatenate([p.vertices + start for p, start in zip(parts, first_point, strict=False)])
        ),
        frozen_int(
            np.concatenate(
                [
                    np.where(p.sides >= 0, p.sides + start, -1)
                    for p, start in zip(parts, first_cell, strict=False)
                ]
            )
        ),
        int(first_cell[-1]),
        patches,
        _join_groups(
            (name, cells + start)
            for part, start in zip(parts, first_cell, strict=False)
            for name, cells in part.zones.items()
        ),
        {},
        {},
        {},
    )


def _first_faces(parts: Sequence[FoamPart]) -> Int:
    return _starts([len(part.sides) for part in parts])


def _starts(counts: Sequence[int]) -> Int:
    return frozen_int(np.concatenate(([0], np.cumsum(counts))))


def _read_named(folder: Path) -> FoamPart:
    try:
        return read_part(folder / "constant" / "polyMesh")
    except FileError as error:
        raise FileError(f"{folder.name}: {error}") from error.__cause__


def _pairs(parts: Sequence[FoamPart]) -> tuple[Int, Int]:
    """Match the faces between processors, and return those on the lower and on the higher processor."""
    first_face = _first_faces(parts)
    lower_faces, upper_faces = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for i, part in enumerate(parts):
        for j, faces in part.processors.items():
            back = parts[j].processors.get(i, frozen_int([])) if 0 <= j < len(parts) else frozen_int([])
            if len(back) != len(faces):
                raise FileError(
                    f"processor{i} has {len(faces)} faces to processor {j}, which has {len(back)} in return"
                )
            if i < j:
                lower_faces.append(first_face[i] + faces)
                upper_faces.append(first_face[j] + back)
    return frozen_int(np.concatenate(lower_faces)), frozen_int(np.concatenate(upper_faces))


def _merge_points(union: FoamPart, lower_faces: Int, upper_faces: Int) -> Int:
    """Merge the vertices of matching faces on different processors, and return new point numbers.

    Both loops begin at the same point and run in opposite directions.
    """
    points, offsets, vertices = union.points, union.offsets, union.vertices
    sizes = np.diff(offsets)
    if (sizes[lower_faces] != sizes[upper_faces]).any():
        raise FileError("two matching faces of different processors have different numbers of points")
    # Match the k-th vertex of one loop with the (−k)-th of the other.
    starts, places = gather(offsets, lower_faces)
    rank = np.arange(len(places)) - np.repeat(starts[:-1], sizes[lower_faces])
    opposite = np.repeat(offsets[upper_faces], sizes[upper_faces]) + -rank % np.repeat(
        sizes[upper_faces], sizes[upper_faces]
    )
    lower_points, upper_points = vertices[places], vertices[opposite]
    # Matched points must coincide up to a fraction of the face size.
    gap = np.linalg.norm(points[lower_points] - points[upper_points], axis=1)
    size = np.linalg.norm(
        points[lower_points] - points[np.repeat(vertices[offsets[lower_faces]], sizes[lower_faces])], axis=1
    )
    if len(lower_faces):
        wrong = gap > _GAP * np.repeat(np.maximum.reduceat(size, starts[:-1]), sizes[lower_faces])
        if wrong.any():
            a, b = points[lower_points][wrong][0].tolist(), points[upper_points][wrong][0].tolist()
            raise FileError(f"a point between two processors lies at {a} in one and at {b} in the other")
    # Points that are linked through several processors merge into one.
    n = len(points)
    links = sparse.coo_array((np.ones(len(lower_points), bool), (lower_points, upper_points)), shape=(n, n))
    return frozen_int(connected_components(links, directed=False)[1])


def _cell_numbers(folders: Sequence[Path], parts: Sequence[FoamPart]) -> Int:
    """Return for each cell of the concatenated meshes its number in the joined mesh."""
    n = sum(part.n_cells for part in parts)
    polys = [folder / "constant" / "polyMesh" for folder in folders]
    if not all(has_foam(poly, "cellProcAddressing") for poly in polys):
        return frozen_int(np.arange(n))
    numbers = np.concatenate([labels_of(open_foam(poly, "cellProcAddressing"), n) for poly in polys])
    if not np.array_equal(np.sort(numbers), np.arange(n)):
        raise FileError(f"cellProcAddressing must number the {n} cells of all processors, each once")
    return frozen_int(numbers)


def _join_groups(groups: Iterable[tuple[str, Int]]) -> dict[str, Int]:
    """Concatenate index groups of the same name."""
    members: dict[str, list[Int]] = {}
    for name, indices in groups:
        members.setdefault(name, []).append(indices)
    return {name: frozen_int(np.concatenate(blocks)) for name, blocks in members.items()}
