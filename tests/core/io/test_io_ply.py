"""PLY: exact small files as text and binary, round trips, faults by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, MeshError, agglomerate, read, read_hierarchy, samples, write
from agglo_core.io.text.ply import Ply

TWO = """ply
format ascii 1.0
comment by hand
element vertex 6
property float x
property float y
property float z
property uchar red
element face 2
property uchar red
property list uchar int vertex_index
property int rock
property float quality
end_header
0 0 1 255
1 0 1 255
1 1 1 255
0 1 1 255
2 0 1 9
2 2 1 9
7 4 0 1 2 3 5 0.5
8 3 1 4 5 -6 0.25
"""


def put(folder: Path, content: str | bytes) -> Path:
    (folder / "m.ply").write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / "m.ply"


def binary(order: str) -> bytes:
    """The same mesh as :data:`TWO` with an edge element before the faces."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = TWO[: TWO.index("0 0 1 255")].replace("ascii", name)
    head = head.replace(
        "element face", "element edge 1\nproperty int vertex1\nproperty int vertex2\nelement face"
    )
    points = np.zeros(6, [("x", order + "f4", 3), ("red", "u1")])
    points["x"] = [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [2, 0, 1], [2, 2, 1]]
    rows = b""
    for corners, rock, quality in (([0, 1, 2, 3], 5, 0.5), ([1, 4, 5], -6, 0.25)):
        rows += bytes([7, len(corners)]) + np.array([*corners, rock], order + "i4").tobytes()
        rows += np.array([quality], order + "f4").tobytes()
    return head.encode() + points.tobytes() + np.array([0, 1], order + "i4").tobytes() + rows


@pytest.mark.parametrize("content", [TWO, binary("<"), binary(">"), TWO.replace("\n", "\r\n")])
def test_two_cells(tmp_path: Path, content: str | bytes) -> None:
    mesh = read(put(tmp_path, content))
    assert mesh.cell_measures.tolist() == [1, 1]
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"rock": [5, -6]}
    assert mesh.repairs["cell data that are not integers left out"] == 1


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    mesh = samples.voronoi(200, seed=4)
    mesh = replace(mesh, cell_tags={"a rock, 50 %": np.arange(200) - 5})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.ply", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.ply")
    assert levels is not None
    assert back.cell_tags["a rock, 50 %"].tolist() == mesh.cell_tags["a rock, 50 %"].tolist()
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-15
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert read(tmp_path / "m_level0.ply").n_cells == 8


def test_a_surface_is_refused_as_one(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"m\.ply: polygons in 3-D are a surface"):
        read(put(tmp_path, TWO.replace("2 2 1 9", "2 2 3 9")))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("element vertex 6", "element vertex 7", "a list|before the last|whole|longer"),
        ("element face 2", "element face 3", "longer than the rest"),
        ("element face 2", "element face 1", "7 numbers follow"),
        ("property float y", "property float w", "no coordinate y"),
        ("vertex_index", "corners", "no list vertex_indices"),
        ("format ascii", "format latin", "a line 'format latin"),
        ("property float quality", "property real quality", "of unknown type"),
        ("end_header", "end", "no header"),
        ("8 3 1 4 5 -6", "8 3 1 4 9 -6", "cell 1 uses point 9"),
        ("8 3 1 4 5 -6", "8 3 1 4 5 0.5", "'rock' must hold whole"),
        ("1 4 5 -6", "x 4 5 -6", "line .*'x'"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises((FileError, MeshError), match=says):
        Ply().read(put(tmp_path, TWO.replace(old, new)))


def test_numbers_of_more_than_32_bits_are_refused(tmp_path: Path) -> None:
    mesh = samples.squares(2).with_tags(big=np.full(4, 2**40))
    with pytest.raises(FileError, match="cell tag 'big'"):
        write(tmp_path / "m.ply", mesh)
    assert not (tmp_path / "m.ply").exists()
