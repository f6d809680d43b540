"""Other formats through meshlane: tags, repairs, failures turned into our errors, refused losses."""

from __future__ import annotations

import os
from pathlib import Path

import meshlane
import numpy as np
import pytest

from agglo_core import samples
from agglo_core.errors import AggloError, FileError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import Meshlane, read, read_hierarchy, write
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import polyhedra_from_elements

POINTS = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]

GMSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
1 7 "wall"
2 9 "body"
$EndPhysicalNames
$Nodes
7
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 2 0 0
6 2 1 0
7 9 9 0
$EndNodes
$Elements
5
1 15 2 5 1 1
2 1 2 7 1 1 2
3 1 2 7 1 2 5
4 3 2 9 1 1 2 3 4
5 2 2 9 2 2 6 5
$EndElements
"""


def test_gmsh_tags(tmp_path: Path) -> None:
    file = tmp_path / "two.msh"
    file.write_text(GMSH)
    mesh = read(file)
    assert mesh.name == "two"
    np.testing.assert_allclose(mesh.cell_measures, [1, 0.5])
    assert mesh.cell_tags["gmsh:physical"].tolist() == [9, 9]
    assert mesh.cell_tags["gmsh:geometrical"].tolist() == [1, 2]
    wall = np.flatnonzero(mesh.face_tags["gmsh:physical"] == 7)
    ends = sorted(mesh.points[mesh.face_pairs[wall]].mean(axis=1).tolist())
    assert ends == [[0.5, 0], [1.5, 0]]
    assert mesh.repairs == {
        "lower-dimensional cells dropped": 1,
        "lower-dimensional cells kept as face tags": 2,
        "orphan points dropped": 1,
        "clockwise cells reversed": 1,
    }


def test_mesh_says_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bad.vtk"
    file.write_text("# vtk DataFile Version 3.0\nno\nASCII\nDATASET STRUCTURED_GRID\nPOINTS x float\n")
    with pytest.raises(FileError, match=r"bad.vtk: meshlane cannot read it"):
        read(file)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("keep", [15, 120, 200, 235, 250])
def test_truncated(tmp_path: Path, keep: int) -> None:
    file = tmp_path / "cut.msh"
    file.write_text(GMSH[:keep])
    with pytest.raises(AggloError, match=r"cut.msh: truncated"):
        read(file)


@pytest.mark.slow
def test_readers_that_never_end_are_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """meshlane's TetGen reader loops for ever on a file of comments."""
    monkeypatch.setattr("agglo_core.io.foreign.meshlane._SECONDS", 2)
    for suffix in (".node", ".ele"):
        (tmp_path / f"a{suffix}").write_text("# nothing\n")
    with pytest.raises(FileError, match="processor time"):
        Meshlane().read(tmp_path / "a.ele")


@pytest.mark.parametrize("suffix", [".vtk", ".obj"])
def test_polygons_round_trip(tmp_path: Path, suffix: str) -> None:
    mesh = Mesh.from_polygons(POINTS, [[0, 1, 2, 3], [1, 4, 2], [4, 5, 2]])
    write(tmp_path / f"m{suffix}", mesh)
    back = read(tmp_path / f"m{suffix}")
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures)
    assert back.n_faces == mesh.n_faces


def test_levels_in_legacy_vtk(tmp_path: Path) -> None:
    mesh = Mesh.from_polygons(POINTS, [[0, 1, 2, 3], [1, 4, 2], [4, 5, 2]])
    levels = [np.array([0, 1, 1]), np.array([0, 0, 0])]
    write(tmp_path / "m.vtk", mesh, Hierarchy(mesh, mesh.graph, levels, [{}, {}], True, {}))
    back, hierarchy = read_hierarchy(tmp_path / "m.vtk")
    assert hierarchy is not None
    assert hierarchy.nested
    assert back.cell_tags == {}
    assert [labels.tolist() for labels in hierarchy.levels] == [[0, 1, 1], [0, 0, 0]]


def test_earlier_levels_are_replaced_and_other_data_counted(tmp_path: Path) -> None:
    tags = {"level_0": [5, 6, 7], "level_4": [0, 0, 0], "id": [1, 2, 3]}
    mesh = Mesh.from_polygons(POINTS, [[0, 1, 2, 3], [1, 4, 2], [4, 5, 2]], cell_tags=tags)
    write(tmp_path / "m.vtk", mesh, Hierarchy(mesh, mesh.graph, [np.array([0, 1, 1])], [{}], True, {}))
    back, hierarchy = read_hierarchy(tmp_path / "m.vtk")
    assert hierarchy is not None
    assert [labels.tolist() for labels in hierarchy.levels] == [[0, 1, 1]]
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {"id": [1, 2, 3]}
    assert back.repairs == {}
    cells = [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))]
    data = {"u": [np.array([0.5, 1.5])], "v": [np.ones((2, 3))], "id": [np.array([4, 5])]}
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    meshlane.Mesh(points, cells, cell_data=data).write(tmp_path / "real.vtk")
    real = read(tmp_path / "real.vtk")
    assert list(real.cell_tags) == ["id"]
    assert real.repairs == {"cell data that are not integers left out": 2}


def test_tetrahedra_round_trip(tmp_path: Path) -> None:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    cells = polyhedra_from_elements({"tetra": [[0, 1, 2, 3], [1, 2, 3, 4]]})
    mesh = Mesh.from_polyhedra(points, cells)
    write(tmp_path / "t.msh", mesh)
    back = read(tmp_path / "t.msh")
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures)
    assert back.n_faces == 7
    assert (tmp_path / "t.msh").read_bytes().startswith(b"$MeshFormat\n4.1 0 8")


def test_losses_are_refused(tmp_path: Path) -> None:
    pentagon = Mesh.from_polygons([[0, 0], [2, 0], [2, 1], [1, 2], [0, 1]], [[0, 1, 2, 3, 4]])
    triangle = Mesh.from_polygons([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], cell_tags={"mat": [3]})
    x, y = np.meshgrid(np.arange(4), np.arange(4))
    corner = (4 * np.arange(3)[:, None] + np.arange(3)).ravel()
    grid = Mesh.from_polygons(
        np.stack((x.ravel(), y.ravel()), axis=1), corner[:, None] + np.array([0, 1, 5, 4])
    )
    ring = grid.coarsen([0, 0, 0, 0, 1, 0, 0, 0, 0])
    for mesh, name in ((pentagon, "p.mesh"), (triangle, "t.stl"), (triangle, "t.mesh"), (ring, "r.vtk")):
        with pytest.raises(FileError, match=rf"{name}: .*\.vtu and \.npz"):
            write(tmp_path / name, mesh)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("suffix", [".avs", ".inp", ".dat", ".tec"])
@pytest.mark.parametrize("lost", [1, 2])
def test_a_last_number_that_may_have_lost_digits_is_refused(suffix: str, lost: int, tmp_path: Path) -> None:
    file = tmp_path / f"cut{suffix}"
    write(file, samples.random_triangles(20, seed=1))
    file.write_bytes(file.read_bytes()[:-lost])
    with pytest.raises(AggloError, match="its last number may be incomplete"):
        read(file)
