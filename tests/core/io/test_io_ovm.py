"""OpenVolumeMesh: exact small files, round trips, faults by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, MeshError, agglomerate, read, read_hierarchy, samples, write

TETRA = """OVM ASCII
Vertices
4
0 0 0
1 0 0
0 1 0
0 0 1
Edges
6
0 1
1 2
2 0
0 3
1 3
2 3
Faces
4
3 0 2 4
3 0 8 7
3 2 10 9
3 4 6 11
Polyhedra
1
4 0 3 5 7
"""


def put(folder: Path, text: str) -> Path:
    (folder / "m.ovm").write_text(text)
    return folder / "m.ovm"


@pytest.mark.parametrize(
    "text",
    [
        TETRA,
        TETRA.lower().replace("ovm ascii", "OVM ASCII"),
        TETRA.replace("Edges", "# edges\nEdges") + "Mesh_Property x\n",
    ],
)
def test_a_tetrahedron(tmp_path: Path, text: str) -> None:
    mesh = read(put(tmp_path, text))
    assert mesh.cell_measures == pytest.approx([1 / 6])
    assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert mesh.repairs == {}


def test_half_faces_seen_from_outside_are_turned(tmp_path: Path) -> None:
    mesh = read(put(tmp_path, TETRA.replace("4 0 3 5 7", "4 1 2 4 6")))
    assert mesh.cell_measures == pytest.approx([1 / 6])
    assert mesh.repairs == {"faces turned outward": 4}


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    mesh = samples.voronoi3d(40)
    mesh = replace(mesh, cell_tags={"mat": np.arange(40) - 5})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.ovm", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.ovm")
    assert levels is not None
    assert back.repairs == {}
    assert back.cell_tags["mat"].tolist() == mesh.cell_tags["mat"].tolist()
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-15
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert read(tmp_path / "m_level0.ovm").n_cells == 8


def test_a_written_tetrahedron_follows_the_rules_of_half_faces(tmp_path: Path) -> None:
    """Each half-face of a cell, walked along its half-edges, is seen counter-clockwise from inside."""
    write(tmp_path / "m.ovm", read(put(tmp_path, TETRA)))
    lines = (tmp_path / "m.ovm").read_text().split("\n")
    sections = {line: i for i, line in enumerate(lines) if line.isalpha()}
    rows = {
        name: [[float(x) for x in line.split()] for line in lines[i + 2 : i + 2 + int(lines[i + 1])]]
        for name, i in sections.items()
    }
    points, edges = np.array(rows["Vertices"]), np.array(rows["Edges"], int)
    for half in np.array(rows["Polyhedra"][0][1:], int):
        walked = [int(h) for h in rows["Faces"][half // 2][1:]]
        corners = points[[edges[h // 2][h % 2] for h in walked]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0]) * (1 - 2 * (half % 2))
        assert normal @ (points.mean(axis=0) - corners[0]) > 0


def test_a_plane_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="needs a 3-D mesh, given a 2-D one"):
        write(tmp_path / "m.ovm", samples.squares(2))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("OVM ASCII", "OVM BINARY", "does not begin with 'OVM ASCII'"),
        ("Edges\n6", "Edges\n7", "7 edges are declared, but 12 end"),
        ("0 0 1\nEdges", "0 0\nEdges", "4 points are declared, but 11 coordinates"),
        ("Faces\n4", "Faces\n5", "faces: cell 4"),
        ("3 0 2 4", "3 0 2 5", "half-edges of face 0 do not form"),
        ("3 0 2 4", "2 0 1", "face 0 has fewer than 3"),
        ("3 0 2 4", "3 0 2 44", r"outside 0\.\.11"),
        ("Faces", "Facets", "its sections are"),
        ("4 0 3 5 7", "4 0 3 5 9", r"outside 0\.\.7"),
        ("4 0 3 5 7", "3 0 3 5", "fewer than 4 faces"),
        ("4 0 3 5 7", "4 0 3 5 x", "line .*'x'"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises((FileError, MeshError), match=says):
        read(put(tmp_path, TETRA.replace(old, new)))
