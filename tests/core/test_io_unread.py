"""Files that are known and not read: what the message says. Patches of OpenFOAM: their names are kept."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, read, write
from agglo_core.io.unread import why_unread
from agglo_core.problems import read_problem

RF = "# faces of cells\n1 0\n0 4\n 0 3 0 2 1\n 1 3 0 1 3\n 2 3 1 2 3\n 3 3 2 0 3\n"
NODES = "# points\n4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n"
UCD = "# made by hand\n4 2 0 0 0\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n1 1 tri 1 2 3\n2 1 tri 1 3 4\n"
OFF = "OFF\n# a comment\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
MSH2 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
5
1 0 0 0
2 2 0 0
3 2 1 0
4 1 2 0
5 0 1 0
$EndNodes
$Elements
1
1 34 2 1 1 5 1 2 3 4 5
$EndElements
"""
MSH4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Elements
2 3 1 3
2 1 2 2
1 34 2 34
2 2 3 4
2 1 34 1
3 5 1 2 3 4 5
$EndElements
"""


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("m.ele", RF, r"polyhedra as lists of faces .*not read yet; .*\.vtu.*Mesh.from_polyhedra"),
        ("m.node", NODES, "polyhedra as lists of faces"),
        ("m.inp", UCD, r"AVS UCD file.*rename it to \.avs"),
        ("m.off", OFF, r"OFF file with other cells than triangles.*\.obj"),
        ("m.msh", MSH2, "Gmsh file with polygons.*not read from it yet"),
        ("m.msh", MSH4, "Gmsh file with polygons"),
        ("m.mat", "MATLAB 5.0 MAT-file", r"MATLAB file.*scipy\.io\.loadmat"),
        ("m.foam", "", "OpenFOAM case without its mesh.*blockMesh"),
    ],
)
def test_what_is_not_read_says_what_it_is(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / "m.node").write_text(NODES)
    (tmp_path / "m.ele").write_text(RF)
    (tmp_path / name).write_text(text)
    assert re.match(rf"(is|holds) .*{says}", why_unread(tmp_path / name) or "")


def test_a_reader_that_fails_says_what_the_file_is(tmp_path: Path) -> None:
    (tmp_path / "m.node").write_text(NODES)
    (tmp_path / "m.ele").write_text(RF)
    with pytest.raises(FileError, match=r"m\.ele: holds polyhedra as lists of faces"):
        read(tmp_path / "m.ele")
    (tmp_path / "m.mat").write_text("MATLAB 5.0 MAT-file")
    with pytest.raises(FileError, match=r"m\.mat: is a MATLAB file.*expected one of \.vtu"):
        read(tmp_path / "m.mat")


def test_the_way_out_of_ucd_leads_somewhere(tmp_path: Path) -> None:
    (tmp_path / "m.avs").write_text(UCD.removeprefix("# made by hand\n"))
    assert read(tmp_path / "m.avs").cell_measures.tolist() == [0.5, 0.5]


@pytest.mark.parametrize(("name", "text"), [("m.ele", "2 2\n1 2\n1 2.5 3\n"), ("m.off", "OFF\n3 ² 0\n² ²\n")])
def test_numbers_that_are_none_explain_nothing(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert why_unread(tmp_path / name) is None
    with pytest.raises(FileError):
        read(tmp_path / name)


def test_what_is_only_broken_is_not_explained_away(tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n")
    (tmp_path / "m.msh").write_text(MSH2.replace(" 34 ", " 2 "))
    assert [why_unread(tmp_path / name) for name in ("m.off", "m.msh", "none.ele")] == [None] * 3
    with pytest.raises(FileError, match="meshlane cannot read it"):
        read(tmp_path / "m.off")


# -- OpenFOAM ----------------------------------------------------------------------------------

HEAD = "FoamFile\n{\n    version 2.0;\n    format ascii;\n    class list;\n}\n"
CUBES = {  # two unit cubes side by side
    "points": [f"({x} {y} {z})" for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)],
    "faces": [
        "4(1 4 10 7)",
        *("4(0 6 9 3)", "4(0 1 7 6)", "4(3 9 10 4)", "4(0 3 4 1)", "4(6 7 10 9)"),
        *("4(2 5 11 8)", "4(1 2 8 7)", "4(4 10 11 5)", "4(1 4 5 2)", "4(7 8 11 10)"),
    ],
    "owner": ["0"] * 6 + ["1"] * 5,
    "neighbour": ["1"],
}


def foam(folder: Path) -> Path:
    poly = folder / "constant" / "polyMesh"
    poly.mkdir(parents=True)
    for name, rows in CUBES.items():
        (poly / name).write_text(f"{HEAD}{len(rows)}\n(\n" + "\n".join(rows) + "\n)\n")
    patches = [
        f"{name}\n{{\n type patch;\n nFaces {count};\n startFace {start};\n}}"
        for name, (count, start) in {"inlet": (1, 1), "walls": (9, 2)}.items()
    ]
    (poly / "boundary").write_text(f"{HEAD}{len(patches)}\n(\n" + "\n".join(patches) + "\n)\n")
    (folder / "case.foam").touch()
    return folder / "case.foam"


def test_patches_of_openfoam_keep_their_names(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "agglo"):
        mesh = read(foam(tmp_path))
    np.testing.assert_allclose(mesh.cell_measures, [1, 1])
    assert "faces by name: inlet (1), walls (9)" in caplog.text
    (inlet,) = np.flatnonzero(mesh.face_tags["inlet"] == 1)
    vertices = mesh.face_vertices[mesh.face_offsets[inlet] : mesh.face_offsets[inlet + 1]]
    assert mesh.points[vertices].mean(axis=0).tolist() == [0, 0.5, 0.5]
    assert (mesh.face_tags["walls"] == 1).sum() == 9
    assert mesh.face_tags["walls"][mesh.face_cells[:, 1] >= 0].tolist() == [-1]
    write(tmp_path / "m.npz", mesh)
    back = read(tmp_path / "m.npz")
    assert {"inlet", "walls"} <= back.face_tags.keys()
    coarse = back.coarsen([0, 0])
    assert (coarse.face_tags["inlet"] == 1).sum() == 1


def test_patches_are_chosen_by_name(tmp_path: Path) -> None:
    mesh = read(foam(tmp_path))
    file = tmp_path / "p.toml"
    file.write_text('boundary = "cell_tags"\n[dirichlet]\ninlet = 2.0\n[neumann]\nwalls = 0.5\n')
    problem = read_problem(file, mesh)
    assert problem.dirichlet == {-1: 2.0}
    assert problem.neumann == {-2: 0.5}
    file.write_text('boundary = "cell_tags"\n[dirichlet]\noutlet = 2.0\n')
    with pytest.raises(FileError, match=r"'outlet' is not the value of a tag.*names: inlet, walls"):
        read_problem(file, mesh)


def test_compressed_cases_are_named(tmp_path: Path) -> None:
    case = foam(tmp_path)
    points = tmp_path / "constant" / "polyMesh" / "points"
    points.with_name("points.gz").write_bytes(gzip.compress(points.read_bytes()))
    points.unlink()
    with pytest.raises(FileError, match=r"compressed files \(points\.gz\).*gunzip"):
        read(case)
