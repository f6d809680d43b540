"""Write OpenFOAM cases: the mesh, and its levels for decomposePar and as fields."""

from __future__ import annotations

import gzip
import logging
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import AggloError, FileError
from agglo_core.files.text_numbers import integer_lines, real_lines
from agglo_core.io.atomic import new_folders, staging
from agglo_core.io.openfoam.files import has_foam
from agglo_core.io.openfoam.parts import FoamPart, read_part
from agglo_core.io.openfoam.read import OWN, PATCH, mesh_of_part, patch_tags
from agglo_core.io.tags import cell_data, check_names, is_level
from agglo_core.io.to_mesh.plain_cells import used_points
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_log = logging.getLogger("agglo")
_NO_WORD = re.compile(r"""[\s"'/\\;{}()\[\]$#]+""")
_REST = "defaultFaces"
_NOTE = "labels of a level, written by agglo"
_HEAD = 512  # bytes that contain the header of a field
_CONSTRAINTS = {
    *("cyclic", "cyclicACMI", "cyclicAMI", "cyclicSlip", "empty"),
    *("processor", "processorCyclic", "symmetry", "symmetryPlane", "wedge"),
}
"""Types of patches that a field must repeat."""


class _Faces(NamedTuple):
    """Faces in OpenFOAM's order: inner faces by owner and neighbour, then patch by patch."""

    order: Int
    turned: Int  # True where the owner has the larger number
    owner: Int
    neighbour: Int
    patches: Mapping[str, tuple[int, int]]  # first face and number of faces


def write_foam(path: Path, mesh: Mesh, hierarchy: Hierarchy | None, *, compress: bool) -> None:
    """Write a mesh as an OpenFOAM case with the labels of all levels.

    ``constant/cellDecomposition`` holds the finest level in decomposePar's format, ``constant/agglo`` every
    level and tag, and ``0`` the levels as fields ``level0``, ``level1``, …. (A field ``level_0`` would hold
    the old-time values of ``level``, and VTK skips such fields.) Patches are named after face tags, cell
    zones after cell tags. If the case already holds this mesh with these patches and zones, ``polyMesh``
    stays as it is. A mesh that is replaced loses its face zones, point zones and level fields.

    Raises
    ------
    FileError
        For a 2-D mesh.
    MeshError
        If files cannot hold a tag name.
    """
    if mesh.dim != 3:
        raise FileError(f"OpenFOAM needs a 3-D mesh, given a {mesh.dim}-D one; write .vtu or .npz instead")
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    # Prepare the text of all files.
    case = path.parent
    poly_mesh = case / "constant" / "polyMesh"
    present = _present_mesh(poly_mesh, mesh, tags)
    poly: dict[str, str] = {}
    if present is None:
        faces = _sort_faces(mesh)
        poly = {**_poly(mesh, faces), **_zones(tags)}
    kinds = present.kinds if present is not None else dict.fromkeys(faces.patches, "patch")
    levels = [f"level_{i}" for i in range(len(hierarchy.levels) if hierarchy is not None else 0)]
    # File names without dots: neither hidden nor with the suffix of compressed files.
    file_names = {name: quote(name, safe="").replace(".", "%2E") for name in tags}
    tag_files = {file_names[name]: _labels(values, OWN) for name, values in tags.items()}
    fields = {f"level{i}": _field(f"level{i}", tags[name], kinds) for i, name in enumerate(levels)}
    split = {"cellDecomposition": _labels(tags[levels[0]], "constant")} if levels else {}
    groups = [(poly_mesh, poly), (case / "constant" / OWN, tag_files)]
    groups += [(case / "constant", split), (case / "0", fields)]
    # Stage all folders first; the case changes only if all files could be written.
    with ExitStack() as stages:
        for folder, files in groups:
            if files:
                stages.enter_context(new_folders((case / "constant", folder)))
                stage = stages.enter_context(staging(folder / next(iter(files))))
                for name, text in files.items():
                    _put(stage / name, text, compress and folder.name != "0")
        stage = stages.enter_context(staging(path))
        (stage / path.name).write_bytes(b"")
    # Remove remains of an earlier mesh.
    if poly:
        _remove_zones(poly_mesh, kept=poly)
    _remove_fields(case / "0", kept=fields)
    for folder, files in groups[:3]:
        _remove_other_forms(folder, files, compress, all_others=folder.name == OWN)


