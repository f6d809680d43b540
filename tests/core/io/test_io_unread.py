"""Files that are known and not read: what the message says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agglo_core import FileError, MeshError, read
from agglo_core.io.foreign.unread import why_unread

UCD = "# made by hand\n4 2 0 0 0\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n1 1 tri 1 2 3\n2 1 tri 1 3 4\n"
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


MSH1 = "$NOD\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$ENDNOD\n$ELM\n1\n1 2 1 0 3 1 2 3\n$ENDELM\n"


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("m.inp", UCD, r"AVS UCD file.*rename it to \.avs"),
        ("m.msh", MSH2, "Gmsh file with polygons.*not yet supported there"),
        ("m.msh", MSH4, "Gmsh file with polygons"),
        ("m.msh", MSH1, r"Gmsh file of version 1.*gmsh OLD\.msh -save .*deal\.II with"),
    ],
)
def test_what_is_not_read_says_what_it_is(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    assert re.match(rf"(is|holds) .*{says}", why_unread(tmp_path / name) or "")


@pytest.mark.usefixtures("forked_readers")
def test_the_way_out_of_ucd_leads_somewhere(tmp_path: Path) -> None:
    (tmp_path / "m.avs").write_text(UCD.removeprefix("# made by hand\n"))
    assert read(tmp_path / "m.avs").cell_measures.tolist() == [0.5, 0.5]


def test_what_is_only_broken_is_not_explained_away(tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_text(MSH2.replace(" 34 ", " 2 "))
    assert [why_unread(tmp_path / name) for name in ("m.msh", "none.inp")] == [None] * 2
    (tmp_path / "m.vtk").write_text("# vtk DataFile Version 3.0\nno\nASCII\nDATASET UNSTRUCTURED_GRID\n")
    with pytest.raises(FileError, match="it has no section POINTS"):
        read(tmp_path / "m.vtk")


@pytest.mark.usefixtures("forked_readers")
def test_polygons_in_avs_are_called_by_name(tmp_path: Path) -> None:
    (tmp_path / "m.avs").write_text("4 1 0 0 0\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n1 1 polygon 1 2 3 4\n")
    with pytest.raises(
        FileError, match=r"is an AVS UCD file with 'polygon' cells.*polygons are read from \.vtu"
    ):
        read(tmp_path / "m.avs")
    (tmp_path / "m.avs").write_text("4 1 0 0 0\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n1 1 quad 1 2 3 4\n")
    assert read(tmp_path / "m.avs").n_cells == 1


def test_surfaces_are_called_surfaces(tmp_path: Path) -> None:
    (tmp_path / "m.off").write_text("OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 1\n0 1 0\n4 0 1 2 3\n")
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 1\nv 0 1 0\nf 1 2 3 4\n")
    for name in ("m.off", "m.obj"):
        with pytest.raises(MeshError, match=rf"{name}: polygons in 3-D are a surface"):
            read(tmp_path / name)
