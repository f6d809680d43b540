"""Pictures: they are written whole or not at all, and neighbours differ in colour."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from agglo_core import samples
from agglo_core.draw.plot import colouring, draw
from agglo_core.errors import FileError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh

matplotlib = pytest.importorskip("matplotlib")


def _halves(mesh: Mesh, levels: int = 1) -> Hierarchy:
    labels = (mesh.local_centroids[:, 0] > 0).astype(int)
    return Hierarchy(mesh, mesh.graph, [labels] * levels, [{"parts": 2}] * levels, nested=True)


@pytest.mark.parametrize(
    "mesh", [samples.squares(9), samples.voronoi(2000, seed=1), samples.ring(40), samples.disconnected(5)]
)
def test_neighbours_differ_in_colour(mesh: Mesh) -> None:
    colours = colouring(mesh, 9)
    inner = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    assert (colours[inner[:, 0]] != colours[inner[:, 1]]).all()
    assert colours.min() >= 0
    assert colours.max() < 9


def test_a_crowded_neighbourhood_still_gets_colours() -> None:
    colours = colouring(samples.squares(4), 1)
    np.testing.assert_array_equal(colours, np.zeros(16))


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_draws_runs_with_different_numbers_of_levels(tmp_path: Path, suffix: str) -> None:
    mesh, path = samples.ring(12), tmp_path / f"picture{suffix}"
    draw(mesh, {"one": _halves(mesh), "a name longer than its panel is wide, by far": _halves(mesh, 2)}, path)
    head = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(head)
    assert list(tmp_path.iterdir()) == [path]


def test_titles_give_the_means_of_the_metrics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles: list[str] = []
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    mesh = samples.squares(2)
    draw(mesh, {"run": _halves(mesh)}, tmp_path / "a.png")
    draw(mesh, {"run": _halves(mesh)}, tmp_path / "a.png", ["cells", "convexity", "interface"])
    assert titles[1] == "2 parts\nUF 1.00   CR 0.45"
    assert titles[3] == "2 parts\ncells 2.00   convexity 1.00   interface 1.00"


def test_colours_fill_the_cells_and_leave_holes_open(tmp_path: Path) -> None:
    from matplotlib.image import imread

    mesh, path = samples.ring(60), tmp_path / "ring.png"
    draw(mesh, {"halves": _halves(mesh)}, path)
    picture = imread(path)[..., :3]
    height, width = picture.shape[:2]
    panel = picture[:, width // 2 :]
    coloured = np.ptp(panel, axis=2) > 0.1
    rows, columns = np.nonzero(coloured)
    middle = coloured[(rows.min() + rows.max()) // 2, (columns.min() + columns.max()) // 2]
    assert coloured.any()
    assert not middle
    assert len(np.unique(panel[coloured].round(2), axis=0)) >= 2
    assert height > 100


def test_no_pyplot_state_is_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    mesh = samples.squares(2)
    draw(mesh, {"run": _halves(mesh)}, tmp_path / "a.png")


def test_without_matplotlib_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    mesh = samples.squares(2)
    with pytest.raises(OptionError, match=r'pip install "agglo\[plot\]"'):
        draw(mesh, {"run": _halves(mesh)}, tmp_path / "a.png")


def test_what_cannot_be_drawn_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    mesh = samples.squares(2)
    run = {"run": _halves(mesh)}
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(OptionError, match="no hierarchy"):
        draw(mesh, {}, tmp_path / "a.png")
    with pytest.raises(FileError, match=r"no picture format '\.bmpx'"):
        draw(mesh, run, tmp_path / "a.bmpx")
    with pytest.raises(FileError, match="cannot be written"):
        draw(mesh, run, tmp_path / "nowhere" / "a.png")
    with pytest.raises(FileError, match=r"folder\.png"):
        draw(mesh, run, tmp_path / "folder.png")
    assert [each.name for each in tmp_path.iterdir()] == ["folder.png"]
