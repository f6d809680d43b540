"""cinolib's .hedra: exact small files, round trips, faults by name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, agglomerate, read, read_hierarchy, samples, write

TETRA = """4 4 1
0 0 0
1 0 0
0 1 0
0 0 1
3 1 3 2
3 1 2 4
3 2 3 4
3 1 3 4
4 1 2 3 -4
"""


def put(folder: Path, text: str) -> Path:
    (folder / "m.hedra").write_text(text)
    return folder / "m.hedra"


def test_a_tetrahedron(tmp_path: Path) -> None:
    mesh = read(put(tmp_path, TETRA))
    assert mesh.cell_measures == pytest.approx([1 / 6])
    assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    mesh = samples.boxes(4)
    mesh = mesh.coarsen(agglomerate(mesh, bisector="coordinate", n_parts=20).levels[0])
    mesh = replace(mesh, cell_tags={"mat": np.arange(20) - 5})
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.hedra", mesh, hierarchy)
    back, levels = read_hierarchy(tmp_path / "m.hedra")
    assert back.cell_tags["mat"].tolist() == mesh.cell_tags["mat"].tolist()
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-15
    assert levels is not None
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert read(tmp_path / "m_level0.hedra").n_cells == 8
    lines = (tmp_path / "m.hedra").read_text().split("\n")
    n_points, n_faces, n_cells = map(int, lines[0].split())
    cells = [[int(w) for w in line.split()[1:]] for line in lines[1 + n_points + n_faces :][:n_cells]]
    signs = np.zeros((n_faces, 2), int)
    for cell in cells:
        for face in cell:
            signs[abs(face) - 1, int(face < 0)] += 1
    assert (
        signs[:, 0] == 1
    ).all()  # each face is seen from outside by one cell, from inside by one at the most
    assert (signs[:, 1] == (mesh.face_cells[:, 1] >= 0)).all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("4 4 1", "4 4 0.5", r"begins with \[4\.0, 4\.0, 0\.5\], expected the numbers of points"),
        ("4 4 1", "40 4 1", "40 points are declared, but 33 coordinates follow"),
        ("4 4 1", "4 4 2", r"cells: cell 1 \(of 2"),
        ("3 1 3 4\n", "3 1 3 5\n", r"faces: entry 3 \(counted from 0\) uses point 5, expected 1 to 4"),
        ("4 1 2 3 -4", "4 1 2 3 -5", "cells: entry 0 .* uses face 5, expected 1 to 4"),
        ("4 1 2 3 -4", "4 1 2 3 -4 7", "1 cells take 5 numbers, but 6 follow"),
        ("4 1 2 3 -4", "4 1 2 3.5 -4", "must hold whole numbers"),
        ("0 0 1\n", "0 0 z\n", "line 5: expected a number, found 'z'"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in TETRA
    with pytest.raises(FileError, match=f"m.hedra: .*({says})"):
        read(put(tmp_path, TETRA.replace(old, new, 1)))


def test_plane_meshes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"\.hedra needs a 3-D mesh, given a 2-D one"):
        write(tmp_path / "m.hedra", samples.squares(2))
