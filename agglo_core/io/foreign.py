"""Every other format through meshlane, behind one adapter: its failures become FileError, it stays silent."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.elements import Polyhedra, concatenate, gather
from agglo_core.errors import AggloError, FileError
from agglo_core.io.atomic import staging
from agglo_core.io.cells import Soup, mesh_from_soup
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

__all__ = ["read_foreign", "suffixes", "write_foreign"]

_WEDGE = (0, 2, 1, 3, 5, 4)  # meshlane keeps Gmsh's order, whose first triangle looks inward
# meshlane's name without digits: VTK type of the linear cell, of one with more nodes, corners
_KINDS = {
    "vertex": (1, 1, 1),
    "line": (3, 68, 2),
    "triangle": (5, 69, 3),
    "quad": (9, 70, 4),
    "polygon": (7, 7, 0),
    "tetra": (10, 71, 4),
    "hexahedron": (12, 72, 8),
    "wedge": (13, 73, 6),
    "pyramid": (14, 74, 5),
    "VTK_LAGRANGE_CURVE": (68, 68, 2),
    "VTK_LAGRANGE_TRIANGLE": (69, 69, 3),
    "VTK_LAGRANGE_QUADRILATERAL": (70, 70, 4),
    "VTK_LAGRANGE_TETRAHEDRON": (71, 71, 4),
    "VTK_LAGRANGE_HEXAHEDRON": (72, 72, 8),
    "VTK_LAGRANGE_WEDGE": (73, 73, 6),
    "VTK_LAGRANGE_PYRAMID": (74, 74, 5),
}


def suffixes(*, writing: bool) -> list[str]:
    """Suffixes that meshlane reads, or writes too."""
    from meshlane import _helpers

    known = _helpers._writer_map if writing else _helpers.reader_map
    return sorted(
        suffix
        for suffix, formats in _helpers.extension_to_filetypes.items()
        if suffix.count(".") == 1
        and suffix not in (".vtu", ".npz")
        and any(name in known for name in formats)
    )


def read_foreign(path: Path, *, merge_points: bool) -> Mesh:
    """Mesh of any file that meshlane reads; integer cell data and cell sets become tags.

    Raises
    ------
    FileError, MeshError
        For a broken file or mesh.
    """
    import meshlane

    found = _call(lambda: meshlane.read(path), "read")
    with _translated("read"):
        soup = _soup(found)
    mesh = mesh_from_soup(soup, merge_points=merge_points, weak=False, name=path.stem)
    return _without_empty_sets(mesh, set(found.cell_sets))


def _without_empty_sets(mesh: Mesh, names: set[str]) -> Mesh:
    """Without the tags of sets that hold no cell, or no face: a set lives in one dimension."""
    cell_tags, face_tags = (
        {name: values for name, values in tags.items() if name not in names or (values == 1).any()}
        for tags in (mesh.cell_tags, mesh.face_tags)
    )
    return replace(mesh, cell_tags=cell_tags, face_tags=face_tags)


def _call(action: Callable[[], Any], what: str) -> Any:
    """Run meshlane silently; a failure carries what it printed."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with _translated(what, said):
            return action()


@contextmanager
def _translated(what: str, said: io.StringIO | None = None) -> Iterator[None]:
    """FileError for whatever meshlane raises: it exits, and it meets broken files unprepared."""
    try:
        yield
    except AggloError:
        raise
    except (Exception, SystemExit) as error:
        printed = " ".join(said.getvalue().split()) if said is not None else ""
        reason = f"{type(error).__name__}: {error}" if not isinstance(error, SystemExit) else ""
        raise FileError(f"meshlane cannot {what} it: {(printed or reason)[:300]}") from error


def _soup(found: Any) -> Soup:
    """The blocks of a meshlane mesh as one list of cells."""
    points = np.asarray(found.points, dtype=np.float64)
    if points.ndim == 2 and points.shape[1] == 1:
        raise FileError("it holds a 1-D mesh")
    parts = [_block(block.type, block.data) for block in found.cells]
    sizes = np.concatenate([np.empty(0, np.int64), *(np.diff(part[1]) for part in parts)])
    counts = [len(part[0]) for part in parts]
    vertices = np.concatenate([np.empty(0, np.int64), *(part[2] for part in parts)])
    solids = concatenate([part[3] for part in parts])
    for name, used in (("cells", vertices), ("faces", solids.vertices)):
        if used.size and (used.min() < 0 or used.max() >= len(points)):
            raise FileError(f"its {name} use points outside 0..{len(points) - 1}")
    return Soup(
        frozen_float(points),
        frozen_int(np.concatenate([np.empty(0, np.int64), *(part[0] for part in parts)])),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(vertices),
        solids,
        {**_data_tags(found, counts), **_set_tags(found, counts)},
    )


