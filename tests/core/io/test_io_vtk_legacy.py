"""Legacy VTK files and .vtp: polyhedra, PolyData, whole numbers of cells; what VTK itself writes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import FileError, Mesh, MeshError, agglomerate, read, read_hierarchy, samples, write

CUBES = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)])
LEFT = [[0, 1, 4, 3], [6, 7, 10, 9], [0, 1, 7, 6], [3, 4, 10, 9], [0, 3, 9, 6], [1, 4, 10, 7]]
RIGHT = [1, 2, 5, 4, 7, 8, 11, 10]  # a hexahedron

TILES = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]


def stream(faces: list[list[int]]) -> list[int]:
    """A polyhedron as legacy files have it: the number of faces, and each of them with its length."""
    return [len(faces), *(word for face in faces for word in (len(face), *face))]


def numbers(values: Any, kind: str, binary: bool) -> bytes:
    """Numbers as text, or in binary with the end of line that follows them."""
    if binary:
        return np.asarray(values).astype(f">{kind}").tobytes() + b"\n"
    return " ".join(map(str, np.ravel(values).tolist())).encode() + b"\n"


def lists(title: str, rows: list[list[int]], version: str, binary: bool) -> bytes:
    """Cells in the layout of a version: a count ahead of each, or offsets and entries."""
    entries = [word for row in rows for word in row]
    if version == "5.1":
        offsets = np.cumsum([0, *map(len, rows)])
        head = f"{title} {len(offsets)} {len(entries)}\nOFFSETS vtktypeint64\n".encode()
        return (
            head
            + numbers(offsets, "i8", binary)
            + b"CONNECTIVITY vtktypeint64\n"
            + numbers(entries, "i8", binary)
        )
    mixed = [word for row in rows for word in (len(row), *row)]
    return f"{title} {len(rows)} {len(mixed)}\n".encode() + numbers(mixed, "i4", binary)


def start(kind: str, points: Any, version: str, binary: bool) -> bytes:
    head = f"# vtk DataFile Version {version}\na title\n{'BINARY' if binary else 'ASCII'}\nDATASET {kind}\n"
    return f"{head}POINTS {len(points)} double\n".encode() + numbers(points, "f8", binary)


def data(values: list[int], binary: bool) -> bytes:
    """Cell data of all kinds, of which three are whole numbers."""
    n, real = len(values), np.arange(len(values)) / 4
    return b"".join(
        (
            f"CELL_DATA {n}\nSCALARS rock int\nLOOKUP_TABLE default\n".encode()
            + numbers(values, "i4", binary),
            b"VECTORS flow float\n" + numbers(np.ones(3 * n, int), "f4", binary),
            b"SCALARS size double 1\nLOOKUP_TABLE default\n" + numbers(real, "f8", binary),
            f"FIELD FieldData 2\nlevel%20of%20it 1 {n} vtktypeint64\n".encode()
            + numbers(values[::-1], "i8", binary),
            f"METADATA\nINFORMATION 0\n\nsigned 1 {n} short\n".encode()
            + numbers([-v for v in values], "i2", binary),
        )
    )


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", ["2.0", "4.2", "5.1"])
def test_polyhedra(version: str, binary: bool, tmp_path: Path) -> None:
    content = start("UNSTRUCTURED_GRID", CUBES, version, binary)
    content += b"METADATA\nINFORMATION 0\n\n" + lists("CELLS", [stream(LEFT), RIGHT], version, binary)
    content += b"CELL_TYPES 2\n" + numbers([42, 12], "i4", binary) + data([7, 9], binary)
    (tmp_path / "m.vtk").write_bytes(content)
    mesh = read(tmp_path / "m.vtk")
    np.testing.assert_allclose(mesh.cell_measures, [1, 1])
    assert (mesh.n_faces, len(mesh.graph.indices)) == (11, 2)
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {
        "rock": [7, 9],
        "level of it": [9, 7],
        "signed": [-7, -9],
    }
    assert mesh.repairs["cell data that are not integers left out"] == 2


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", ["3.0", "5.1"])
def test_polydata(version: str, binary: bool, tmp_path: Path) -> None:
    """Cell data follow vertices, lines and polygons, whatever the order of the sections."""
    content = start("POLYDATA", TILES, version, binary)
    content += lists("POLYGONS", [[0, 1, 4, 3], [1, 2, 5], [1, 5, 4]], version, binary)
    content += lists("LINES", [[0, 1], [3, 4, 5]], version, binary)
    content += lists("VERTICES", [[0]], version, binary) + data([1, 2, 3, 4, 5, 6], binary)
    (tmp_path / "m.vtk").write_bytes(content)
    mesh = read(tmp_path / "m.vtk")
    assert mesh.cell_measures.tolist() == [1, 0.5, 0.5]
    assert mesh.cell_tags["rock"].tolist() == [4, 5, 6]
    (bottom,) = np.flatnonzero(mesh.face_tags["rock"] == 2)
    assert mesh.face_centroids[bottom].tolist() == [0.5, 0]


def test_numbers_of_polygons_in_old_files(tmp_path: Path) -> None:
    content = start("UNSTRUCTURED_GRID", TILES, "4.2", False)
    content += lists("CELLS", [[0, 1, 4, 3], [1, 2, 5, 4]], "4.2", False)
    (tmp_path / "m.vtk").write_bytes(content + b"CELL_TYPES 2\n7 9\n" + data([3, 4], False))
    assert read(tmp_path / "m.vtk").cell_tags["rock"].tolist() == [3, 4]


def test_levels_as_scalars(tmp_path: Path) -> None:
    content = start("POLYDATA", TILES, "3.0", False)
    content += lists("POLYGONS", [[0, 1, 4, 3], [1, 2, 5, 4]], "3.0", False)
    content += b"CELL_DATA 2\nSCALARS level_0 int\nLOOKUP_TABLE default\n1 0\n"
    (tmp_path / "m.vtk").write_bytes(content)
    _, hierarchy = read_hierarchy(tmp_path / "m.vtk")
    assert hierarchy is not None
    assert hierarchy.levels[0].tolist() == [1, 0]


VTP = """<?xml version="1.0"?>
<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>
<Piece NumberOfPoints="6" NumberOfVerts="0" NumberOfLines="2" NumberOfStrips="0" NumberOfPolys="2">
<CellData><DataArray type="Int32" Name="rock" format="ascii">1 2 3 4</DataArray></CellData>
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 2 0 0 0 1 0 1 1 0 2 1 0
</DataArray></Points>
<Lines><DataArray type="Int64" Name="connectivity" format="ascii">0 1 3 4 5</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">2 5</DataArray></Lines>
<Polys><DataArray type="Int64" Name="connectivity" format="ascii">0 1 4 3 1 2 5 4</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4 8</DataArray></Polys>
</Piece></PolyData></VTKFile>
"""


def test_vtp(tmp_path: Path) -> None:
    for name in ("m.vtp", "m.data"):  # by its suffix, and by how it begins
        (tmp_path / name).write_text(VTP)
        mesh = read(tmp_path / name)
        assert mesh.cell_measures.tolist() == [1, 1]
        assert mesh.cell_tags["rock"].tolist() == [3, 4]
        assert sorted(mesh.face_tags["rock"].tolist()) == [-1] * 6 + [1]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('NumberOfPolys="2"', "", "has no valid NumberOfPoints and NumberOfLines and NumberOfPolys"),
        ('NumberOfPolys="2"', 'NumberOfPolys="3"', "'offsets' of Polys must increase and have 3 values"),
        (">4 8<", ">8 4<", "'offsets' of Polys must increase"),
        (">4 8<", ">4 9<", "'connectivity' of Polys has 8 values, expected 9"),
        ("1 2 5 4<", "1 2 6 4<", r"points outside 0\.\.5"),
        (
            '"connectivity" format="ascii">0 1 4',
            '"c" format="ascii">0 1 4',
            "'connectivity' is missing from Polys",
        ),
        ("1 2 3 4<", "1 2 3<", "cell data 'rock' has 3 values for 4 cells"),
        (
            'type="PolyData"',
            'type="ImageData"',
            "expected a VTKFile of type PolyData, found VTKFile of type Image",
        ),
    ],
)
def test_faults_of_vtp(old: str, new: str, says: str, tmp_path: Path) -> None:
    assert old in VTP
    (tmp_path / "m.vtp").write_text(VTP.replace(old, new))
    with pytest.raises(FileError, match=says):
        read(tmp_path / "m.vtp")


def test_surfaces_are_refused(tmp_path: Path) -> None:
    (tmp_path / "m.vtp").write_text(VTP.replace("2 1 0\n", "2 1 1\n"))
    with pytest.raises(MeshError, match="polygons in 3-D are a surface"):
        read(tmp_path / "m.vtp")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("ASCII", "TEXT", r"line 3: expected ASCII or BINARY, found b'TEXT'"),
        ("POINTS 6 double", "POINTS six double", "expected a count, found 'six'"),
        ("POINTS 6 double", "POINTS 900000000000 double", "truncated.*2700000000000 numbers of type double"),
        ("POINTS 6 double", "POINTS 6 complex", "unknown number type 'complex'"),
        ("POINTS 6 double", "POINTS 6", "line 'POINTS 6' is incomplete"),
        ("2.0 1.0 0.0", "2.0 one 0.0", "truncated, or not in the declared format|section 'one'|expected"),
        ("POLYGONS 2 10", "POLYGONS 2 12", "truncated, or not in the declared format"),
        ("POLYGONS 2 10", "POLYGONS 1 10", "1 lists take 5 numbers, but 10 are declared"),
        ("4 1 2 5 4", "4 1 2 6 4", r"points outside 0\.\.5"),
        ("4 1 2 5 4", "5 1 2 5 4", r"cell 1 \(of 2.* is longer"),
        ("CELL_DATA 2", "CELL_DATA 3", "cell data 'rock' has 3 values for 2 cells|truncated"),
        ("SCALARS rock int", "SCALES rock int", "unknown section 'SCALES'"),
    ],
)
def test_faults_of_legacy_files(old: str, new: str, says: str, tmp_path: Path) -> None:
    content = start("POLYDATA", np.array(TILES, float), "3.0", False)
    content += lists("POLYGONS", [[0, 1, 4, 3], [1, 2, 5, 4]], "3.0", False)
    text = (content + b"CELL_DATA 2\nSCALARS rock int\nLOOKUP_TABLE default\n1 0\n").decode()
    assert old in text
    (tmp_path / "m.vtk").write_text(text.replace(old, new))
    with pytest.raises(FileError, match=says):
        read(tmp_path / "m.vtk")


def test_a_file_cut_anywhere_is_refused_or_whole(tmp_path: Path) -> None:
    content = start("UNSTRUCTURED_GRID", CUBES, "5.1", True)
    content += (
        lists("CELLS", [stream(LEFT), RIGHT], "5.1", True) + b"CELL_TYPES 2\n" + numbers([42, 12], "i4", True)
    )
    for stop in range(120, len(content) - 1, 7):
        (tmp_path / "m.vtk").write_bytes(content[:stop])
        with pytest.raises((FileError, MeshError)):
            read(tmp_path / "m.vtk")


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize("dim", [2, 3])
def test_files_of_vtk_writers_are_read(dim: int, version: int, binary: bool, tmp_path: Path) -> None:
    vtk, pyvista = pytest.importorskip("vtk"), pytest.importorskip("pyvista")
    mesh: Mesh = samples.voronoi(60) if dim == 2 else samples.voronoi3d(12)
    write(tmp_path / "m.vtu", mesh, agglomerate(mesh, bisector="coordinate", n_parts=4))
    grid = pyvista.read(tmp_path / "m.vtu")
    written = {"grid.vtk": (vtk.vtkUnstructuredGridWriter(), grid)}
    if dim == 2:
        surface = vtk.vtkPolyData()
        surface.SetPoints(grid.GetPoints())
        surface.SetPolys(grid.GetCells())
        surface.GetCellData().ShallowCopy(grid.GetCellData())
        written |= {"surface.vtk": (vtk.vtkPolyDataWriter(), surface)}
        written |= {"surface.vtp": (vtk.vtkXMLPolyDataWriter(), surface)}
    for name, (writer, content) in written.items():
        writer.SetInputData(content)
        writer.SetFileName(str(tmp_path / name))
        if name.endswith("vtk"):
            writer.SetFileVersion(version)
            writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
        else:
            writer.SetDataModeToAppended() if binary else writer.SetDataModeToAscii()
        writer.Write()
        back, hierarchy = read_hierarchy(tmp_path / name)
        np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-6 if not binary else 1e-12)
        assert hierarchy is not None
        assert hierarchy.parts == [4]
        assert not re.search("dropped|left", str(back.repairs))


def test_scalars_of_structured_grids(tmp_path: Path) -> None:
    """Structured data sets are read by the package meshlane, which gives scalars a second axis."""
    head = "# vtk DataFile Version 3.0\na title\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 3 2 1\n"
    rest = "ORIGIN 0 0 0\nSPACING 1 1 1\nCELL_DATA 2\nSCALARS rock int\nLOOKUP_TABLE default\n4 5\n"
    (tmp_path / "m.vtk").write_text(head + rest)
    mesh = read(tmp_path / "m.vtk")
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.cell_tags["rock"].tolist() == [4, 5]
