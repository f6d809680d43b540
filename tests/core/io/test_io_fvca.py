"""FVCA's .typ1 and .typ2: exact meshes of small files, round trips, what is refused and how it is said."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from agglo_core import (
    FileError,
    Hierarchy,
    MeshError,
    agglomerate,
    read,
    read_hierarchy,
    samples,
    write,
)
from agglo_core.files.text_numbers import integers, reals
from agglo_core.io.text.counted_lists import locate_lists, locate_solids

POINTS = "Vertices\n6\n0 0\n1 0\n1 1\n0 1\n2 0\n2 1\n"
TYP2 = POINTS + "cells\n2\n4 1 2 3 4\n4 2 5 6 3\n"
TYP1 = (
    POINTS.lower()
    + "triangles\n2\n1 2 3\n1 3 4\nquadrangles\n1\n2 5 6 3\n"
    + "edges of the boundary\n1\n1 2\nall edges\n1\n1 2 1 0\n"
)


def put(folder: Path, text: str, name: str = "m.typ2") -> Path:
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize("title", ["cells", " Cells ", "Control volumes", "control  volumes:"[:-1]])
def test_both_dialects_are_read(tmp_path: Path, title: str) -> None:
    mesh = read(put(tmp_path, TYP2.replace("cells", title)))
    assert mesh.cell_measures.tolist() == [1, 1]
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]
    assert (mesh.face_cells[:, 1] >= 0).sum() == 1
    assert mesh.name == "m"


def test_layout_does_not_matter(tmp_path: Path) -> None:
    """Fortran breaks long lines and writes exponents with D; centres may follow."""
    text = TYP2.replace("4 2 5 6 3", "4 2 5\r\n   6 3").replace("1 0\n", "0.1D+01 0.d0\n")
    mesh = read(put(tmp_path, text + "centers\n 0.5 0.5\n 1.5 0.5\n"))
    assert mesh.cell_measures.tolist() == [1, 1]


def test_every_kind_of_typ1_is_read(tmp_path: Path) -> None:
    mesh = read(put(tmp_path, TYP1, "m.typ1"))
    assert mesh.cell_measures.tolist() == [0.5, 0.5, 1]
    assert read(put(tmp_path, TYP1, "other.txt")).n_cells == 3  # by its content


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("Vertices", "Points", "line 1: unknown section 'points'"),
        ("Vertices\n", "", "does not begin with the title 'Vertices'"),
        ("\n6\n", "\n7\n", "line 1: 7 points are declared, but 12 coordinates follow, expected 14"),
        ("\n6\n", "\n-1\n", "line 1: expected the number of vertices"),
        ("\n6\n", "\n1e300\n", "line 1: expected the number of vertices"),
        ("2 1\n", "2 x\n", "line 8: unknown section 'x'|line 8: expected a number, found 'x'"),
        ("2 1\n", "2 1,5\n", "line 8: expected a number, found '1,5'"),
        ("4 2 5 6 3", "4 2 5.5 6 3", "line 12: expected a whole number, found '5.5'"),
        ("4 2 5 6 3", "4 2 5 6", r"line 9: cell 1 \(of 2, counted from 0\) is longer than"),
        ("4 2 5 6 3", "0 2 5 6 3", r"line 9: cell 1 \(of 2, counted from 0\) is longer .*, or empty"),
        ("4 2 5 6 3", "4 2 5 6 3 9", "line 9: 2 cells take 10 numbers, but 11 follow"),
        ("4 2 5 6 3", "4 2 5 7 3", "line 9: cell 1 of 'cells' uses point 7, expected 1 to 6"),
        ("4 2 5 6 3", "4 2 5 99999999999999999999 3", "line 12: it holds a number too large for an int64"),
        ("cells\n2\n", "cells\n123456789012345\n", r"cell 2 \(of 123456789012345"),
        ("cells", "centers", "no section of cells.*found 'vertices', 'centers'"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in TYP2
    with pytest.raises(FileError, match=f"m.typ2: .*({says})"):
        read(put(tmp_path, TYP2.replace(old, new, 1)))


def test_cells_are_checked_as_ever(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"m.typ2: cell 1: a boundary that crosses itself"):
        read(put(tmp_path, TYP2.replace("4 2 5 6 3", "4 2 6 5 3")))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_written_comes_back_to_the_last_bit(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = samples.voronoi(200, seed=seed)
    tags = {"mat": rng.integers(-3, 3, 200), 'a "name"\n of\tits own': rng.integers(-(2**62), 2**62, 200)}
    mesh = replace(mesh, cell_tags=tags)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(20, 4))
    write(tmp_path / "m.typ2", mesh, hierarchy)
    back, found = read_hierarchy(tmp_path / "m.typ2")
    assert np.array_equal(back.points, mesh.points)
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() == 0
    write(tmp_path / "again.typ2", read(tmp_path / "m.typ2"))
    assert (tmp_path / "again.typ2").read_bytes() == (tmp_path / "m.typ2").read_bytes()
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
        name: tag.tolist() for name, tag in tags.items()
    }
    assert found is not None
    assert [level.tolist() for level in found.levels] == [level.tolist() for level in hierarchy.levels]
    for i in range(2):
        coarse = read(tmp_path / f"m_level{i}.typ2")
        np.testing.assert_allclose(coarse.cell_measures, hierarchy.mesh(i).cell_measures, rtol=1e-12)


def test_what_cannot_be_held_is_refused(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(FileError, match=r"\.typ2 needs a 2-D mesh, given a 3-D one"):
        write(tmp_path / "m.typ2", samples.boxes(2))
    with pytest.raises(FileError, match=r"m.typ1: a \.typ1 file can be read but not written"):
        write(tmp_path / "m.typ1", samples.squares(2))
    write(tmp_path / "faces.typ2", samples.squares(2).with_face_tags(inlet=lambda x: x[:, 0] == 0))
    assert "face tags left out, which .typ2 cannot hold: inlet" in caplog.text
    (tmp_path / "faces.typ2").unlink()
    mesh = samples.squares(3)
    around = [0 if i != 4 else 1 for i in range(9)]
    with pytest.raises(FileError, match=r"cell 0 has several boundary loops \(a hole\)"):
        write(tmp_path / "m.typ2", mesh.coarsen(around))
    hierarchy = Hierarchy(mesh, mesh.graph, [np.array(around)], [{}], True, {})
    write(tmp_path / "m.typ2", mesh, hierarchy)
    assert "m_level0.typ2 is not written: cell 0 has several boundary loops" in caplog.text
    assert sorted(each.name for each in tmp_path.iterdir()) == ["m.typ2"]
    assert read_hierarchy(tmp_path / "m.typ2")[1] is not None


def test_broken_tags_are_refused(tmp_path: Path) -> None:
    text = TYP2 + 'cell data "mat"\n2\n7 8\n'
    assert read(put(tmp_path, text)).cell_tags["mat"].tolist() == [7, 8]
    for old, new, says in (
        (
            'cell data "',
            'cell data: 2\ncell data "',
            "line 16: 2 cell data are declared, but 1 found: truncated",
        ),
        ("7 8\n", "7", "m.typ2: line 15: the last line has no line break"),
        ("7 8", "7", "'mat' has 1 values for 2 cells"),
        ("\n2\n7 8", "\n3\n7 8 9", "'mat' has 3 values"),
        ('"mat"', '"mat', "line 13: expected a quoted name"),
    ):
        with pytest.raises(FileError, match=says):
            read(put(tmp_path, text.replace(old, new)))


# -- records and numbers -------------------------------------------------------------------------


@given(st.lists(st.lists(st.integers(0, 99), min_size=1, max_size=70), max_size=60), st.integers(0, 2))
def test_lists_are_found_as_one_by_one(lists: list[list[int]], ahead: int) -> None:
    stream = np.array([word for row in lists for word in (*([7] * ahead), len(row), *row)], np.int64)
    offsets, places, used = locate_lists(stream, len(lists), ahead)
    assert used == len(stream)
    assert [stream[places[a:b]].tolist() for a, b in pairwise(offsets)] == lists


@pytest.mark.parametrize("longest", [3, 400, 90_000])
def test_lists_are_found_across_windows(longest: int) -> None:
    rng, n = np.random.default_rng(longest), 400 if longest < 1000 else 40
    sizes = rng.integers(1, longest + 1, n)
    rows = [rng.integers(0, 10**6, size) for size in sizes]
    stream = np.concatenate([part for row in rows for part in ([len(row)], row)])
    offsets, places, used = locate_lists(stream, n)
    assert np.diff(offsets).tolist() == sizes.tolist()
    assert np.array_equal(stream[places], np.concatenate(rows))
    with pytest.raises(FileError, match=rf"cell {n - 1} \(of {n}"):
        locate_lists(stream[:-1], n)
    assert locate_lists(stream, n - 1)[2] == used - 1 - sizes[-1]


@pytest.mark.parametrize("ahead", [0, 1])
@pytest.mark.parametrize("n", [1, 5000])
def test_lists_of_lists_are_found_as_one_by_one(n: int, ahead: int) -> None:
    rng = np.random.default_rng(n)
    cells = [
        [rng.integers(0, 50, rng.integers(3, 8)).tolist() for _ in range(rng.integers(4, 9))]
        for _ in range(n)
    ]
    head = [9] * ahead
    stream = np.array(
        [w for cell in cells for w in (*head, len(cell), *(v for f in cell for v in (*head, len(f), *f)))]
    )
    cell_offsets, loop_offsets, places, used = locate_solids(stream, n, ahead)
    assert used == len(stream)
    assert np.diff(cell_offsets).tolist() == [len(cell) for cell in cells]
    assert np.diff(loop_offsets).tolist() == [len(face) for cell in cells for face in cell]
    assert stream[places].tolist() == [v for cell in cells for face in cell for v in face]
    for cut in (1, 2, 5):
        with pytest.raises(FileError, match=rf"cell {n - 1} \(of {n}"):
            locate_solids(stream[:-cut], n, ahead)


def test_numbers_of_a_part_of_a_text() -> None:
    text = b"x 1 2\n 3.5 nan\n-4"
    assert reals(text, 1).tolist()[:3] == [1, 2, 3.5]
    assert integers(text, 15).tolist() == [-4]
    assert integers(b" \n").tolist() == reals(b"").tolist() == []
    with pytest.raises(FileError, match=r"line 2: expected a whole number, found '3.5'"):
        integers(text, 2)
