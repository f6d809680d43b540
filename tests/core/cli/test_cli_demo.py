"""``agglo demo``: what it prints, the files it leaves, and that one bad bisector does not stop it."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Agglo
from vtu_by_hand import cell_data_of

from agglo_core import Mesh, agglomerate, io, samples
from agglo_core.errors import MeshError
from agglo_core.graph import Graph
from agglo_core.registry import Component, default, hookimpl


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ring stands in for the brain."""
    monkeypatch.setattr(samples, "brain", lambda: samples.ring(16))


@pytest.fixture
def few(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two bisectors and a ring."""
    demo = importlib.import_module("agglo_core.cli.commands.demo")
    monkeypatch.setattr(demo, "_bisectors", lambda quiet, solid: ["kmeans", "inertial"])


class Wrong:
    """A bisector that fails on any mesh."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> np.ndarray:
        raise MeshError("not today")


@pytest.fixture
def wrong(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(__import__("sys").modules, "wrong_home", SimpleNamespace(Wrong=Wrong))
    good = Component(kind="bisector", name="wrong", target="wrong_home:Wrong")
    lame = Component(kind="bisector", name="lame", target="wrong_home:Wrong", requires=("no_such_module",))
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: [good, lame])), "wrong")
    yield
    default().unregister("wrong")


def active() -> list[str]:
    return [record.name for record in default().list() if record.kind == "bisector" and record.state == "ok"]