def _block(name: str, data: Any) -> tuple[Int, Int, Int, Polyhedra]:
    """VTK types, offsets, nodes and half-faces of one block of cells."""
    none = concatenate([])
    if name.startswith("polyhedron"):
        solids = _polyhedra(data)
        n = len(solids.cell_offsets) - 1
        return frozen_int(np.full(n, 42)), frozen_int(np.zeros(n + 1)), frozen_int([]), solids
    kind = name.rstrip("0123456789")
    if kind not in _KINDS:
        raise FileError(f"its cells of type {name!r} are not supported")
    linear, curved, corners = _KINDS[kind]
    rows = (
        data if isinstance(data, np.ndarray) and data.ndim == 2 else [np.asarray(row).ravel() for row in data]
    )
    sizes = np.array([len(row) for row in rows], np.int64)
    nodes = np.concatenate([np.empty(0, np.int64), *rows]).astype(np.int64)
    if kind == "wedge" and len(rows):
        nodes = np.asarray(rows)[:, [*_WEDGE, *range(6, len(rows[0]))]].astype(np.int64).ravel()
    types = np.where((corners == 0) | (sizes == corners), linear, curved)
    return frozen_int(types), frozen_int(np.concatenate(([0], np.cumsum(sizes)))), frozen_int(nodes), none


def _polyhedra(cells: Any) -> Polyhedra:
    loops = [np.asarray(loop, dtype=np.int64) for cell in cells for loop in cell]
    counts, sizes = [len(cell) for cell in cells], [len(loop) for loop in loops]
    return Polyhedra(
        frozen_int(np.concatenate(([0], np.cumsum(counts)))),
        frozen_int(np.concatenate(([0], np.cumsum(sizes)))),
        frozen_int(np.concatenate([np.empty(0, np.int64), *loops])),
    )


def _data_tags(found: Any, counts: list[int]) -> dict[str, Int]:
    """Integer cell data of one component, given for every block."""
    tags = {}
    for name, blocks in found.cell_data.items():
        arrays = [np.asarray(block) for block in blocks]
        whole = all(a.shape == (n,) and a.dtype.kind in "iu" for a, n in zip(arrays, counts, strict=True))
        if whole and arrays:
            tags[name] = frozen_int(np.concatenate(arrays))
    return tags


def _set_tags(found: Any, counts: list[int]) -> dict[str, Int]:
    """Named sets of cells: 1 inside, 0 outside."""
    tags = {}
    starts = np.cumsum([0, *counts])
    for name, blocks in found.cell_sets.items():
        if name.startswith("gmsh:") or len(blocks) != len(counts):
            continue
        inside = np.zeros(starts[-1], np.int64)
        for start, block in zip(starts[:-1], blocks, strict=True):
            if block is not None and len(block):
                inside[start + np.asarray(block, dtype=np.int64)] = 1
        tags[name] = frozen_int(inside)
    return tags


def write_foreign(path: Path, mesh: Mesh, hierarchy: Hierarchy | None) -> None:
    """Write through meshlane, then read the result back: what differs from the mesh is refused.

    Raises
    ------
    FileError
        Naming what the format would lose.
    """
    import meshlane

    levels = hierarchy.levels if hierarchy is not None else []
    tags = {**mesh.cell_tags, **{f"level_{i}": labels for i, labels in enumerate(levels)}}
    blocks = _triangles_and_so_on(mesh)
    cuts = np.cumsum([len(rows) for _, rows in blocks])[:-1]
    points = np.zeros((mesh.n_points, 3))
    points[:, : mesh.dim] = mesh.points
    with staging(path) as folder:
        target = folder / path.name
        data = {name: np.split(values, cuts) for name, values in tags.items()}
        _call(lambda: meshlane.Mesh(points, blocks, cell_data=data).write(target), "write")
        _check_whole(target, mesh, tags)


def _triangles_and_so_on(mesh: Mesh) -> list[tuple[str, NDArray[Any]]]:
    """Runs of cells of one kind, in order."""
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
        raise FileError(f"cell {other[0]} is no tetrahedron; only .vtu and .npz can hold it")
    first = faces[cell_offsets[:-1]]
    base = mesh.face_vertices[gather(mesh.face_offsets, first)[1]].reshape(-1, 3)
    own = mesh.face_cells[first, 0] == np.arange(mesh.n_cells)
    base = np.where(own[:, None], base[:, ::-1], base)
    apex = vertices.reshape(-1, 4).astype(np.int64).sum(axis=1) - base.sum(axis=1)
    nodes = np.concatenate((base, apex[:, None]), axis=1)
    return {4: "tetra"}, frozen_int(np.arange(0, nodes.size + 1, 4)), frozen_int(nodes.ravel())


def _check_whole(written: Path, mesh: Mesh, tags: dict[str, Int]) -> None:
    """Raise FileError unless the file holds the mesh with its tags."""
    hint = f"{written.suffix} would lose {{}}; .vtu and .npz keep everything"
    try:
        found = read_foreign(written, merge_points=False)
    except (AggloError, OSError) as error:
        raise FileError(hint.format(f"the mesh ({error})")) from None
    if found.dim != mesh.dim or found.n_cells != mesh.n_cells or found.n_faces != mesh.n_faces:
        raise FileError(hint.format(f"cells ({found!r} instead of {mesh!r})"))
    if not np.allclose(found.cell_measures, mesh.cell_measures, rtol=1e-9, atol=0):
        raise FileError(hint.format("digits of the points or the order of the cells"))
    for name, values in tags.items():
        if name not in found.cell_tags or not np.array_equal(found.cell_tags[name], values):
            raise FileError(hint.format(f"the cell data {name!r}"))
