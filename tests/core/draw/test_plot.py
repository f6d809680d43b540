"""Pictures: they are written whole or not at all, and neighbours differ in colour."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import samples
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.plot import draw, draw_mesh
from agglo_core.errors import FileError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure import measure_levels
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
    assert titles[:2] == ["squares 2x2, 4 cells", "run\n2 parts\nUF 1.00   CR 0.45"]
    assert titles[3] == "run\n2 parts\ncells 2.00   convexity 1.00   interface 1.00"


def test_what_was_measured_is_not_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, titles = samples.squares(2), []
    run = {"run": _halves(mesh)}
    measured = {"run": measure_levels(mesh, run["run"], metrics=["UF", "CR", "convexity", "J"])}
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    draw(mesh, run, tmp_path / "a.png")
    monkeypatch.setattr("agglo_core.draw.plot.measure_levels", None)
    draw(mesh, run, tmp_path / "b.png", levels=measured)
    assert titles[1] == titles[3] == "run\n2 parts\nUF 1.00   CR 0.45"
    draw(mesh, run, tmp_path / "c.png", ["UF", "CR", "convexity", "J"], levels=measured)
    assert titles[5] == "run\n2 parts\nUF 1.00   CR 0.45   convexity 1.00\nJ 0.76"


def test_a_picture_without_the_mesh_names_the_run_above_its_first_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titles: list[str] = []
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    mesh = samples.squares(2)
    draw(mesh, {"run": _halves(mesh, 2)}, tmp_path / "levels.png", fine=False)
    draw_mesh(mesh, tmp_path / "mesh.png")
    means = "2 parts\nUF 1.00   CR 0.45"
    assert titles == [f"run\n{means}", means, "squares 2x2, 4 cells"]


def test_a_picture_of_several_runs_has_the_mesh_once_and_explains_sizes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titles: list[str] = []
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    mesh = samples.squares(2)
    target = {"h_star": 1.25, "h_factor": 2.5}
    sized = Hierarchy(mesh, mesh.graph, [np.array([0, 0, 1, 1])], [target], nested=True)
    draw(mesh, {"one": _halves(mesh), "two": sized}, tmp_path / "runs.png")
    size = "diameter ≤ 1.25 =\xa02.5\xa0×\xa0largest\xa0cell"
    assert titles == [
        "squares 2x2, 4 cells",
        "one\n2 parts\nUF 1.00   CR 0.45",
        f"two\n2 parts\n{size}\nUF 1.00   CR 0.45",
    ]


@pytest.mark.parametrize("levels", [1, 2, 3, 5])
def test_titles_are_readable_on_a_page_and_keep_to_their_panels(tmp_path: Path, levels: int) -> None:
    """On a page of 700 pixels letters have 11 pixels, and columns of titles do not overlap."""
    figures: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agglo_core.draw.plot.save_figure", lambda figure, *_, **__: figures.append(figure))
        mesh = samples.squares(2)
        target = {"h_star": 0.0908, "h_factor": 2}
        many = Hierarchy(mesh, mesh.graph, [np.arange(4)] * levels, [target] * levels, nested=True)
        draw(mesh, {"one": many, "another": many}, tmp_path / "a.png")
    (figure,) = figures
    figure.draw_without_rendering()
    titles = [axis.title for axis in figure.axes if axis.title.get_text()]
    assert len(titles) == 1 + 2 * levels
    pixels = [title.get_fontsize() / 72 * 700 / figure.get_figwidth() for title in titles]
    assert min(pixels) > (11.0 if levels < 4 else 7.0)
    assert all(title.get_window_extent().y1 <= figure.bbox.height for title in titles)
    for row in (titles[1 : 1 + levels], titles[1 + levels :]):
        boxes = [title.get_window_extent() for title in row]
        assert all(left.x1 < right.x0 for left, right in pairwise(boxes))


def test_few_colours_serve_agglomerates_as_well(tmp_path: Path) -> None:
    from matplotlib.image import imread

    mesh = samples.voronoi(300, seed=5)
    labels = np.arange(300) % 7
    path = tmp_path / "picture.png"
    draw(mesh, {"seven": Hierarchy(mesh, mesh.graph, [labels], [{"parts": 7}], nested=True)}, path)
    picture = np.rint(255 * imread(path)[..., :3]).astype(int).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) <= 256
    used = colouring(mesh.coarsen(labels), len(PALETTE))
    tones = np.array([[int(tone[at : at + 2], 16) for at in (1, 3, 5)] for tone in PALETTE])
    for tone in tones[np.unique(used)]:
        assert np.abs(picture - tone).max(axis=1).min() <= 3


def test_edges_of_tiny_cells_are_not_drawn_inside_agglomerates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []
    monkeypatch.setattr(
        "agglo_core.draw.plane_panels._edges", lambda axis, mesh, *rest, **look: drawn.append(mesh.n_cells)
    )
    for n, expected in ((20, [400, 1, 400, 2]), (120, [14_400, 1, 2])):
        mesh = samples.squares(n)
        draw(mesh, {"run": _halves(mesh)}, tmp_path / "a.png")
        assert drawn == expected
        drawn.clear()


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
    with pytest.raises(OptionError, match="give at least one hierarchy"):
        draw(mesh, {}, tmp_path / "a.png")
    with pytest.raises(FileError, match=r"unknown picture format '\.bmpx'"):
        draw(mesh, run, tmp_path / "a.bmpx")
    with pytest.raises(FileError, match="cannot be written"):
        draw(mesh, run, tmp_path / "nowhere" / "a.png")
    with pytest.raises(FileError, match=r"folder\.png"):
        draw(mesh, run, tmp_path / "folder.png")
    assert [each.name for each in tmp_path.iterdir()] == ["folder.png"]
