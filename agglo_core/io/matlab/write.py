"""Write meshes as MATLAB variables in the layouts of mVEM, MRST and, in 2-D, lymph."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.io.matlab.mat5_write import (
    cell_array,
    lists,
    matrices,
    nested_lists,
    numbers,
    structure,
    write_variables,
)
from agglo_core.io.matlab.mrst import coarse_structure, grid_structure
from agglo_core.io.tags import is_level
from agglo_core.io.to_mesh.plain_cells import Loops, loops_of, solids_of, write_levels
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

NAMES = "agglo_names"
"""Variable with JSON (as bytes) that maps variables to tag names."""

_COARSE = re.compile(r"CG_\d+", re.ASCII)
_TAKEN = ("node", "elem", "node3", "elem3", "region", "neighbor", "G", NAMES)
_OUTSIDE = 2  # lymph's tag of an outer edge without further information


def write_matlab(path: Path, mesh: Mesh, hierarchy: Hierarchy | None, *, compress: bool) -> None:
    """Write a mesh with its tags and labels, and each coarse mesh to a file beside it.

    A 2-D mesh is written as ``node`` and ``elem`` and as ``region`` and ``neighbor``, a 3-D mesh as ``node3``
    and ``elem3``. Both are also written as MRST's ``G``, with ``CG_0``, … for the levels. Points, cells and
    agglomerates are numbered from 1, tags keep their values.

    Raises
    ------
    FileError
        For 2-D cells with holes, or a mesh above the size limit of the format.
    MeshError
        If files cannot hold a tag name.
    """
    has_ids = "id" in mesh.cell_tags
    kept = ("bc_tag",) if mesh.dim == 2 else ()
    write_levels(path, mesh, hierarchy, partial(_write, has_ids=has_ids, compress=compress), face_tags=kept)


def _write(path: Path, mesh: Mesh, tags: Mapping[str, Int], *, has_ids: bool, compress: bool) -> None:
    cells = _solid(mesh) if mesh.dim == 3 else _plane(mesh, tags, has_ids)
    grids = [grid_structure(mesh), *_coarse_grids(mesh, tags)]
    names = _variable_names(tags)
    # The names come first, and the variable that is read before the others, so that a reader notices a
    # file that ends between two variables.
    write_variables(path, [_name_table(names), *cells, *grids, *_tags(names, tags)], compress=compress)


def _coarse_grids(mesh: Mesh, tags: Mapping[str, Int]) -> Iterator[bytes]:
    """Yield the levels as MRST's coarse grids ``CG_0``, ``CG_1``, …."""
    for name, labels in tags.items():
        if is_level(name) and labels.min() == 0 and np.bincount(labels).all():
            yield coarse_structure(f"CG_{name.removeprefix('level_')}", mesh, labels)


def _solid(mesh: Mesh) -> Iterator[bytes]:
    points, solids = solids_of(mesh, ".mat")
    yield numbers("node3", points)
    cells = nested_lists(solids.cell_offsets, solids.loop_offsets, frozen_int(solids.vertices + 1))
    yield cell_array("elem3", (mesh.n_cells, 1), cells)


def _plane(mesh: Mesh, tags: Mapping[str, Int], has_ids: bool) -> Iterator[bytes]:
    loops = loops_of(mesh, ".mat")
    cells = lists(loops.offsets, frozen_int(loops.vertices + 1))
    yield structure("region", _region(mesh, loops, tags, has_ids))
    yield numbers("node", loops.points)
    yield cell_array("elem", (mesh.n_cells, 1), cells)
    n, sizes = mesh.n_cells, np.diff(loops.offsets)
    cell, edge = _neighbours(loops)
    yield structure(
        "neighbor",
        {
            "nedges": numbers("", sizes[None]),
            "neigh": cell_array("", (1, n), lists(loops.offsets, cell)),
            "neighedges": cell_array("", (1, n), lists(loops.offsets, edge)),
        },
    )


