"""Reading OpenFOAM cases: points, faces, owner and neighbour are a mesh as agglo has it."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.array_checks import check_arrays
from agglo_core.io.foam_files import FoamFile, faces_of, labels_of, open_foam, points_of
from agglo_core.io.soup import with_repairs
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import check_extent, name_cells
from agglo_core.mesh.elements import gather

__all__ = ["OWN", "PATCH", "read_foam"]

PATCH = "patch"
"""Face tag with the number of the patch."""

OWN = "agglo"
"""Folder in ``constant`` with a list of labels for each tag and level."""

_log = logging.getLogger("agglo")
_PATCH = re.compile(rb'(?<![^\s{}();])("[^"\n]{1,200}"|[^\s{}();"]++)\s*+\{((?:[^{}]|\{[^{}]*+\})*+)\}')
_ZONE = re.compile(
    rb"(?<![^\s{}();])([^\s{}();]++)\s*+\{\s*+type\s++cellZone\s*+;\s*+cellLabels\s++List<label>"
)


def read_foam(path: Path, *, merge_points: bool, allow_gaps: bool) -> Mesh:
    """Mesh of the case that a file marks; patches and cell zones become tags of their names.

    Raises
    ------
    FileError, MeshError
        For a case without a mesh, or a broken one.
    """
    inside = path.parent.name == "polyMesh"
    poly = path.parent if inside else path.parent / "constant" / "polyMesh"
    if not poly.is_dir():
        raise FileError(
            f"is an OpenFOAM case without its mesh: there is no folder {poly}; blockMesh makes one"
        )
    mesh = _mesh(poly, path.stem)
    patches = dict(_patches(open_foam(poly, "boundary"), mesh))
    face_tags = {**patches, PATCH: _numbers(patches, mesh)} if patches and PATCH not in patches else patches
    cell_tags = {**dict(_zones(poly, mesh.n_cells)), **dict(_own_tags(poly.parent / OWN, mesh.n_cells))}
    for what, tags in (("faces", patches), ("cells", cell_tags)):
        found = [f"{name} ({int((values == 1).sum()):,})" for name, values in tags.items()]
        if found:
            _log.info("%s by name: %s", what, ", ".join(found))
    mesh = replace(mesh, cell_tags=cell_tags, face_tags=face_tags)
    return mesh if allow_gaps else mesh.conforming(merge_points=merge_points)


def _mesh(poly: Path, name: str) -> Mesh:
    """Points, faces and the cells beside them, checked; points that no face uses are dropped."""
    points = points_of(open_foam(poly, "points"))
    offsets, vertices = faces_of(open_foam(poly, "faces"))
    n_faces = len(offsets) - 1
    owner = labels_of(open_foam(poly, "owner"), n_faces)
    neighbour = labels_of(open_foam(poly, "neighbour"), n_faces)
    if len(owner) != n_faces or len(neighbour) > n_faces:
        raise FileError(f"{n_faces} faces have {len(owner)} owners and {len(neighbour)} neighbours")
    _check_ranges(offsets, vertices, len(points), owner, neighbour)
    sides = np.full((n_faces, 2), -1)
    sides[:, 0] = owner
    sides[: len(neighbour), 1] = neighbour
    used = np.zeros(len(points), bool)
    used[vertices] = True
    orphans = int(len(points) - used.sum())
    if orphans:
        points, vertices = points[used], (np.cumsum(used) - 1)[vertices]
    mesh = Mesh(frozen_float(points), offsets, frozen_int(vertices), frozen_int(sides), name=name)
    check_arrays(mesh)
    flat = np.flatnonzero(mesh.face_measures == 0)
    if len(flat):
        raise FileError(f"faces: face {flat[0]} has no area")
    check_extent(mesh.points)
    return with_repairs(mesh, {"orphan points dropped": orphans})


def _check_ranges(offsets: Int, vertices: Int, n_points: int, owner: Int, neighbour: Int) -> None:
    if not len(owner):
        raise FileError("the mesh is empty: it has no faces")
    if vertices.min(initial=0) < 0 or vertices.max(initial=0) >= n_points:
        face = (
            int(np.searchsorted(offsets, np.argmax((vertices < 0) | (vertices >= n_points)), side="right"))
            - 1
        )
        raise FileError(f"faces: face {face} uses points outside 0..{n_points - 1}")
    few = np.flatnonzero(np.diff(offsets) < 3)
    if len(few):
        raise FileError(f"faces: face {few[0]} has fewer than 3 points")
    n_cells = int(max(owner.max(), neighbour.max(initial=-1))) + 1
    if owner.min() < 0 or neighbour.min(initial=0) < -1 or n_cells > len(owner):
        raise FileError(
            f"owner and neighbour name cells from {owner.min()} to {n_cells - 1} beside {len(owner)} faces"
        )
    twice = _repeated(offsets, vertices)
    if len(twice):
        raise FileError(f"faces: face {twice[0]} has a repeated point")
    few = np.flatnonzero(
        np.bincount(np.concatenate((owner, neighbour[neighbour >= 0])), minlength=n_cells) < 4
    )
    if len(few):
        raise FileError(f"{name_cells(few)}: fewer than 4 faces")


def _repeated(offsets: Int, vertices: Int) -> Int:
    """Faces with a point that they have twice."""
    sizes = np.diff(offsets)
    found = []
    for size in np.unique(sizes).tolist():
        own = np.flatnonzero(sizes == size)
        rows = vertices[gather(offsets, frozen_int(own))[1]].reshape(-1, size)
        twice = np.zeros(len(own), bool)
        if size > 8:
            twice = (np.diff(np.sort(rows, axis=1), axis=1) == 0).any(axis=1)
        else:  # comparing columns takes a tenth of the time
            for i in range(size):
                for j in range(i):
                    twice |= rows[:, i] == rows[:, j]
        found.append(own[twice])
    return frozen_int(np.sort(np.concatenate(found)))


def _patches(file: FoamFile, mesh: Mesh) -> Iterator[tuple[str, Int]]:
    """Name and tag of each patch: 1 on its faces, 0 on those of others, −1 on all others."""
    ranges: dict[str, tuple[int, int]] = {}
    listed = np.zeros(mesh.n_faces, bool)
    body = file.content[file.content.find(b"(", file.start) + 1 :]
    for found in _PATCH.finditer(body):
        name = found[1].strip(b'"').decode("utf-8", "replace")
        numbers = [re.search(rb"\b%b\s+(\d{1,18})\s*;" % key, found[2]) for key in (b"startFace", b"nFaces")]
        start, count = (int(number[1]) if number is not None else -1 for number in numbers)
        if start < 0 or count < 0 or start + count > mesh.n_faces:
            raise FileError(
                f"boundary: patch {name!r} has not startFace and nFaces within {mesh.n_faces} faces"
            )
        ranges[name] = start, count
        listed[start : start + count] = True
    for name, (start, count) in ranges.items():
        if count:
            tag = np.where(listed, 0, -1)
            tag[start : start + count] = 1
            yield name, frozen_int(tag)


def _numbers(patches: Mapping[str, Int], mesh: Mesh) -> Int:
    """The number of the patch of each face, −1 on faces of none."""
    number = np.full(mesh.n_faces, -1)
    for place, tag in enumerate(patches.values()):
        number[tag == 1] = place
    return frozen_int(number)


def _zones(poly: Path, n_cells: int) -> Iterator[tuple[str, Int]]:
    """Name and tag of each cell zone: 1 inside, 0 outside."""
    if not any((poly / name).is_file() for name in ("cellZones", "cellZones.gz")):
        return
    file = open_foam(poly, "cellZones")
    for found in _ZONE.finditer(file.content, file.start):
        name = found[1].decode("utf-8", "replace")
        cells = labels_of(file, n_cells, found.end())
        if len(cells) and (cells.min() < 0 or cells.max() >= n_cells):
            raise FileError(f"cellZones: {name!r} names cells outside 0..{n_cells - 1}")
        tag = np.zeros(n_cells, np.int64)
        tag[cells] = 1
        yield name, frozen_int(tag)


def _own_tags(folder: Path, n_cells: int) -> Iterator[tuple[str, Int]]:
    """Tags and levels that agglo wrote."""
    for each in sorted(folder.iterdir()) if folder.is_dir() else ():
        if each.is_file() and not each.name.startswith("."):
            values = labels_of(open_foam(folder, each.name.removesuffix(".gz")), n_cells)
            if len(values) != n_cells:
                raise FileError(f"{each}: {len(values)} labels for {n_cells} cells")
            yield unquote(each.name.removesuffix(".gz")), values
