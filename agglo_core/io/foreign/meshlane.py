"""Read and write the formats that agglo itself does not support, through the package meshlane.

All its failures become FileErrors.
"""

from __future__ import annotations

import io
import json
import logging
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_float, frozen_int, trusted_copy
from agglo_core.errors import AggloError, FileError
from agglo_core.files.regular import strip_mark, text_bytes
from agglo_core.io.atomic import staging
from agglo_core.io.foreign.unread import why_unread
from agglo_core.io.gmsh.read import soup_of_gmsh
from agglo_core.io.gmsh.write import RESERVED, write_gmsh
from agglo_core.io.tags import cell_data, check_names, note_face_tags, note_left_out
from agglo_core.io.to_mesh.options import Reading, ReadOptions
from agglo_core.io.to_mesh.soup import Soup, mesh_from_soup
from agglo_core.io.vtk.legacy import legacy_kind, read_legacy
from agglo_core.io.vtk.pieces import mesh_from_pieces
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_log = logging.getLogger("agglo")
_SECONDS, _BYTES_PER_SECOND = 6, 100_000  # processor time limit, far above the need of an intact file
_MEMORY, _MEMORY_PER_BYTE = 1 << 28, 400  # bytes in addition to the program itself
_OPEN_ENDED = (".avs", ".inp", ".dat", ".tec")  # text that ends with the last cell, without an end mark


