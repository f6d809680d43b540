"""Names of face groups in rules: from every reader, whatever value it sets on faces that are not listed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import Mesh, agglomerate, read, samples, write

N = 4
POINTS = [(float(i), float(j), 0.0) for j in range(N + 1) for i in range(N + 1)]
QUADS = [
    [i + (N + 1) * j, i + 1 + (N + 1) * j, i + 1 + (N + 1) * (j + 1), i + (N + 1) * (j + 1)]
    for j in range(N)
    for i in range(N)
]
FAULT = [[2 + (N + 1) * j, 2 + (N + 1) * (j + 1)] for j in range(N)]
INLET = [[(N + 1) * j, (N + 1) * (j + 1)] for j in range(N)]


def rows(lines: list[str]) -> str:
    return f"{len(lines)}\n" + "\n".join(lines)


def gmsh22(folder: Path) -> Path:
    """A file by hand, whose lines belong to two groups."""
    elements = [f"1 2 2 1 {a + 1} {b + 1}" for a, b in FAULT] + [f"1 2 3 2 {a + 1} {b + 1}" for a, b in INLET]
    elements += ["3 2 1 3 " + " ".join(str(v + 1) for v in quad) for quad in QUADS]
    text = (
        '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 1 "rock"\n1 2 "fault"\n1 3 "inlet"\n'
        "$EndPhysicalNames\n$Nodes\n"
        + rows([f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(POINTS, 1)])
        + "\n$EndNodes\n$Elements\n"
        + rows([f"{k} {element}" for k, element in enumerate(elements, 1)])
        + "\n$EndElements\n"
    )
    (folder / "m.msh").write_text(text)
    return folder / "m.msh"


def med(folder: Path) -> Path:
    """Groups of MED, whose families have negative numbers."""
    pytest.importorskip("h5py")
    meshlane = pytest.importorskip("meshlane")
    blocks = [("line", np.array(FAULT + INLET)), ("quad", np.array(QUADS))]
    families = [np.array([-6] * N + [-7] * N), np.full(N * N, -8)]
    given = meshlane.Mesh(np.array(POINTS)[:, :2], blocks, cell_data={"cell_tags": families})
    given.cell_tags = {-6: ["fault"], -7: ["inlet"], -8: ["rock"]}
    meshlane.write(folder / "m.med", given)
    return folder / "m.med"


def line_cells(folder: Path) -> Path:
    """A VTU with line cells, 1 and 0 in their data, as other programs write it."""
    cells = [*FAULT, *INLET, *QUADS]

    def array(name: str, values: list[Any], kind: str = "Int64", width: int = 1) -> str:
        text = " ".join(map(str, values))
        head = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="ascii">'
        return f"{head}{text}</DataArray>"

    ends = np.cumsum([len(cell) for cell in cells]).tolist()
    (folder / "m.vtu").write_text(
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(POINTS)}" NumberOfCells="{len(cells)}"><Points>'
        + array("Points", [x for point in POINTS for x in point], "Float64", 3)
        + "</Points><Cells>"
        + array("connectivity", [v for cell in cells for v in cell])
        + array("offsets", ends)
        + array("types", [3] * 2 * N + [9] * N * N, "UInt8")
        + "</Cells><CellData>"
        + array("fault", [1] * N + [0] * N + [0] * N * N)
        + "</CellData></Piece></UnstructuredGrid></VTKFile>"
    )
    return folder / "m.vtu"


def own_file(suffix: str) -> Callable[[Path], Path]:
    """A file of our own, of the mesh with tags by functions."""

    def make(folder: Path) -> Path:
        if suffix == ".vtkhdf":
            pytest.importorskip("h5py")
        write(folder / f"m{suffix}", by_functions())
        return folder / f"m{suffix}"

    return make


def by_functions() -> Mesh:
    mesh = Mesh.from_polygons(np.array(POINTS)[:, :2], QUADS)
    return mesh.with_face_tags(fault=lambda x: x[:, 0] == 2, inlet=lambda x: x[:, 0] == 0)


FILES = {"gmsh 2.2": gmsh22, "med": med, "line cells": line_cells}
FILES |= {f"own {suffix}": own_file(suffix) for suffix in (".msh", ".vtu", ".vtkhdf", ".npz")}


@pytest.mark.parametrize("how", FILES)
def test_a_name_is_the_faces_of_its_group(how: str, tmp_path: Path) -> None:
    """The fault is the line x = 2: with room for one part there are its two sides, by name as by mask."""
    mesh = read(FILES[how](tmp_path))
    tag = mesh.face_tags["fault"]
    assert (tag == 1).sum() == N
    east = (mesh.cell_centroids[:, 0] > 2).astype(int)
    expected = east if east[0] == 0 else 1 - east
    rules: list[Any] = ["fault", ["fault"], ("fault", "fault=1"), "fault=1", {"fault": 1}, tag == 1]
    for barriers in rules:
        levels = agglomerate(mesh, h_star=9.0, barriers=barriers).levels
        assert levels[0].tolist() == expected.tolist(), barriers
    for tags in ("fault", ["fault"]):
        component = ("barriers", {"tags": tags})
        assert agglomerate(mesh, h_star=9.0, constraints=[component]).levels[0].tolist() == expected.tolist()
    if "inlet" in mesh.face_tags:  # a group of border faces separates no cells
        assert agglomerate(mesh, h_star=9.0, barriers="inlet").parts == [1]
        assert agglomerate(mesh, h_star=9.0, barriers=("inlet", "fault")).parts == [2]


def test_patches_of_openfoam_close_no_inner_face(tmp_path: Path) -> None:
    mesh = samples.boxes(3).with_face_tags(inlet=lambda x: np.isclose(x[:, 0], 0))
    write(tmp_path / "case.foam", mesh)
    back = read(tmp_path / "case.foam")
    assert (back.face_tags["inlet"] == -1).sum() == (back.face_cells[:, 1] >= 0).sum()
    assert agglomerate(back, h_star=9.0, barriers="inlet").parts == [1]


def test_values_that_mark_nothing() -> None:
    """0 and −1 mark nothing, all other values do: of faces and of cells, by keyword and as components."""
    mesh = by_functions()
    on_fault = mesh.face_tags["fault"] == 1
    for value in (1, 3, -6):
        mesh = mesh.with_face_tags(fault=np.where(on_fault, value, -1))
        assert agglomerate(mesh, h_star=9.0, barriers="fault").parts == [2]
    column = mesh.cell_centroids[:, 0].astype(int)
    mesh = mesh.with_tags(column=np.array([-1, 0, 5, -6])[column])
    component = ("where", {"tag": "column"})
    for rule in ({"where": "column"}, {"where": ["column"]}, {"constraints": [component]}):
        labels = agglomerate(mesh, h_star=9.0, **rule).levels[0]
        assert (np.bincount(labels)[labels] == np.where(column < 2, 1, 2 * N)).all()


def ridges(mesh: Mesh) -> list[int]:
    """Cells of each part of a run that only the ridge rule limits."""
    return sorted(np.bincount(agglomerate(mesh, h_star=99.0, boundary_rules="ridges").levels[0]).tolist())


def test_outer_faces_of_no_group_are_no_patch(tmp_path: Path) -> None:
    """Only the inlet, 4 cells at x = 0, is a patch; the fault inside is none, nor are unlisted sides."""
    for how in (gmsh22, med):
        assert ridges(read(how(tmp_path))) == [N, N * N - N]


def test_a_patch_with_a_name_and_numbers_is_one_patch() -> None:
    """Numbers of the groups beside their names, as Gmsh, MED and OpenFOAM have them, add no patches."""
    sides = [lambda x: x[:, 0] == 0, lambda x: x[:, 0] == N, lambda x: x[:, 1] == 0, lambda x: x[:, 1] == N]
    bare = Mesh.from_polygons(np.array(POINTS)[:, :2], QUADS)
    number = sum(k * side(bare.face_centroids) for k, side in enumerate(sides, 1))
    by_number = bare.with_face_tags(number=number)
    both = by_number.with_face_tags(**{f"side_{k}": np.where(number == k, 1, -1) for k in (1, 2, 3, 4)})
    assert ridges(by_number) == ridges(both) == [1, 1, 1, 1, 2, 2, 2, 2, 4]
