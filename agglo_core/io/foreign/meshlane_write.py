"""Writing through meshlane; the file is read back, and what a format would lose is refused."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import AggloError, FileError
from agglo_core.io.atomic import staging
from agglo_core.io.foreign.meshlane_read import read_foreign
from agglo_core.io.gmsh.write import RESERVED, write_gmsh
from agglo_core.io.tags import cell_data, check_names
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


def write_foreign(path: Path, mesh: Mesh, hierarchy: Hierarchy | None) -> None:
    """Write through meshlane, then read the result back: what differs from the mesh is refused.

    Raises
    ------
    FileError
        Naming what the format would lose.
    MeshError
        For a cell tag whose name files cannot hold.
    """
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    with staging(path) as folder:
        target = folder / path.name
        (write_gmsh if path.suffix.lower() == ".msh" else _silently)(target, mesh, tags)
        _check_whole(target, mesh, tags)


def _silently(target: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    """Let meshlane write in silence; what a format cannot express may make it raise anything."""
    import meshlane

    blocks = _blocks(mesh)
    cuts = np.cumsum([len(rows) for _, rows in blocks])[:-1]
    points = np.zeros((mesh.n_points, 3))
    points[:, : mesh.dim] = mesh.points
    data = {name: np.split(values, cuts) for name, values in tags.items()}
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            meshlane.Mesh(points, blocks, cell_data=data).write(target)
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise FileError(f"meshlane cannot write it: {reason[:300]}; .vtu and .npz can hold it") from error


def _blocks(mesh: Mesh) -> list[tuple[str, NDArray[Any]]]:
    """Blocks of consecutive cells of one type, with their nodes."""
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
    """Tetrahedra as a face seen from inside and the vertex opposite."""
    offsets, vertices = mesh.cell_vertices
    cell_offsets, faces = mesh.cell_faces
    other = np.flatnonzero((np.diff(offsets) != 4) | (np.diff(cell_offsets) != 4))
    if len(other):
        raise FileError(f"cell {other[0]} is not a tetrahedron; only .vtu and .npz can hold it")
    first = faces[cell_offsets[:-1]]
    base = mesh.face_vertices[gather(mesh.face_offsets, first)[1]].reshape(-1, 3)
    own = mesh.face_cells[first, 0] == np.arange(mesh.n_cells)
    base = np.where(own[:, None], base[:, ::-1], base)
    apex = vertices.reshape(-1, 4).astype(np.int64).sum(axis=1) - base.sum(axis=1)
    nodes = np.concatenate((base, apex[:, None]), axis=1)
    return {4: "tetra"}, frozen_int(np.arange(0, nodes.size + 1, 4)), frozen_int(nodes.ravel())


def _check_whole(written: Path, mesh: Mesh, tags: Mapping[str, Int]) -> None:
    """Raise FileError unless the file holds the mesh with its tags."""
    hint = f"{written.suffix} would lose {{}}; .vtu and .npz keep everything"
    try:
        found = read_foreign(written, merge_points=False, allow_gaps=True, drop_flat=False)
    except (AggloError, OSError) as error:
        raise FileError(hint.format(f"the mesh ({error})")) from None
    if found.dim != mesh.dim or found.n_cells != mesh.n_cells or found.n_faces != mesh.n_faces:
        raise FileError(hint.format(f"cells ({found!r} instead of {mesh!r})"))
    if not np.allclose(found.cell_measures, mesh.cell_measures, rtol=1e-9, atol=0):
        raise FileError(hint.format("digits of the points or the order of the cells"))
    for name, values in tags.items():
        if name in RESERVED and written.suffix.lower() == ".msh":
            continue
        if name not in found.cell_tags or not np.array_equal(found.cell_tags[name], values):
            raise FileError(hint.format(f"the cell data {name!r}"))