class Meshlane(Reading):
    """Files read and written by the package meshlane: Abaqus, STL, MED and more.

    Agglo itself reads Gmsh files and the unstructured grids and PolyData of legacy VTK. A written file is
    read back and compared; a loss of data is an error.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Keep coincident outer faces.
    drop_flat : bool
        Drop cells with zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Meshlane
    >>> Meshlane().write(Path("mesh.vtk"), agglo.samples.squares(2))
    >>> Meshlane().read(Path("mesh.vtk")).n_cells
    4
    """

    lossless: bool = False
    atomic: bool = True
    last_resort: bool = True

    def read(self, path: Path) -> Mesh:
        """Read a mesh through meshlane.

        Integer cell data and cell sets become tags.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh; FileError for a known but unsupported layout.
        """
        try:
            return _read(path, self.reading)
        except AggloError as error:
            reason = why_unread(path)
            if reason is None:
                raise
            raise FileError(reason) from error

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write through meshlane, read the result back and raise an error if it differs from the mesh.

        Raises
        ------
        FileError
            With the data that the format would lose.
        MeshError
            If files cannot hold a tag name.
        """
        tags = cell_data(mesh, hierarchy)
        check_names(tags)
        with staging(path) as folder:
            target = folder / path.name
            (write_gmsh if path.suffix.lower() == ".msh" else _write_silently)(target, mesh, tags)
            _check_whole(target, mesh, tags)
        if path.suffix.lower() != ".msh":
            note_face_tags(mesh, path.suffix)


def _read(path: Path, options: ReadOptions) -> Mesh:
    if path.suffix.lower() in _OPEN_ENDED:
        _require_last_line_break(path)
    if legacy_kind(path):
        return mesh_from_pieces(read_legacy(path), **options, name=path.stem)
    soup, sets, skipped_names = soup_of_gmsh(text_bytes(path)) if _is_gmsh(path) else _soup(path)
    mesh = mesh_from_soup(soup, weak=False, name=path.stem, **options)
    mesh = _drop_empty_sets(mesh, sets)
    _note_sets(mesh, sets)
    return note_left_out(mesh, skipped_names)


def _require_last_line_break(path: Path) -> None:
    """Raise FileError if the last number of a file may have lost digits."""
    with open(path, "rb") as file:
        file.seek(max(0, path.stat().st_size - 1))
        last = file.read(1)
    if last.isdigit() or last == b",":
        raise FileError(
            "the last line has no line break, so its last number may be incomplete: truncated? If the file "
            "is complete, append a line break"
        )


def _is_gmsh(path: Path) -> bool:
    with open(path, "rb") as file:
        return strip_mark(file.read(64)).lstrip().startswith((b"$MeshFormat", b"$Comments"))


def _soup(path: Path) -> tuple[Soup, set[str], list[str]]:
    """Read the cells of a file with meshlane, in a separate process.

    Return cells, set tag names, and names of omitted data.
    """
    size = path.stat().st_size
    seconds, memory = _SECONDS + size // _BYTES_PER_SECOND, _MEMORY + _MEMORY_PER_BYTE * size
    with tempfile.TemporaryDirectory(prefix="agglo-") as folder:
        target = os.path.join(folder, "cells.npz")
        command = [sys.executable, "-P", "-m", "agglo_core.io.foreign.meshlane_soup"]
        search = os.pathsep.join(part for part in sys.path if part)
        # The child process limits itself; the timeout only covers a blocked process.
        try:
            process = subprocess.run(
                [*command, str(_copy_unmarked(path.absolute(), folder)), target, str(seconds), str(memory)],
                env={**os.environ, "PYTHONPATH": search, "OPENBLAS_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=20 * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise FileError(f"meshlane did not read it within {20 * seconds} s") from None
        if process.returncode < 0:
            raise FileError(
                f"meshlane did not read it within {seconds} s of processor time, or crashed "
                f"(signal {-process.returncode}): the file is probably truncated"
            )
        if process.returncode:
            reason = process.stdout.decode(errors="replace").strip()
            raise FileError(f"meshlane cannot read it: {reason[:300] or 'no reason given'}")
        return _load(target)


def _copy_unmarked(path: Path, folder: str) -> Path:
    """Return the path, or a copy in ``folder`` without the byte order mark that begins the file.

    XML parsers accept the mark, so XML files are not copied. TetGen's pair of files is copied together.
    """
    with open(path, "rb") as file:
        head = file.read(64)
    if strip_mark(head) == head or strip_mark(head).lstrip().startswith(b"<"):
        return path
    pair = (".ele", ".node") if path.suffix.lower() in (".ele", ".node") else (path.suffix,)
    for suffix in pair:
        copy = Path(folder, path.name).with_suffix(suffix)
        copy.write_bytes(text_bytes(path.with_suffix(suffix)))
    return copy.with_suffix(path.suffix)


def _load(target: str) -> tuple[Soup, set[str], list[str]]:
    with np.load(target, allow_pickle=False) as arrays:
        names = json.loads(arrays["names"].tobytes())
        solids = (frozen_int(arrays[key]) for key in ("cell_offsets", "loop_offsets", "loops"))
        soup = Soup(
            frozen_float(arrays["points"]),
            frozen_int(arrays["types"]),
            frozen_int(arrays["offsets"]),
            frozen_int(arrays["vertices"]),
            Polyhedra(*solids),
            {name: frozen_int(arrays[f"tag_{i}"]) for i, name in enumerate(names["tags"])},
        )
        return soup, set(names["sets"]), names["left"]


def _note_sets(mesh: Mesh, sets: set[str]) -> None:
    """Log the names and sizes of the cell and face sets in a file."""
    for entity, tags in (("cells", mesh.cell_tags), ("faces", mesh.face_tags)):
        descriptions = [f"{name} ({(values == 1).sum():,})" for name, values in tags.items() if name in sets]
        if descriptions:
            _log.info("%s by name: %s", entity, ", ".join(descriptions))


def _drop_empty_sets(mesh: Mesh, names: set[str]) -> Mesh:
    """Remove the tags of empty sets, and face tags that are −1 everywhere.

    A set has cells of one dimension, so most sets are empty in the other. Sets that are empty in both cause a
    warning.
    """
    cell_tags, face_tags = (
        {name: values for name, values in tags.items() if name not in names or (values == 1).any()}
        for tags in (mesh.cell_tags, mesh.face_tags)
    )
    face_tags = {name: values for name, values in face_tags.items() if (values != -1).any()}
    empty_names = sorted(names - cell_tags.keys() - face_tags.keys())
    if empty_names:
        _log.warning(
            "groups left out because they have no cell or face of the mesh: %s", ", ".join(empty_names)
        )
    return trusted_copy(mesh, cell_tags=cell_tags, face_tags=face_tags)


def _write_silently(target: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    """Write a mesh through meshlane and discard what meshlane prints.

    Any exception becomes a FileError.
    """
    import meshlane

    blocks = _blocks(mesh)
    cuts = np.cumsum([len(rows) for _, rows in blocks])[:-1]
    points = np.zeros((mesh.n_points, 3))
    points[:, : mesh.dim] = mesh.points
    data = {name: np.split(values, cuts) for name, values in tags.items()}
    output = io.StringIO()
    try:
        with redirect_stdout(output), redirect_stderr(output), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            meshlane.Mesh(points, blocks, cell_data=data).write(target)
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise FileError(f"meshlane cannot write it: {reason[:300]}; .vtu and .npz can hold it") from error


def _blocks(mesh: Mesh) -> list[tuple[str, NDArray[Any]]]:
    """Split the cells into blocks of consecutive cells with the same type, with their nodes."""
    names, offsets, vertices = _polygons(mesh) if mesh.dim == 2 else _tetrahedra(mesh)
    sizes = np.diff(offsets)
    cuts = [0, *(np.flatnonzero(np.diff(sizes)) + 1).tolist(), len(sizes)]
    return [
        (
            names.get(int(sizes[a]), "polygon"),
            vertices[offsets[a] : offsets[b]].reshape(b - a, int(sizes[a])),
        )
        for a, b in pairwise(cuts)
    ]


def _polygons(mesh: Mesh) -> tuple[dict[int, str], Int, Int]:
    loops = mesh.boundary_loops
    several = np.flatnonzero(np.diff(loops.cell_offsets) > 1)
    if len(several):
        raise FileError(f"cell {several[0]} has a hole; only .vtu and .npz can hold it")
    return {3: "triangle", 4: "quad"}, loops.loop_offsets, loops.vertices


def _tetrahedra(mesh: Mesh) -> tuple[dict[int, str], Int, Int]:
    """Return the corners of each tetrahedron: a face, clockwise from outside, then the opposite vertex."""
    offsets, vertices = mesh.cell_vertices
    cell_offsets, faces = mesh.cell_faces
    non_tetrahedra = np.flatnonzero((np.diff(offsets) != 4) | (np.diff(cell_offsets) != 4))
    if len(non_tetrahedra):
        raise FileError(f"cell {non_tetrahedra[0]} is not a tetrahedron; only .vtu and .npz can hold it")
    first = faces[cell_offsets[:-1]]
    base = mesh.face_vertices[gather(mesh.face_offsets, first)[1]].reshape(-1, 3)
    is_owner = mesh.face_cells[first, 0] == np.arange(mesh.n_cells)
    base = np.where(is_owner[:, None], base[:, ::-1], base)
    # The opposite vertex is the sum of all four minus the sum of the face.
    apex = vertices.reshape(-1, 4).astype(np.int64).sum(axis=1) - base.sum(axis=1)
    nodes = np.concatenate((base, apex[:, None]), axis=1)
    return {4: "tetra"}, frozen_int(np.arange(0, nodes.size + 1, 4)), frozen_int(nodes.ravel())


def _check_whole(path: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    """Read a written file back and raise FileError unless it holds the mesh with its tags."""
    hint = f"{path.suffix} would lose {{}}; .vtu and .npz keep everything"
    try:
        file_mesh = Meshlane(merge_points=False, allow_gaps=True).read(path)
    except (AggloError, OSError) as error:
        raise FileError(hint.format(f"the mesh ({error})")) from None
    if file_mesh.dim != mesh.dim or file_mesh.n_cells != mesh.n_cells or file_mesh.n_faces != mesh.n_faces:
        raise FileError(hint.format(f"cells ({file_mesh!r} instead of {mesh!r})"))
    if not np.allclose(file_mesh.cell_measures, mesh.cell_measures, rtol=1e-9, atol=0):
        raise FileError(hint.format("digits of the points or the order of the cells"))
    for name, values in tags.items():
        if name in RESERVED and path.suffix.lower() == ".msh":
            continue
        if name not in file_mesh.cell_tags or not np.array_equal(file_mesh.cell_tags[name], values):
            raise FileError(hint.format(f"the cell data {name!r}"))
