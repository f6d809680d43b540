"""Small valid files of every fuzzed suffix, with all codings, layouts and cell types."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path

import meshlane
import numpy as np
from core.io.test_gmsh_read import data, partitioned, version_2
from core.io.test_io_vtu import ELEMENTS, SQUARE, Writer, polyhedra
from fuzz.field_corpus import field_files
from fuzz.foreign_corpus import foreign_files
from fuzz.graph_corpus import graph_files
from fuzz.matrix_corpus import matrix_files

import agglo_gnn
from agglo_core import Hierarchy, Mesh, agglomerate, samples, write
from agglo_core.interchange import to_geojson

__all__ = ["valid_files"]


def valid_files(suffix: str) -> list[bytes]:
    """Return small valid files of a suffix, including every coding and layout."""
    return [*_own_files().get(suffix, []), *foreign_files(suffix)]


@cache
def _own_files() -> dict[str, list[bytes]]:
    """Return files by suffix that were not written by meshlane."""
    return {
        **field_files(),
        ".vtu": [*_vtu_by_hand(), *_written(".vtu"), _vtu_with_names()],
        ".npz": _npz(),
        ".msh": _msh(),
        ".toml": [text.encode() for text in _RUNS.split("---")],
        ".problem.toml": [text.encode() for text in _PROBLEMS.split("---")],
        ".safetensors": [_WEIGHTS.read_bytes()],
        **graph_files(),
        **matrix_files(),
        ".geojson": [json.dumps(to_geojson(*each)).encode() for each in _hierarchies() if each[0].dim == 2],
    }


_WEIGHTS = Path(agglo_gnn.__file__).parent / "weights" / "fast.safetensors"
_RUNS = """
bisector = "kmeans"
n_parts = 4
seed = 3
---
bisector = { name = "spectral", split = "median" }
refiners = [{ name = "interface", floor = 0.9 }]
merge = true
h_factor = [2, 4]
---
bisector = { name = "sweep" }
h_factor = [2, 4.5]
fixer = "connectivity"
nested = false
---
[bisector]
name = "coordinate"
[[post_refiners]]
name = "interface"
[[post_refiners]]
name = "descent"
---
bisector = { name = "metis", ncuts = 2, contig = true }
method = "kway"
n_parts = [8, 2]
---
h_star = 0.75
bisector = "inertial"
constraints = []
"""
_PROBLEMS = """
source = 1.0
[kappa.material]
0 = 1.0
1 = 1e6
[dirichlet]
1 = 0.0
[neumann]
2 = 1.5
---
boundary = "boundary"
kappa = 2.5
source = { material = { 0 = 1, 1 = -3 } }
[dirichlet]
left = 2
---
kind = "linear"
matrix = "A.mtx"
rhs = "b.npy"
unknowns = 3
"""


def _vtu_by_hand() -> Iterator[bytes]:
    codings = [(form, packing) for form in ("ascii", "binary", "raw", "base64") for packing in ("", "zlib")]
    plane = [(9, [0, 1, 2, 3]), (7, [1, 4, 5, 2]), (3, [0, 1])]
    solid = [(14, [4, 5, 6, 7, 8]), (9, [0, 1, 2, 3]), (42, list(range(8)))]
    points = np.array([*ELEMENTS[12][0], [0.5, 0.5, 4]])
    for i, (form, packing) in enumerate([*codings, ("raw", "lzma"), ("binary", "lzma")]):
        w = Writer(form, packing, "u4" if i % 3 else "u8", ">" if i % 4 == 3 else "<")
        yield w.file(w.piece(SQUARE, plane, data=w.array("mat", [3, -4, 5], "i4")))
        w = Writer(form, packing)
        layout = "csr" if i % 2 else "stream"
        data = [w.array("mat", [1, 2, 3], "i8") + w.array("vtkGhostType", [k, 0, 0], "u1") for k in (0, 1)]
        pieces = [w.piece(points + np.array([k, 0, 0]), solid, polyhedra(w, layout), data[k]) for k in (0, 1)]
        yield w.file(*pieces)


def _hierarchies(*meshes: Mesh) -> Iterator[tuple[Mesh, Hierarchy]]:
    """Yield hierarchies of the meshes; by default of a 2-D mesh, a 3-D mesh and a mesh with holes."""
    grid = samples.squares(7)
    one_by_one = np.arange(grid.n_cells)
    holes = grid.coarsen(np.unique(np.where(_frame(7), 8, one_by_one), return_inverse=True)[1])
    for mesh in meshes or (samples.voronoi(60, seed=1), samples.boxes(3), holes):
        tagged = replace(mesh, cell_tags={"mat": np.arange(mesh.n_cells) % 3})
        hierarchy = agglomerate(tagged, bisector="coordinate", n_parts=(8, 2))
        yield tagged, replace(hierarchy, statistics={"depth": 3})  # reproducible: no times


def _frame(n: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return a mask of the cells around the middle 3 × 3 cells of an n × n grid."""
    i, j = np.divmod(np.arange(n * n), n)
    return np.maximum(abs(i - n // 2), abs(j - n // 2)) == 2


def _vtu_with_names() -> bytes:
    """Return a VTU file whose field data name the tagged faces."""
    mesh = samples.voronoi(12, seed=2)
    mesh = mesh.with_face_tags(inlet=lambda x: x[:, 0] < 0.2, number=np.arange(mesh.n_faces) % 3)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "m.vtu", mesh)
        return (Path(folder) / "m.vtu").read_bytes()


def _written(suffix: str, *meshes: Mesh) -> Iterator[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        for i, (mesh, hierarchy) in enumerate(_hierarchies(*meshes)):
            file = Path(folder) / f"{i}{suffix}"
            write(file, mesh, hierarchy)
            yield file.read_bytes()


def _npz() -> list[bytes]:
    mesh = samples.voronoi(60, seed=1)
    loops = mesh.boundary_loops
    stream = io.BytesIO()
    np.savez(stream, points=mesh.points, cell_offsets=loops.loop_offsets, cell_vertices=loops.vertices)
    plain = stream.getvalue()
    return [_undated(content) for content in (*_written(".npz"), plain, plain)]


def _undated(content: bytes) -> bytes:
    """Return the archive without time stamps."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(stream, "w") as new:
        for info in old.infolist():
            new.writestr(zipfile.ZipInfo(info.filename), old.read(info), info.compress_type)
    return stream.getvalue()


def _msh() -> list[bytes]:
    """Return Gmsh 2.2, 4.0 and 4.1 files, ASCII and binary, 2-D and 3-D, with partitions and element data."""
    plane = samples.triangles(4)
    loops = plane.boundary_loops.vertices.reshape(-1, 3)
    flat = np.c_[plane.points, np.zeros(plane.n_points)]
    cube = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    meshes = [
        meshlane.Mesh(flat, [("triangle", loops[:-2]), ("triangle", loops[-2:]), ("line", loops[:3, :2])]),
        meshlane.Mesh(flat, [("triangle", loops)]),
        meshlane.Mesh(cube, [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))]),
        meshlane.Mesh(cube, [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))]),
    ]
    found = [partitioned(version, order) for version in ("4.0", "4.1") for order in ("", "<")]
    found += [version_2("") + data("part", [(6, 3)]), version_2("<"), *_written(".msh", samples.triangles(3))]
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        for mesh, form in zip(meshes, ("gmsh22", "gmsh", "gmsh22", "gmsh"), strict=True):
            mesh.cell_data = {
                f"gmsh:{name}": [np.ones(len(block.data), np.int64) for block in mesh.cells]
                for name in ("physical", "geometrical")
            }
            for binary in (False, True):
                file = Path(folder) / "m.msh"
                meshlane.write(file, mesh, file_format=form, binary=binary)
                found.append(file.read_bytes())
    return found
