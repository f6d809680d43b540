"""Polyhedra by their faces in .node and .ele; plane polygons in .off and .obj."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agglo_core import AggloError, agglomerate, read, read_hierarchy, samples, write
from agglo_core.files.text_numbers import words_per_line
from agglo_core.io.text.off_obj import Obj, Off
from agglo_core.io.text.regn_face import RegnFace

NODES = "# points\n4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n"
CELLS = "# faces of cells\n1 0\n0 4\n 0 3 0 2 1\n 1 3 0 1 3\n 2 3 1 2 3\n 3 3 2 0 3\n# end\n"
OFF = "OFF\n# a comment\n6 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n2 1 0\n4 0 1 2 3\n4 1 4 5 2\n"
OBJ = """# by hand
v 0 0 0
v 1.0e0 0 0
v 1 1 0
vt 0 0
v 0 1 0
v 2 0 0
v 2 1 0
g left
f 1/1/1 2/1/1 3//1 4
f 2 5 6 \\
-4
"""


def put(folder: Path, cells: str = CELLS, nodes: str = NODES) -> Path:
    (folder / "m.node").write_text(nodes)
    (folder / "m.ele").write_text(cells)
    return folder / "m.ele"


def test_polyhedra_by_their_faces(tmp_path: Path) -> None:
    put(tmp_path)
    for name in ("m.ele", "m.node"):
        mesh = read(tmp_path / name)
        assert mesh.cell_measures == pytest.approx([1 / 6])
        assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_numbers_from_one_on_separate_lines_are_read(tmp_path: Path) -> None:
    """Points on a line of their own, numbered from 1 on."""
    nodes = "4 3 0 1\n1 0 0 0 9\n2 1 0 0 9\n3 0 1 0 9\n4 0 0 1 9\n"
    cells = "1  0\n1  4\n1 3\n 1 3 2\n2 3\n 1 2 4\n3 3\n 2 3 4\n4 3\n 3 1 4\n"
    assert read(put(tmp_path, cells, nodes)).cell_measures == pytest.approx([1 / 6])


def test_files_of_tetgen_are_for_meshlane(tmp_path: Path) -> None:
    assert read(put(tmp_path, "1 4 0\n0 0 1 2 3\n")).cell_measures == pytest.approx([1 / 6])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("1 0\n", "1 2\n", "m.ele: 2 attributes per cell"),
        ("1 0\n", "2 0\n", r"m.ele: cell 1 \(of 2"),
        ("3 3 2 0 3", "3 3 2 0", r"m.ele: cell 0 \(of 1"),
        ("3 3 2 0 3", "3 3 2 0 3 3", "m.ele: 1 cells take 22 numbers, but 23 follow"),
        ("3 3 2 0 3", "3 3 2 0 4", r"m.ele: cell 0 uses points outside 0\.\.3"),
        ("3 3 2 0 3", "3 3 2 0 x", "m.ele: line .*: expected a whole number, found 'x'"),
        ("3 3 2 0 3", "3 3 2 0 1", "cell 0: the faces do not close"),
    ],
)
def test_faults_of_cells_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    put(tmp_path, CELLS.replace(old, new))
    with pytest.raises(AggloError, match=says):
        RegnFace().read(tmp_path / "m.ele")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("4 3 0 0", "5 3 0 0", "m.node: 5 points with 4 numbers each are declared, but 16 follow"),
        ("4 3 0 0", "4 1 0 0", r"m.node begins with \[4, 1, 0, 0\]"),
        ("4 3 0 0", "4 2 0 1", r"m.node has 2-D points, but m.ele has polyhedra"),
        ("\n3 0 0 1", "\n4 0 0 1", "numbered consecutively from 0 or 1"),
        ("\n3 0 0 1", "\n3 0 0 one", "m.node: line .*: expected a number, found 'one'"),
    ],
)
def test_faults_of_points_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    put(tmp_path, nodes=NODES.replace(old, new))
    with pytest.raises(AggloError, match=says):
        RegnFace().read(tmp_path / "m.ele")
    (tmp_path / "m.node").unlink()
    with pytest.raises(AggloError, match=r"companion file m\.node: no such file"):
        RegnFace().read(tmp_path / "m.ele")


def test_polyhedra_are_written_and_read_back(tmp_path: Path) -> None:
    mesh = samples.boxes(4)
    mesh = mesh.coarsen(agglomerate(mesh, bisector="coordinate", n_parts=20).levels[0])
    mesh = replace(mesh, cell_tags={"mat": np.arange(20) - 5})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.node", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.ele")
    assert back.cell_tags["mat"].tolist() == mesh.cell_tags["mat"].tolist()
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-15
    assert levels is not None
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    rows = [
        [int(word) for word in line.split()]
        for line in (tmp_path / "m_level1.partition").read_text().split("\n")
    ]
    assert [row[1:] for row in rows[:2]] == [
        np.flatnonzero(hierarchy.levels[1] == part).tolist() for part in (0, 1)
    ]
    assert [row[0] for row in rows[:2]] == np.bincount(hierarchy.levels[1]).tolist()
    assert read(tmp_path / "m_level0.node").n_cells == 8


# -- .off and .obj -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        OFF,
        OFF.replace("OFF\n", "OFF "),
        OFF.replace("OFF\n", "", 1),
        OFF.replace("4 0 1 2 3", "4 0 1 2 3 255 0 0").replace("4 1 4 5 2", "4 1 4 5 2 0 9 9"),
        OFF.replace("4 0 1 2 3", "4 0 1 2 3 0.5 1 1 0").replace("4 1 4 5 2", "4 1 4 5 2 0.1 .1 .1 0"),
    ],
)
def test_off(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.off").write_text(text)
    mesh = Off().read(tmp_path / "m.off")
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]


PLANE = [(0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (2, 1)]


@pytest.mark.parametrize(
    ("head", "more"),
    [
        ("COFF", " 255 0 0 255"),
        ("COFF", " 1 0.5 0"),
        ("NOFF", " 0 0 1"),
        ("CNOFF", " 0 0 1 0.1 0.2 0.3 1"),
        ("STOFF", " 0.5 0.25"),
        ("STCNOFF", " 0 0 1 9 9 9 9 0.5 0.25"),
        ("OFF", " 9 9 9"),
        ("OFF", ""),
    ],
)
@pytest.mark.parametrize("colours", [("", ""), (" 255 0 0", ""), ("", " 4"), (" .5 .5 .5 1", " 1 2 3")])
def test_off_with_colours_and_normals(tmp_path: Path, head: str, more: str, colours: tuple[str, str]) -> None:
    rows = "".join(f"{x} {y} 0{more}\n" for x, y in PLANE)
    text = f"{head}\n# a comment\n6 2 0\n\n{rows}4 0 1 2 3{colours[0]}\n4 1 4 5 2{colours[1]}\n"
    for name in ("m.off", "m.other"):  # by its suffix, and by its content
        (tmp_path / name).write_text(text)
        mesh = read(tmp_path / name)
        assert mesh.points.tolist() == [list(map(float, point)) for point in PLANE]
        assert mesh.cell_measures.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "COFF 3 1 0 0 0 0 9 9 9 1 0 0 9 9 9 0 1 0 9 9 9 3 0 1 2\n",
            "COFF needs one line for each of the 3 points",
        ),
        (
            "NOFF\n3 1 0\n0 0 0 0 0 1\n1 0 0\n0 1 0 0 0 1\n3 0 1 2\n",
            "NOFF needs one line for each of the 3 points",
        ),
        ("COFF\n3 1 0\n0 0 0 9\n1 0 0 9\n0 1 0 9\n4 0 1 2\n", "one line for each of the 1 faces"),
        ("4OFF\n3 1 0\n0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2\n", "does not begin with OFF"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n", "cell 0 uses point -1"),
    ],
)
def test_off_that_cannot_be_read(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "m.off").write_text(text)
    with pytest.raises(AggloError, match=rf"m\.off: .*{says}"):
        read(tmp_path / "m.off")


def test_obj(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ)
    mesh = Obj().read(tmp_path / "m.obj")
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.n_faces == 7


@pytest.mark.parametrize("suffix", [".off", ".obj"])
def test_polygons_are_written_and_read_back(tmp_path: Path, suffix: str) -> None:
    mesh = samples.voronoi(150, seed=5)
    mesh = replace(mesh, cell_tags={"mat": np.arange(150) % 7, "# odd\n": np.arange(150)})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(20, 4))
    file = tmp_path / f"m{suffix}"
    write(file, mesh, hierarchy)
    back, levels = read_hierarchy(file)
    assert np.array_equal(back.points, mesh.points)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() == 0
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
        name: tag.tolist() for name, tag in mesh.cell_tags.items()
    }
    assert levels is not None
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert read(tmp_path / f"m_level1{suffix}").n_cells == 4


@pytest.mark.parametrize(
    ("kind", "old", "new", "says"),
    [
        (Off, "0 1 0\n2 0", "0 1 1\n2 0", "a surface, which is not supported"),
        (Off, "6 2 0", "7 2 0", "takes?|longer|follow"),
        (Off, "6 2 0", "6 3 0", r"cell 2 \(of 3"),
        (Off, "6 2 0", "6 1e300 0", "expected the numbers of points"),
        (Off, "4 1 4 5 2", "4 1 4 5 6", "cell 1 uses point 6, but there are 6 points"),
        (Off, "OFF", "OFF BINARY", "as text"),
        (Obj, "v 0 1 0", "v 0 1 1", "a surface, which is not supported"),
        (Obj, "v 0 1 0", "v 0 1", r"have \[2, 3\] coordinates"),
        (Obj, "v 0 1 0", "v 0 x 0", "expected a number, found 'x'"),
        (Obj, "f 1/1/1", "f 0/1/1", "cell 0 uses point -1"),
        (Obj, "f 1/1/1", "f 1.5", "expected a whole number, found '1.5'"),
    ],
)
def test_faults_of_polygons_are_named(
    tmp_path: Path, kind: type[Off | Obj], old: str, new: str, says: str
) -> None:
    text = OFF if kind is Off else OBJ
    assert old in text
    file = tmp_path / "m.txt"
    file.write_text(text.replace(old, new))
    with pytest.raises(AggloError, match=says):
        kind().read(file)


def test_words_are_counted_line_by_line() -> None:
    assert words_per_line(b"a  b\n\n c\td e \r\n1").tolist() == [2, 3, 1]
    assert words_per_line(b"").tolist() == words_per_line(b"\n \n").tolist() == []