def test_every_bisector_leaves_its_files(agglo: Agglo, small: None, wrong: None, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    code, out, err = agglo("demo")
    assert code == 0
    assert "note: left out lame: it needs no_such_module" in err
    assert "not today" in out
    assert "report.html in a browser" in out
    assert all(name in out for name in active())
    left = {file.name for file in (tmp_path / "agglo-demo").iterdir()}
    good = [name for name in active() if name != "wrong"]
    meshes = {
        f"{name}{end}" for name in good for end in (".vtu", "_level0.vtu", "_level1.vtu", "_level2.vtu")
    }
    assert left == {"report.html", "boxplots.png", "mesh.png", *(f"{name}.png" for name in good), *meshes}


def test_sizes_are_shares_of_the_diameter(agglo: Agglo, few: None, tmp_path: Path) -> None:
    code, out, _ = agglo("demo", "-o", "here", "--diameter-fraction", "0.3", "--json")
    assert code == 0
    data = json.loads(out)
    diameter = samples.ring(16).graph.diameters()[0]
    assert data["runs"][0]["bisector"] == "kmeans"
    for run in data["runs"]:
        targets = [level["target"] for level in run["levels"]]
        assert targets == pytest.approx([0.3 * diameter, 0.6 * diameter])  # 1.2 D is one agglomerate
        for level in run["levels"]:
            assert level["connected"] == 1
            assert level["max_diameter"] <= level["target"] * (1 + 1e-9)
    assert all(Path(file).is_file() for file in data["files"])
    _, stored = io.read_hierarchy(tmp_path / "here" / "kmeans.vtu")
    assert stored is not None
    coarse = cell_data_of(tmp_path / "here" / "kmeans_level0.vtu")
    assert coarse["UF"].mean() == pytest.approx(data["runs"][0]["levels"][0]["UF"])
    assert [level.max() + 1 for level in stored.levels] == [
        level["parts"] for level in data["runs"][0]["levels"]
    ]


def test_without_matplotlib_it_says_so(agglo: Agglo, few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    demo = importlib.import_module("agglo_core.cli.commands.demo")
    monkeypatch.setattr(demo, "find_spec", lambda name: None)
    code, _, err = agglo("demo")
    assert code == 0
    assert "matplotlib is not installed" in err
    assert not list(Path("agglo-demo").glob("*.png"))
    assert Path("agglo-demo/report.html").exists()


def test_an_earlier_demo_is_replaced_and_other_files_stay(agglo: Agglo, few: None) -> None:
    Path("agglo-demo").mkdir()
    Path("agglo-demo/mine.txt").write_text("mine")
    Path("agglo-demo/report.html").write_text("old")
    assert agglo("demo", "--quiet") == (0, "", "")
    assert Path("agglo-demo/mine.txt").read_text() == "mine"
    assert Path("agglo-demo/report.html").read_text() != "old"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "taken"], "taken is a file"),
        (["-o", "absent/deep"], "there is no folder absent"),
        (["--diameter-fraction", "0"], "0"),
        (["--diameter-fraction", "1.5"], "1.5"),
        (["--diameter-fraction", "nan"], "nan"),
        (["--diameter-fraction", "x"], "'x'"),
        (["extra"], "extra"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    agglo: Agglo, tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "taken").touch()
    code, out, err = agglo("demo", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert [each.name for each in tmp_path.iterdir()] == ["taken"]


def test_the_brain_of_the_demo(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [name for name in active() if name in ("kmeans", "metis")]
    monkeypatch.setattr(
        importlib.import_module("agglo_core.cli.commands.demo"), "_bisectors", lambda quiet, solid: names
    )
    code, out, _ = agglo("demo", "--json", "--quiet")
    assert code == 0
    data = json.loads(out)
    assert data["mesh"]["cells"] > 10_000
    for run in data["runs"]:
        for level in run["levels"]:
            assert level["connected"] == 1
            assert level["max_diameter"] <= level["target"] * (1 + 1e-9)
    assert data["files"][0].endswith("report.html")


def test_bisectors_can_be_chosen(agglo: Agglo, small: None, tmp_path: Path) -> None:
    code, out, _ = agglo("demo", "--bisector", "inertial,kmeans:iterations=5", "--json")
    assert code == 0
    data = json.loads(out)
    assert [run["bisector"] for run in data["runs"]] == ["inertial", "kmeans:iterations=5"]
    names = {file.name for file in (tmp_path / "agglo-demo").iterdir()}
    assert {"inertial.vtu", "kmeans_iterations_5.vtu", "kmeans_iterations_5_level0.vtu"} <= names
    assert agglo("demo", "--bisector", "kmean").err.count("did you mean 'kmeans'?") == 1


@pytest.mark.slow
def test_a_brain_in_voxels_with_tissues_apart(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    head = samples.brain3d(12)
    monkeypatch.setattr(samples, "brain3d", lambda: head)
    code, out, err = agglo("demo", "--3d", "--bisector", "kmeans", "--json")
    assert (code, err) == (0, "")
    data = json.loads(out)
    assert data["mesh"]["name"] == "brain3d 12 mm"
    names = {Path(file).name for file in data["files"]}
    assert names >= {"report.html", "boxplots.png", "kmeans.png", "kmeans.vtu", "kmeans_level0.vtu"}
    assert all(Path(file).is_file() for file in data["files"])
    mesh, stored = io.read_hierarchy("agglo-demo/kmeans.vtu")
    assert stored is not None
    tissue = mesh.cell_tags["tissue"]
    for labels in stored.levels:
        pairs = np.unique(np.stack((labels, tissue)), axis=1)
        assert pairs.shape[1] == labels.max() + 1


def test_a_wave_of_excitation(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    square = samples.triangles(10)
    section = Mesh.from_polygons(60.0 * square.points - (70.0, 20.0), square.cells, name="section")
    monkeypatch.setattr(samples, "brain", lambda: section)
    model = importlib.import_module("agglo_core.cli.solving.electrophysiology")
    monkeypatch.setattr(model, "T_END", 20.0)
    monkeypatch.setattr(model, "PICTURE", 10.0)
    code, out, _ = agglo("demo", "--electrophysiology", "--json")
    assert code == 0
    data = json.loads(out)
    assert [Path(file).name for file in data["files"]] == [
        "report.html", "triangles.vtu", "agglomerates.vtu", "wave.png", "wave.gif"
    ]  # fmt: skip
    assert all(Path(file).is_file() for file in data["files"])
    runs = data["runs"]
    assert [(run["mesh"], run["degree"]) for run in runs] == [
        (mesh, degree) for degree in (1, 2, 3) for mesh in ("triangles", "agglomerates")
    ]
    assert all(run["steps"] == 20 and run["iterations"] < 10 for run in runs)
    assert [run["unknowns"] for run in runs] == [
        run["cells"] * (run["degree"] + 1) * (run["degree"] + 2) // 2 for run in runs
    ]
    assert all(run["integral"] > 50.0 for run in runs)  # mm²


def test_conductivity_is_larger_along_fibres_of_white_matter() -> None:
    model = importlib.import_module("agglo_core.cli.solving.electrophysiology")
    square = samples.triangles(10)
    section = Mesh.from_polygons(60.0 * square.points, square.cells)
    mesh, kappa = model.brain_tissue(section)
    eigenvalues, directions = np.linalg.eigh(kappa)
    white = mesh.cell_tags["tissue"] == 2
    assert set(mesh.cell_tags["tissue"]) == {1, 2}
    np.testing.assert_allclose(eigenvalues[~white], 3.0)
    np.testing.assert_allclose(eigenvalues[white], np.broadcast_to([3.0, 15.0], (white.sum(), 2)))
    left = white & (abs(mesh.cell_centroids[:, 1] - 30.0) < 4.0) & (mesh.cell_centroids[:, 0] < 15.0)
    assert left.any()
    assert (abs(directions[left, 0, 1]) > 0.9).all()  # towards the nearest side
    hierarchy = agglomerate(mesh, n_parts=60, regions="tissue")
    coarse, means = model.on_agglomerates(hierarchy, kappa)
    np.testing.assert_allclose(coarse.cell_measures @ means[:, 0, 1], mesh.cell_measures @ kappa[:, 0, 1])


def test_the_wave_takes_no_options_of_the_other_demo(agglo: Agglo) -> None:
    for more in (["--3d"], ["--bisector", "kmeans"], ["--diameter-fraction", "0.2"]):
        code, _, err = agglo("demo", "--electrophysiology", *more)
        assert code == 2
        assert "--electrophysiology cannot be combined with --bisector, --3d or --diameter-fraction" in err


def test_bisectors_of_the_plane_are_left_out_of_a_solid(
    wrong: None, capsys: pytest.CaptureFixture[str]
) -> None:
    demo = importlib.import_module("agglo_core.cli.commands.demo")
    assert "kmeans" in demo._bisectors(False, True)
    said = capsys.readouterr().err
    assert "note: left out wrong: it does not promise 3d" in said
    assert "note: left out lame: it needs no_such_module" in said
    assert "wrong" in demo._bisectors(True)
