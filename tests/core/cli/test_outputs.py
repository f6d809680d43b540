"""No output costs another: what cannot be made is told, and all else is written."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Agglo

from agglo_core import io, samples
from agglo_core.errors import FileError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, default, hookimpl

DRAW, PAGE = "agglo_core.draw.plot.draw", "agglo_core.draw.webpage.write_page"
WRITE = "agglo_core.io.write"
SMALL = 16
"""Cells of the mesh that warms components up; the breakable ones below fail on larger meshes."""


class Moody:
    """Measures the warm-up alone."""

    better, bounds, homogeneity = "high", (0.0, 1.0), 0

    def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
        if mesh.n_cells > SMALL:
            raise RuntimeError("after an hour")
        return np.ones(labels.max() + 1)


class Weak:
    """Bisects the warm-up alone."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> np.ndarray:
        if graph.n > SMALL:
            raise RuntimeError("too much for me")
        return np.arange(graph.n) % 2


@pytest.fixture
def breakable(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    home = SimpleNamespace(Moody=Moody, Weak=Weak)
    monkeypatch.setitem(__import__("sys").modules, "breakable_home", home)
    offered = [
        Component("metric", "moody", "breakable_home:Moody"),
        Component("bisector", "weak", "breakable_home:Weak"),
    ]
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: offered)), "breakable")
    yield
    default().unregister("breakable")


