"""Small valid files in the formats of other programs."""

from __future__ import annotations

import importlib.util
import io
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from core.io import test_io_vtk_legacy as legacy
from core.io.test_io_ply import TWO, binary
from fuzz.several import packed
from scipy.io import savemat

from agglo_core import Mesh, agglomerate, samples, write

__all__ = ["field_files"]


@cache
def field_files() -> dict[str, list[bytes]]:
    """Return small valid files by suffix."""
    control = _TYP2.replace("cells", "Control volumes")
    return {
        ".typ1": _typ1(),
        ".typ2": [_written(".typ2"), _TYP2.encode(), control.encode()],
        ".foam": _foam(),
        ".ele": _rf(),
        ".hedra": [_written(".hedra", mesh) for mesh in (samples.boxes(3), samples.tetrahedra(2))],
        ".off": [_written(".off"), _OFF.encode(), _OFF.replace("3\n", "3 0.5 0.5 1\n").encode()],
        ".obj": [_written(".obj"), _OBJ.encode()],
        ".ovm": [_written(".ovm", mesh) for mesh in (samples.boxes(2), samples.tetrahedra(2))],
        ".ply": [_written(".ply"), TWO.encode(), binary("<"), binary(">")],
        **({".vtkhdf": _vtkhdf()} if importlib.util.find_spec("h5py") else {}),
        ".pvtu": [_pvtu()],
        ".vtk": [_legacy(version, binary) for version in ("4.2", "5.1") for binary in (False, True)],
        ".vtp": [legacy.VTP.encode()],
        ".mat": [*_mat(), _written(".mat"), _written(".mat", samples.boxes(2))],
    }


def _plane() -> Mesh:
    mesh = samples.voronoi(60, seed=1)
    return replace(mesh, cell_tags={"mat": np.arange(mesh.n_cells) % 3})


def _vtkhdf() -> list[bytes]:
    """Return polygons, polyhedra and elements with face tags, compressed or not."""
    files = []
    for mesh in (_plane(), samples.voronoi3d(8), samples.tetrahedra(1)):
        mesh = mesh.with_face_tags(inlet=lambda x: x[:, 0] < 0.2)
        for compress in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                write(Path(folder) / "m.vtkhdf", mesh, compress=compress)
                files.append((Path(folder) / "m.vtkhdf").read_bytes())
    return files


def _legacy(version: str, binary: bool) -> bytes:
    """Return a polyhedron and a hexahedron with all number types."""
    content = legacy.start("UNSTRUCTURED_GRID", legacy.CUBES, version, binary)
    content += legacy.lists("CELLS", [legacy.stream(legacy.LEFT), legacy.RIGHT], version, binary)
    return content + b"CELL_TYPES 2\n" + legacy.numbers([42, 12], "i4", binary) + legacy.data([7, 9], binary)


def _written(suffix: str, mesh: Mesh | None = None) -> bytes:
    mesh = _plane() if mesh is None else mesh
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"m{suffix}"
        write(file, mesh, agglomerate(mesh, bisector="coordinate", n_parts=(8, 2)))
        return file.read_bytes()


def _pvtu() -> bytes:
    """Return two 2-D pieces of a mesh with their index file."""
    left, right = ("p0.vtu", "p1.vtu")
    mesh = samples.squares(4)
    loops = np.split(mesh.boundary_loops.vertices, mesh.boundary_loops.loop_offsets[1:-1])
    files = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, cells in ((left, loops[:8]), (right, loops[8:])):
            write(Path(folder) / name, Mesh.from_polygons(mesh.points, [cell.tolist() for cell in cells]))
            files[name] = (Path(folder) / name).read_bytes()
    text = _PVTU.format(left, right)
    return packed({"m.pvtu": text.encode(), **files})


_PVTU = """<?xml version="1.0"?>
<VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PUnstructuredGrid GhostLevel="0">
<PPoints><PDataArray type="Float64" NumberOfComponents="3"/></PPoints>
<Piece Source="{}"/>
<Piece Source="{}"/>
</PUnstructuredGrid>
</VTKFile>
"""
_TYP2 = """ Vertices
     6
   0.0  0.0
   1.0E+00  0.0
   1.0D+00  1.0
   0.0  1.0
   2.0  0.0
   2.0  1.0
cells
 2
 4 1 2 3 4
 4 2 5 6
   3
centers
 0.5 0.5
 1.5 0.5
"""


_OFF = """OFF
6 2 0
0 0 0
1 0 0
1 1 0
0 1 0
2 0 0
2 1 0
4 0 1 2 3
4 1 4 5 3
"""
_OBJ = """# by hand
v 0 0 0
v 1 0 0
v 1 1 0
vt 0 0
vn 0 0 1
v 0 1 0
v 2 0 0
v 2 1 0
g left
f 1/1/1 2/1/1 3//1 4
usemtl right
f 2 5 -1 3
"""