def _region(mesh: Mesh, loops: Loops, tags: Mapping[str, Int], has_ids: bool) -> dict[str, bytes]:
    """Return the fields of lymph's struct ``region``, except ``max_kb``.

    lymph's function ``MakePolygonProperties`` computes ``max_kb``. ``id`` is 1 if the fine mesh has no ids; a
    coarse mesh whose agglomerates contain several ids has none.
    """
    n, starts = mesh.n_cells, loops.offsets[:-1]
    corners = loops.points[loops.vertices]
    box = [bound.reduceat(x, starts) for x in corners.T for bound in (np.minimum, np.maximum)]
    pairs, values = _boundary(mesh, loops)
    ids = tags.get("id", None if has_ids else np.ones(n, np.int64))
    return {
        "ne": numbers("", [[n]]),
        "nedges": numbers("", np.diff(loops.offsets)[None]),
        "BBox": numbers("", np.stack(box, axis=1)),
        "coord": numbers("", loops.points),
        **({} if ids is None else {"id": numbers("", ids)}),
        "coords_element": cell_array("", (1, n), matrices(loops.offsets, frozen_float(corners))),
        "connectivity": cell_array("", (1, n), lists(loops.offsets, frozen_int(loops.vertices + 1))),
        "area": numbers("", mesh.cell_measures),
        "connectivity_bc": numbers("", pairs + 1),
        "bc_tag": numbers("", values[None]),
    }


def _boundary(mesh: Mesh, loops: Loops) -> tuple[Int, Int]:
    """Return the end points of the boundary edges ``(k, 2)``, and their lymph tags ``(k,)``."""
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    number = np.cumsum(np.bincount(mesh.face_vertices, minlength=mesh.n_points) > 0) - 1
    tag = mesh.face_tags.get("bc_tag", np.full(mesh.n_faces, _OUTSIDE))[outer]
    return frozen_int(number[mesh.face_pairs[outer]]), frozen_int(np.where(tag < 0, _OUTSIDE, tag))


def _neighbours(loops: Loops) -> tuple[Int, Int]:
    """Return for each edge of each cell the adjacent cell and the edge's number in that cell, from 1.

    The entries are −1 outside.
    """
    sizes = np.diff(loops.offsets)
    owner = np.repeat(np.arange(len(sizes)), sizes)
    rank = np.arange(len(owner)) - loops.offsets[owner]
    # Edges of two cells have equal keys and are neighbours after sorting.
    head = np.roll(loops.vertices, -1)
    head[loops.offsets[1:] - 1] = loops.vertices[loops.offsets[:-1]]
    key = np.minimum(loops.vertices, head) * len(loops.points) + np.maximum(loops.vertices, head)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = order[twin], order[twin + 1]
    cell, edge = np.full(len(owner), -1), np.full(len(owner), -1)
    cell[a], cell[b], edge[a], edge[b] = owner[b] + 1, owner[a] + 1, rank[b] + 1, rank[a] + 1
    return frozen_int(cell), frozen_int(edge)


def _variable_names(tags: Mapping[str, Int]) -> dict[str, str]:
    """Return the tag name of each MATLAB variable, with substitutes for names that are invalid in MATLAB."""
    names: dict[str, str] = {}
    for name in tags:
        ascii_name = re.sub(r"[^A-Za-z0-9_]", "_", name)[:40]
        fits = (
            ascii_name == name
            and ascii_name[:1].isalpha()
            and name not in _TAKEN
            and not _COARSE.fullmatch(name)
        )
        variable = name if fits else f"tag{len(names)}_{ascii_name}"
        while variable in names or (variable != name and variable in tags):
            variable += "_"
        names[variable] = name
    return names


def _tags(names: Mapping[str, str], tags: Mapping[str, Int]) -> Iterator[bytes]:
    """Yield each tag as a MATLAB variable."""
    for variable, name in names.items():
        yield numbers(variable, tags[name] + 1 if is_level(name) else tags[name])


def _name_table(names: Mapping[str, str]) -> bytes:
    """Return the variable with the tag names."""
    text = np.frombuffer(json.dumps(names).encode(), np.uint8)
    return numbers(NAMES, text[None])
