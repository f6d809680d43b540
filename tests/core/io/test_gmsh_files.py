"""Gmsh 4.1 as it is written: groups by name, levels as data, what has no element refused."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, Mesh, agglomerate, read_hierarchy, samples, write

MESHES = {
    "triangles": lambda: samples.triangles(3),
    "quadrilaterals": lambda: samples.squares(3),
    "tetrahedra": lambda: samples.tetrahedra(2),
    "hexahedra": lambda: samples.boxes(2),
    "prisms": lambda: prisms(),
}


def prisms() -> Mesh:
    """Two prisms that share a quadrilateral."""
    points = [[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (0, 1), (1, 1))]
    bottom = [[0, 1, 2], [1, 3, 2]]
    cells = []
    for a, b, c in bottom:
        sides = [[a, b, b + 4, a + 4], [b, c, c + 4, b + 4], [c, a, a + 4, c + 4]]
        cells.append([[c, b, a], [a + 4, b + 4, c + 4], *sides])
    return Mesh.from_polyhedra(points, cells)


def tagged(mesh: Mesh) -> Mesh:
    rock = np.arange(mesh.n_cells) - 1
    mesh = mesh.with_tags(left=lambda x: x[:, 0] < 0.4, low=lambda x: x[:, 1] < 0.5, rock=rock)
    side = 2 * np.isclose(mesh.face_centroids[:, 1], 0)
    return mesh.with_face_tags(inlet=lambda x: np.isclose(x[:, 0], 0), side=side)


@pytest.mark.parametrize("name", MESHES)
def test_groups_and_levels_come_back(name: str, tmp_path: Path) -> None:
    mesh = tagged(MESHES[name]())
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=2)
    write(tmp_path / "m.msh", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.msh")
    assert levels is not None
    assert levels.levels[0].tolist() == hierarchy.levels[0].tolist()
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    for tag in ("left", "low", "rock"):
        assert back.cell_tags[tag].tolist() == mesh.cell_tags[tag].tolist()
    for ours, theirs in (("inlet", "inlet"), ("side", "side_2")):
        places = [
            sorted(each.face_centroids[each.face_tags[tag] > 0].round(9).tolist())
            for each, tag in ((mesh, ours), (back, theirs))
        ]
        assert places[0] == places[1]
        assert places[0]


def test_the_file_by_hand(tmp_path: Path) -> None:
    mesh = samples.squares(1).with_tags(**{"a rock": [True]}).with_face_tags(inlet=lambda x: x[:, 0] == 0)
    write(tmp_path / "m.msh", mesh)
    text = (tmp_path / "m.msh").read_text()
    assert '$PhysicalNames\n2\n2 1 "a rock"\n1 2 "inlet"\n$EndPhysicalNames\n' in text
    assert "$Entities\n0 1 1 0\n1 0.0 0.0 0.0 1.0 1.0 0.0 1 2 0\n1 0.0 0.0 0.0 1.0 1.0 0.0 1 1 0\n" in text
    assert "$Elements\n2 2 1 2\n2 1 3 1\n1 1 2 4 3\n1 1 1 1\n2 " in text


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        (samples.voronoi(20), r"cell \d+ is a polygon with \d+ corners; Gmsh files hold only triangles"),
        (samples.voronoi3d(5), "cell 0 is a polyhedron; Gmsh files hold only triangles"),
        (samples.squares(2).with_tags(**{'a "rock"': [1, 0, 1, 0]}), "cannot contain quotes"),
        (samples.squares(2).with_tags(big=np.full(4, 2**60)), "are doubles"),
    ],
)
def test_what_it_cannot_hold_is_refused(mesh: Mesh, says: str, tmp_path: Path) -> None:
    with pytest.raises(FileError, match=says):
        write(tmp_path / "m.msh", mesh)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", MESHES)
def test_gmsh_itself_opens_it(name: str, tmp_path: Path) -> None:
    if importlib.util.find_spec("gmsh") is None:
        pytest.skip("gmsh is not installed")
    import gmsh

    mesh = tagged(MESHES[name]())
    write(tmp_path / "m.msh", mesh)
    gmsh.initialize(["-v", "0"])
    try:
        gmsh.open(str(tmp_path / "m.msh"))
        groups = {gmsh.model.getPhysicalName(*each): each for each in gmsh.model.getPhysicalGroups()}
        assert {"left", "low", "inlet", "side_2"} <= groups.keys()
        for name, values in (("left", mesh.cell_tags["left"]), ("inlet", mesh.face_tags["inlet"])):
            dim, tag = groups[name]
            entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
            found = [gmsh.model.mesh.getElements(dim, each)[1] for each in entities]
            assert sum(len(each) for blocks in found for each in blocks) == values.sum()
    finally:
        gmsh.finalize()