def _present_mesh(folder: Path, mesh: Mesh, tags: Mapping[str, Int]) -> FoamPart | None:
    """Return the mesh of a folder ``polyMesh`` if it is ``mesh`` with its patches and zones, else None."""
    if not has_foam(folder, "faces"):
        return None
    try:
        part = read_part(folder)
    except AggloError:  # it is broken, and will be replaced
        return None
    try:
        is_same = mesh_of_part(part, "").fingerprint == mesh.fingerprint
    except AggloError:  # cells are broken
        is_same = False
    if is_same:
        patches, zones = dict(patch_tags(part)), _zone_cells(tags)
        own = {name: tag for name, tag in mesh.face_tags.items() if name != PATCH or PATCH in patches}
        is_same = own.keys() == patches.keys() and zones.keys() <= part.zones.keys()
        is_same = is_same and all(np.array_equal(own[name], patches[name]) for name in patches)
        is_same = is_same and all(np.array_equal(zones[name], part.zones[name]) for name in zones)
    if is_same:
        return part
    if set(part.kinds.values()) - {"patch"}:
        _log.warning("%s held another mesh or other tags: all its patches have the type patch now", folder)
    return None


def _put(file: Path, text: str, compress: bool) -> None:
    if compress:
        file.with_name(f"{file.name}.gz").write_bytes(gzip.compress(text.encode(), 1))
    else:
        file.write_text(text, encoding="utf-8")


def _remove_other_forms(folder: Path, files: Mapping[str, str], compress: bool, *, all_others: bool) -> None:
    """Remove files of an earlier mesh: old tags, and gzipped copies of plain files or vice versa."""
    current_names = {f"{name}.gz" if compress else name for name in files}
    old_names = {name if compress else f"{name}.gz" for name in files}
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        if file.is_file() and file.name not in current_names and (all_others or file.name in old_names):
            file.unlink()


def _poly(mesh: Mesh, faces: _Faces) -> dict[str, str]:
    """Return the ``polyMesh`` file contents as text, by file name."""
    points, number = used_points(mesh)
    # Reverse the faces whose owner changes.
    offsets, places = gather(mesh.face_offsets, faces.order)
    ends = np.repeat(offsets[:-1] + offsets[1:] - 1, np.diff(offsets))
    turned = np.repeat(faces.turned, np.diff(offsets))
    rank = np.arange(len(places))
    vertices = mesh.face_vertices[places][np.where(turned, ends - rank, rank)]
    vertices = vertices if number is None else number[vertices]
    sizes, vertices = np.diff(offsets), frozen_int(vertices)
    forms = [f"{k}(" + " ".join(["%d"] * k) + ")\n" for k in range(int(sizes.max()) + 1)]
    corners = real_lines(points).splitlines()
    rows = "(" + ")\n(".join(corners) + ")\n"
    note = (
        f"nPoints:{len(points)} nCells:{mesh.n_cells} nFaces:{mesh.n_faces} "
        f"nInternalFaces:{len(faces.neighbour)}"
    )
    poly = "constant/polyMesh"
    return {
        "points": _file("vectorField", poly, "points", len(points), rows),
        "faces": _file("faceList", poly, "faces", len(sizes), integer_lines(offsets, vertices, forms)),
        "owner": _file("labelList", poly, "owner", len(faces.owner), _column(faces.owner), note),
        "neighbour": _file(
            "labelList", poly, "neighbour", len(faces.neighbour), _column(faces.neighbour), note
        ),
        "boundary": _file("polyBoundaryMesh", poly, "boundary", len(faces.patches), "".join(_entries(faces))),
    }


def _zone_cells(tags: Mapping[str, Int]) -> dict[str, Int]:
    """Return the cells of a zone for each 0/1 tag, by name.

    Tags that overlap an earlier zone are skipped.
    """
    zones, in_zone = dict[str, Int](), np.zeros(len(next(iter(tags.values()), ())), bool)
    for name, values in tags.items():
        inside = values == 1
        if (
            is_level(name)
            or not np.isin(values, (0, 1)).all()
            or not inside.any()
            or (inside & in_zone).any()
        ):
            continue
        in_zone |= inside
        zones[_NO_WORD.sub("_", name)] = frozen_int(np.flatnonzero(inside))
    return zones


def _zones(tags: Mapping[str, Int]) -> dict[str, str]:
    """Return the text of ``cellZones``, or nothing without zones."""
    entries = []
    for name, cells in _zone_cells(tags).items():
        rows = f"List<label>\n{len(cells)}\n(\n{_column(cells)})\n"
        entries.append(f"{name}\n{{\n    type cellZone;\n    cellLabels {rows};\n}}\n")
    rows = "".join(entries)
    text = _file("regIOobject", "constant/polyMesh", "cellZones", len(entries), rows)
    return {"cellZones": text} if entries else {}


def _remove_zones(folder: Path, kept: Collection[str]) -> None:
    """Remove zone files of an earlier mesh, whose cell, face and point numbers are no longer valid."""
    for zones in sorted({"cellZones", "faceZones", "pointZones"} - set(kept)):
        for name in (zones, f"{zones}.gz"):
            if not (folder / name).is_file():
                continue
            (folder / name).unlink()
            _log.warning("removed %s: it refers to the mesh that was replaced", folder / name)