def _rf() -> list[bytes]:
    """Return polyhedral files as written by agglo and 1-based, and files with triangles and a tetrahedron."""
    files = []
    for mesh in (samples.boxes(2), samples.tetrahedra(1)):
        mesh = replace(mesh, cell_tags={"mat": np.arange(mesh.n_cells) % 3})
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder) / "m.ele", mesh)
            files.append(packed({each.name: each.read_bytes() for each in Path(folder).iterdir()}))
    nodes = b"4 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n"
    cells = b"1 0\n1 4\n1 3\n1 3 2\n2 3\n1 2 4\n3 3\n2 3 4\n4 3\n3 1 4\n"
    flat = b"4 2 0 1\n1 0 0 1\n2 1 0 1\n3 1 1 1\n4 0 1 1\n# Generated by triangle\n"
    halves = b"2 3 1\n1 1 2 3 7\n2 1 3 4 8\n"
    pairs = [(nodes, cells), (flat, halves), (nodes, b"1 4 0\n1 1 2 3 4\n")]
    return [*files, *(packed({"m.node": a, "m.ele": b}) for a, b in pairs)]


def _typ1() -> list[bytes]:
    """Return triangles, quadrangles and edge lists."""
    points = "vertices\n6\n0 0\n1 0\n1 1\n0 1\n2 0\n2 1\n"
    cells = "triangles\n2\n1 2 3\n1 3 4\nquadrangles\n1\n2 5 6 3\n"
    edges = "edges of the boundary\n2\n1 2\n2 5\nall edges\n1\n1 2 1 0\n"
    return [(points + cells + edges).encode(), (points + cells + "hexagons\n0\n").encode()]


def _mat() -> list[bytes]:
    """Return files as written by MATLAB and scipy: compressed or not, with a cell array, rows or a struct."""
    # Cells as a cell array, as rows padded by NaN, as a struct, and as MRST faces.
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], float)
    cells = np.empty((2, 1), object)
    cells[0, 0], cells[1, 0] = np.array([[1, 2, 3, 4]], np.uint8), np.array([[2.0, 5, 6, 3]])
    rows = np.array([[1, 2, 3, np.nan], [2, 5, 6, 3]])
    region = {"coord": points, "connectivity": cells, "id": [1.0, 2.0], "ne": 2, "bc_tag": [[7]]}
    region["connectivity_bc"] = np.array([[1, 2]])
    grid = samples.squares(3)
    faces = {"nodePos": grid.face_offsets[:, None] + 1.0, "nodes": grid.face_vertices[:, None] + 1.0}
    faces["neighbors"] = grid.face_cells + 1.0
    g = {"faces": faces, "nodes": {"coords": grid.points}}
    files = []
    for variables in (
        {"G": g},
        {"node": points, "elem": cells, "mat": [3, 4]},
        {"node": points, "elem": rows},
        {"region": region},
    ):
        for compress in (False, True):
            stream = io.BytesIO()
            savemat(stream, variables, do_compression=compress)
            files.append(stream.getvalue())
    return files


def _foam() -> list[bytes]:
    """Return OpenFOAM cases: ASCII, compressed and binary."""
    files = []
    mesh = samples.boxes(3)
    mesh = replace(mesh, cell_tags={"mat": np.arange(27) % 3})
    # Cases written by agglo.
    for compress in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            write(
                Path(folder) / "m.foam",
                mesh,
                agglomerate(mesh, bisector="coordinate", n_parts=4),
                compress=compress,
            )
            found = {
                str(each.relative_to(folder)): each.read_bytes()
                for each in Path(folder).rglob("*")
                if each.is_file()
            }
            files.append(
                packed({name: content for name, content in found.items() if content and name[0] != "0"})
            )
    zone = b"FoamFile{format ascii;}\n1\n(\nrotor\n{\ntype cellZone;\n"
    zone += b"cellLabels List<label>\n2\n(\n1 5\n)\n;\n}\n)\n"
    # A binary case: inner faces first, labels of 32 bits, faces in compact form.
    head = 'FoamFile\n{\n version 2.0;\n format binary;\n arch "LSB;label=32;scalar=64";\n class %s;\n}\n'
    sides, inner = mesh.face_cells, mesh.face_cells[:, 1] >= 0
    order = np.argsort(~inner, kind="stable")
    rows = mesh.face_vertices.reshape(-1, 4)[order]

    def rows_of(kind: str, *arrays: np.ndarray) -> bytes:
        parts = [b"%d\n(%b)\n" % (len(each), each.tobytes()) for each in arrays]
        return (head % kind).encode() + b"".join(parts)

    starts = np.arange(0, 4 * len(rows) + 1, 4, dtype="<i4")
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "m.foam", mesh)
        boundary = (Path(folder) / "constant/polyMesh/boundary").read_bytes()
    poly = {
        "points": rows_of("vectorField", mesh.points.astype("<f8")),
        "faces": rows_of("faceCompactList", starts, rows.astype("<i4").ravel()),
        "owner": rows_of("labelList", sides[order, 0].astype("<i4")),
        "neighbour": rows_of("labelList", sides[order, 1][: inner.sum()].astype("<i4")),
        "boundary": boundary,
        "cellZones": zone,
    }
    files.append(packed({f"constant/polyMesh/{name}": content for name, content in poly.items()}))
    return files
