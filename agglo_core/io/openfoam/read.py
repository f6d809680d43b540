"""Read OpenFOAM cases, whose points, faces, owners and neighbours match agglo's mesh arrays."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int, trusted_copy
from agglo_core.errors import FileError
from agglo_core.io.openfoam.files import labels_of, open_foam
from agglo_core.io.openfoam.parts import FoamPart, read_part
from agglo_core.io.openfoam.processors import read_processors
from agglo_core.io.to_mesh.array_checks import check_directions
from agglo_core.io.to_mesh.soup import record_repairs
from agglo_core.mesh import Mesh

PATCH = "patch"
"""Face tag with the number of the patch."""

PROCESSOR = "processor"
"""Cell tag with the number of the processor."""

OWN = "agglo"
"""Folder in ``constant`` with a list of labels per tag and level."""

_log = logging.getLogger("agglo")
_PROCESSOR = re.compile(r"processor(\d{1,9})", re.ASCII)


def is_foam_folder(folder: Path) -> bool:
    """Return True for the folder of a case, for ``polyMesh`` and for its parent folder."""
    return folder.resolve().name == "polyMesh" or any(
        entry.name in ("polyMesh", "constant") or _PROCESSOR.fullmatch(entry.name)
        for entry in folder.iterdir()
        if entry.is_dir()
    )


def read_foam(path: Path, *, merge_points: bool, allow_gaps: bool) -> Mesh:
    """Read the mesh of an OpenFOAM case, whole or decomposed.

    Patches and cell zones become tags with their names.

    Parameters
    ----------
    path : Path
        A file beside ``constant``, a file of ``polyMesh``, or a folder as in :func:`is_foam_folder`.
    merge_points, allow_gaps : bool
        As in :func:`agglo_core.read`.

    Raises
    ------
    FileError, MeshError
        For a case without a mesh, or with a broken mesh.
    """
    path = path.resolve() if path.is_dir() else path  # "." has no name
    poly = _poly(path)
    case = poly.parent.parent if poly.parent.name == "constant" else poly.parent
    name = path.stem if path.is_file() and poly != path.parent else case.resolve().name
    # A case is either whole or decomposed into processors.
    cell_tags: dict[str, Int] = {}
    if poly.is_dir():
        part = read_part(poly)
    else:
        part, cell_tags[PROCESSOR] = read_processors(_processors(case, poly))
    mesh = mesh_of_part(part, name)
    # Tags: patches on faces; zones and stored tags on cells.
    patches = dict(patch_tags(part))
    face_tags = {**patches, PATCH: _numbers(patches, mesh)} if patches and PATCH not in patches else patches
    for zone, cells in part.zones.items():
        cell_tags[zone] = _indicator(cells, mesh.n_cells)
    cell_tags |= dict(_own_tags(poly.parent / OWN, mesh.n_cells))
    zones = {zone: cell_tags[zone] for zone in part.zones}
    for entity, tags in (("faces", patches), ("cells", zones)):
        descriptions = [f"{name} ({int((values == 1).sum()):,})" for name, values in tags.items()]
        if descriptions:
            _log.info("%s by name: %s", entity, ", ".join(descriptions))
    mesh = trusted_copy(mesh, cell_tags=cell_tags, face_tags=face_tags)
    return mesh if allow_gaps else mesh.conforming(merge_points=merge_points)


def _poly(path: Path) -> Path:
    """Return the path of ``polyMesh`` for a path in or at an OpenFOAM case.

    It need not exist.
    """
    if path.is_file():
        return path.parent if path.parent.name == "polyMesh" else path.parent / "constant" / "polyMesh"
    if path.name == "polyMesh":
        return path
    inside = path.name == "constant" or (path / "polyMesh").is_dir()
    return path / "polyMesh" if inside else path / "constant" / "polyMesh"


def _processors(case: Path, poly: Path) -> list[Path]:
    """Return the folders ``processor0``, … of a decomposed case.

    Raises FileError if there are none.
    """
    folders = {
        int(match[1]): folder for folder in case.iterdir() if (match := _PROCESSOR.fullmatch(folder.name))
    }
    if folders:
        missing = sorted(set(range(max(folders) + 1)) - set(folders))
        if missing:
            raise FileError(f"there are folders up to processor{max(folders)}, but no processor{missing[0]}")
        return [folders[i] for i in range(len(folders))]
    regions = sorted(folder.parent.name for folder in poly.parent.glob("*/polyMesh"))
    if regions:
        raise FileError(
            f"is an OpenFOAM case with the regions {', '.join(regions)}; read one of them by its folder, "
            f"such as {poly.parent / regions[0]}"
        )
    raise FileError(f"is an OpenFOAM case without a mesh: {poly} does not exist; run blockMesh to create it")


def mesh_of_part(part: FoamPart, name: str) -> Mesh:
    """Build a mesh from the arrays of ``polyMesh``, and check its face orientations and areas.

    Drop points without a face.
    """
    if not len(part.sides):
        raise FileError("the mesh is empty: it has no faces")
    points, vertices = part.points, part.vertices
    has_face = np.zeros(len(points), bool)
    has_face[vertices] = True
    orphans = int(len(points) - has_face.sum())
    if orphans:
        points, vertices = frozen_float(points[has_face]), frozen_int((np.cumsum(has_face) - 1)[vertices])
    mesh = Mesh(points, part.offsets, vertices, part.sides, name=name)
    check_directions(mesh)
    flat = np.flatnonzero(mesh.face_measures == 0)
    if len(flat):
        raise FileError(f"faces: face {flat[0]} has no area")
    return record_repairs(mesh, {"orphan points dropped": orphans})


def patch_tags(part: FoamPart) -> Iterator[tuple[str, Int]]:
    """Yield a face tag per patch: 1 on its faces, 0 on other patches, −1 elsewhere."""
    template = np.full(len(part.sides), -1)
    for faces in part.patches.values():
        template[faces] = 0
    for name, faces in part.patches.items():
        if len(faces):
            tag = template.copy()
            tag[faces] = 1
            yield name, frozen_int(tag)


def _indicator(cells: Int, n_cells: int) -> Int:
    """Return a cell tag that is 1 in the given cells and 0 elsewhere."""
    tag = np.zeros(n_cells, np.int64)
    tag[cells] = 1
    return frozen_int(tag)


def _numbers(patches: Mapping[str, Int], mesh: Mesh) -> Int:
    """Return a face tag with the number of the patch, −1 on faces outside all patches."""
    number = np.full(mesh.n_faces, -1)
    for place, tag in enumerate(patches.values()):
        number[tag == 1] = place
    return frozen_int(number)


def _own_tags(folder: Path, n_cells: int) -> Iterator[tuple[str, Int]]:
    """Yield names and values of cell tags and levels that agglo has written beside the mesh."""
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        if file.is_file() and not file.name.startswith("."):
            values = labels_of(open_foam(folder, file.name.removesuffix(".gz")), n_cells)
            if len(values) != n_cells:
                raise FileError(f"{file}: {len(values)} labels for {n_cells} cells")
            yield unquote(file.name.removesuffix(".gz")), values