def raising(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def levels(file: str) -> int:
    hierarchy = io.read_hierarchy(file)[1]
    assert hierarchy is not None
    return len(hierarchy.levels)


@pytest.mark.parametrize(
    "error",
    [
        FileError("a.png: cannot be written: No space left on device"),
        ImportError("no module named matplotlib"),
        MemoryError(),
        ValueError("a bug of a library"),
        SystemExit(1),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_picture_that_fails_costs_nothing_else(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(DRAW, raising(error))
    wanted = ["-o", "a.npz", "--plot", "a.png", "--report", "a.html", "--parts", "4"]
    code, out, err = agglo("run", "squares:n=8", *wanted, "--json")
    assert code == 3
    assert json.loads(out)["runs"][0]["levels"][0]["parts"] == 4
    assert (levels("a.npz"), Path("a.html").exists(), Path("a.png").exists()) == (1, True, False)
    assert [line for line in err.splitlines() if line.startswith("error: ")] == [err.splitlines()[-1]]
    assert "a.png" in err.splitlines()[-1]
    assert ("Traceback" in err) == (type(error) in (ValueError, SystemExit))


def test_every_failure_is_named_and_the_table_comes_first(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(DRAW, raising(OSError(28, "No space left on device")))
    monkeypatch.setattr(PAGE, raising(FileError("a.html: cannot be written")))
    code, out, err = agglo("run", "squares:n=8", "-o", "a.npz", "--plot", "a.png", "--report", "a.html")
    assert code == 3
    assert out.index("8 cells each") < out.index("wrote a.npz")
    assert "wrote a.png" not in out
    assert [line[: line.rindex(":")] for line in err.splitlines()[-2:]] == [
        "error: a.png: OSError",
        "error: a.html",
    ]


def test_results_are_written_before_anything_is_drawn(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(DRAW, raising(KeyboardInterrupt()))
    code, out, _ = agglo("run", "squares:n=8", "-o", "a.npz", "--plot", "a.png", "--parts", "8,4,2")
    assert (code, levels("a.npz")) == (130, 3)
    assert "8 parts" in out


def test_a_result_that_fails_costs_neither_table_nor_picture(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(WRITE, raising(FileError("a.vtu: No space left on device")))
    code, out, err = agglo("run", "squares:n=8", "-o", "a.vtu", "--plot", "a.png", "--parts", "4")
    assert (code, err.splitlines()[-1]) == (2, "error: a.vtu: No space left on device")
    assert "4 parts" in out
    assert Path("a.png").exists()


def test_a_metric_that_fails_costs_no_hierarchy(agglo: Agglo, breakable: None) -> None:
    code, out, err = agglo("run", "squares:n=8", "--metrics", "moody", "-o", "a.npz", "--parts", "4")
    assert (code, out, levels("a.npz")) == (2, "", 1)
    assert "warning: a.npz was written, but could not be measured" in err
    assert "after an hour" in err.splitlines()[-1]


def test_a_run_that_fails_costs_no_earlier_one(
    agglo: Agglo, breakable: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    two = ["--bisector", "inertial", "--bisector", "weak", "--parts", "4", "-o", "a.npz"]
    code, _, err = agglo("run", "squares:n=8", *two)
    assert (code, levels("a_inertial.npz")) == (2, 1)
    assert "too much for me" in err
    monkeypatch.setattr(WRITE, raising(FileError("a_inertial.npz: disk full")))
    errors = [line for line in agglo("run", "squares:n=8", *two).err.splitlines() if line[:5] == "error"]
    assert errors[0] == "error: a_inertial.npz: disk full"
    assert "too much for me" in errors[1]


def test_a_report_that_fails_does_not_hide_a_comparison(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PAGE, raising(FileError("a.html: cannot be written")))
    code, out, err = agglo("compare", "squares:n=8", "--bisector", "inertial", "--report", "a.html", "--json")
    assert (code, err) == (3, "error: a.html: cannot be written\n")
    assert json.loads(out)["runs"][0]["levels"]


def test_the_demo_leaves_what_it_can(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    mesh = samples.ring(16)
    monkeypatch.setattr(samples, "brain", lambda: mesh)
    monkeypatch.setattr("agglo_core.draw.boxplot.draw_boxes", raising(ValueError("no whiskers")))
    code, out, err = agglo("demo", "--bisector", "inertial", "--json")
    assert code == 3
    assert "error: agglo-demo/boxplots.png: ValueError: no whiskers" in err
    files = json.loads(out)["files"]
    assert files[0] == "agglo-demo/report.html"
    assert "agglo-demo/inertial.png" in files
    assert "agglo-demo/boxplots.png" not in files
    assert all(Path(file).is_file() for file in files)


@pytest.mark.parametrize(
    ("command", "flag"), [("run", "--plot"), ("run", "--report"), ("compare", "--report")]
)
def test_solids_have_pictures_as_plane_meshes_have(agglo: Agglo, command: str, flag: str) -> None:
    pytest.importorskip("matplotlib")
    picture = "a.png" if flag == "--plot" else "a.html"
    code, out, err = agglo(command, "boxes:n=3", "--bisector", "inertial", "--parts", "3", flag, picture)
    assert (code, err) == (0, "")
    assert f"wrote {picture}" in out
    assert Path(picture).stat().st_size > 10_000


def test_a_picture_of_a_solid_that_fails_costs_no_result(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    for made in (
        "agglo_core.draw.solids.panels.project_surface",
        "agglo_core.draw.webpage.stills.project_surface",
    ):
        monkeypatch.setattr(made, raising(MemoryError("so many pixels")))
    wanted = ["-o", "a.npz", "--plot", "a.png", "--report", "a.html", "--parts", "3"]
    code, out, err = agglo("run", "boxes:n=3", "--bisector", "inertial", *wanted)
    assert code == 3
    assert levels("a.npz") == 1
    assert "wrote a.npz" in out
    missing = [line for line in err.splitlines() if line.startswith("error: ")]
    assert missing == [f"error: a.{end}: MemoryError: so many pixels" for end in ("png", "html")]


def test_without_matplotlib_a_run_goes_on(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agglo_core.cli.output.files.find_spec", lambda name: None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    code, out, err = agglo("run", "squares:n=8", "--parts", "4", "-o", "a.npz", "--plot", "a.png")
    assert (code, levels("a.npz")) == (3, 1)
    assert "4 parts" in out
    first, *_, last = err.splitlines()
    assert first.startswith("warning: skipping --plot, which needs matplotlib: pip install 'agglo[plot]'")
    assert last.startswith('error: a.png: drawing needs matplotlib: pip install "agglo[plot]"')


def test_explode_is_for_pictures_of_solids(agglo: Agglo) -> None:
    pytest.importorskip("matplotlib")
    run = ["run", "boxes:n=2", "--bisector", "inertial", "--parts", "2"]
    assert agglo(*run, "--plot", "a.png", "--explode", "1.5").code == 0
    said = agglo(*run, "--explode", "1")
    assert (said.code, "--explode needs --plot" in said.err) == (2, True)
    said = agglo(*run, "--plot", "b.png", "--explode", "11")
    assert (said.code, "at least 0 and at most 10" in said.err) == (2, True)
    said = agglo("run", "squares:n=2", "--plot", "b.png", "--explode", "1")
    assert (said.code, "--explode applies to 3-D meshes; squares 2x2 is 2-D" in said.err) == (2, True)
    assert not Path("b.png").exists()


def test_what_can_be_known_is_refused_before_a_run(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr("agglo_core.agglomeration.one_call.agglomerate", raising(AssertionError("it ran")))
    os.mkfifo("a.png")
    for command in ("run", "solve"):
        done = agglo(command, "squares:n=4", "--plot", "a.png")
        assert (done.code, done.err) == (2, "error: a.png: exists and is not a regular file\n")


def test_files_are_compressed_on_request(agglo: Agglo) -> None:
    agglo("run", "squares:n=16", "--parts", "16", "-o", "plain.vtu")
    agglo("run", "squares:n=16", "--parts", "16", "-o", "small.vtu", "--compress")
    assert Path("small.vtu").stat().st_size < 0.5 * Path("plain.vtu").stat().st_size
    assert io.read("small.vtu").fingerprint == io.read("plain.vtu").fingerprint


def test_what_cannot_be_compressed_is_refused_before_a_run(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agglo_core.agglomeration.one_call.agglomerate", raising(AssertionError("it ran")))
    said = agglo("run", "squares:n=4", "--compress")
    assert (said.code, "--compress needs -o" in said.err) == (2, True)
    said = agglo("run", "squares:n=4", "-o", "a.typ2", "--compress")
    assert (said.code, "has no option 'compress'" in said.err) == (2, True)


def test_the_coarse_meshes_beside_a_file_are_printed(agglo: Agglo) -> None:
    _, out, _ = agglo("run", "squares:n=4", "--parts", "4,2", "-o", "a.vtu")
    assert "wrote a.vtu, and 2 coarse meshes in the same folder, starting with a_level0.vtu" in " ".join(
        out.split()
    )
    _, out, _ = agglo("run", "squares:n=4", "--parts", "4", "-o", "a.npz")
    assert out.endswith("wrote a.npz\n")


def test_a_file_is_no_sample_and_how_to_convert_it_is_said(agglo: Agglo) -> None:
    agglo("mesh", "squares:n=2", "-o", "a.off")
    code, _, err = agglo("mesh", "a.off", "-o", "b.vtu")
    assert code == 2
    assert "agglo.write('b.vtu', agglo.read('a.off'))" in err


@pytest.mark.parametrize(
    ("file", "arguments"),
    [
        ("in.vtu", "run in.vtu --parts 4 -o ./in.vtu"),
        ("in_kmeans.vtu", "run in_kmeans.vtu --parts 4 --bisector kmeans,sweep -o in.vtu"),
        ("in.vtu", "solve in.vtu -o in.vtu"),
        ("in.npz", "solve in.npz --write-system in.npz"),
        ("in.vtu", "run link.vtu --parts 4 -o in.vtu"),
        ("in.npz", "run in.npz --parts 4 -o link.npz"),
    ],
)
def test_the_input_file_is_not_replaced(agglo: Agglo, file: str, arguments: str) -> None:
    io.write(file, samples.squares(4))
    Path(f"link{Path(file).suffix}").symlink_to(file)
    before = Path(file).read_bytes()
    done = agglo(*arguments.split())
    assert (done.code, done.out) == (2, "")
    assert "is the input file, and would be replaced: choose another output file" in done.err
    assert Path(file).read_bytes() == before


def test_levels_are_added_to_the_case_that_is_read(agglo: Agglo) -> None:
    io.write("in.foam", samples.boxes(2))
    done = agglo("run", "in.foam", "--parts", "2", "-o", "in.foam")
    assert done.code == 0, done.err
    assert levels("in.foam") == 1


@pytest.mark.parametrize("suffix", ["npz", "vtu"])
def test_the_mesh_and_the_levels_of_a_file_are_drawn(
    agglo: Agglo, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    titles: list[str] = []
    monkeypatch.setattr("agglo_core.draw.plot._entitle", lambda axis, title: titles.append(title))
    agglo("run", "squares:n=4", "--parts", "4", "--bisector", "sweep", "-o", f"levels.{suffix}", "--quiet")
    io.write(f"mesh.{suffix}", samples.squares(4))
    for name, panels in (("levels", 2), ("mesh", 1)):
        titles.clear()
        done = agglo("quality", f"{name}.{suffix}", "--plot", f"{name}.png")
        assert (done.code, done.out.splitlines()[-1]) == (0, f"wrote {name}.png")
        assert Path(f"{name}.png").stat().st_size > 1000
        assert len(titles) == panels
    done = agglo("quality", f"mesh.{suffix}", "--plot", "mesh.gif")
    assert (done.code, done.out) == (2, "")
    assert "pictures end in .png" in done.err