def _remove_fields(folder: Path, kept: Collection[str]) -> None:
    """Remove the level fields of an earlier hierarchy, which agglo has marked by a note in the header."""
    for file in sorted(folder.glob("level*")) if folder.is_dir() else ():
        if file.name in kept or not file.is_file():
            continue
        with open(file, "rb") as stream:
            if _NOTE.encode() in stream.read(_HEAD):
                file.unlink()


def _entries(faces: _Faces) -> Iterator[str]:
    for name, (start, count) in faces.patches.items():
        rows = f"        type patch;\n        nFaces {count};\n        startFace {start};\n"
        yield f"    {name}\n    {{\n{rows}    }}\n"


def _sort_faces(mesh: Mesh) -> _Faces:
    owner, neighbour = mesh.face_cells.T
    inner = np.flatnonzero(neighbour >= 0)
    low, high = np.minimum(owner, neighbour)[inner], np.maximum(owner, neighbour)[inner]
    inner = inner[np.lexsort((high, low))]
    outer = np.flatnonzero(neighbour < 0)
    names, patch = _patches(mesh, frozen_int(outer))
    outer = outer[np.lexsort((owner[outer], patch))]
    order = np.concatenate((inner, outer))
    starts = len(inner) + np.concatenate(([0], np.cumsum(np.bincount(patch, minlength=len(names)))))
    ranges = {
        name: (int(a), int(b - a)) for name, a, b in zip(names, starts[:-1], starts[1:], strict=True) if b > a
    }
    turned = np.concatenate((owner[inner] > neighbour[inner], np.zeros(len(outer), bool)))
    sides = np.sort(mesh.face_cells[inner], axis=1)
    return _Faces(
        frozen_int(order),
        frozen_int(turned),
        frozen_int(np.concatenate((sides[:, 0], owner[outer]))),
        frozen_int(sides[:, 1]),
        ranges,
    )


def _patches(mesh: Mesh, outer: Int) -> tuple[list[str], Int]:
    """Group the boundary faces into patches: patch names, and the patch number of each face.

    A 0/1 tag is a patch with its name; for other tags each value except −1 is a patch ``TAG_VALUE``. A tag
    that is 0 or −1 on all outer faces makes no patch. A face is in the patch of its first tag. Warn about
    other tags of the face, and about tags of inner faces.
    """
    names: list[str] = []
    patch = np.full(len(outer), -1)
    for tag, values in mesh.face_tags.items():
        outer_values = values[outer]
        is_binary = np.isin(values, (-1, 0, 1)).all()
        tagged = outer_values == 1 if is_binary else outer_values != -1
        free = (patch < 0) & tagged & (outer_values[tagged] != 0).any()
        for value in np.unique(outer_values[free]).tolist():
            word = _NO_WORD.sub("_", tag if is_binary else f"{tag}_{value}")
            while word in names:
                word += "_"
            patch[free & (outer_values == value)] = len(names)
            names.append(word)
        # The tag ``patch`` of a mesh from OpenFOAM repeats the other tags.
        n_tagged = int((~np.isin(values, (-1, 0))).sum())
        n_written = int((outer_values[free] != 0).sum())
        if n_written < n_tagged and (tag != PATCH or len(mesh.face_tags) == 1):
            _log.warning(
                "face tag %r: %d of %d faces written; OpenFOAM holds outer faces, each in one patch",
                *(tag, n_written, n_tagged),
            )
    if (patch < 0).any():
        patch[patch < 0] = len(names)
        names.append(_REST if _REST not in names else f"{_REST}_")
    return names, frozen_int(patch)


def _labels(values: Int, place: str) -> str:
    return _file("labelList", place, "labels", len(values), _column(values))


def _field(name: str, labels: Int, kinds: Mapping[str, str]) -> str:
    """Return the text of an OpenFOAM scalar field with the labels as values, for patches of these types."""
    types = {patch: kind if kind in _CONSTRAINTS else "zeroGradient" for patch, kind in kinds.items()}
    rows = "".join(f"    {patch}\n    {{\n        type {kind};\n    }}\n" for patch, kind in types.items())
    return (
        _header("volScalarField", "0", name, _NOTE)
        + "dimensions [0 0 0 0 0 0 0];\n"
        + f"internalField nonuniform List<scalar>\n{len(labels)}\n(\n{_column(labels)})\n;\n"
        + f"boundaryField\n{{\n{rows}}}\n"
    )


def _column(values: Int) -> str:
    return "".join(f"{value}\n" for value in values.tolist())


def _file(kind: str, place: str, name: str, count: int, rows: str, note: str = "") -> str:
    return f"{_header(kind, place, name, note)}{count}\n(\n{rows})\n"


def _header(kind: str, place: str, name: str, note: str = "") -> str:
    note_line = f'    note        "{note}";\n' if note else ""
    return (
        f"FoamFile\n{{\n    version     2.0;\n    format      ascii;\n    class       {kind};\n{note_line}"
        f'    location    "{place}";\n    object      {name};\n}}\n\n'
    )
