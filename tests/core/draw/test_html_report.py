"""The HTML report: what is inside the file."""

from __future__ import annotations

import base64
import hashlib
import html
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from report_data import EVIL, data_of, faces_of, made, named_ring, sectors, two_and_a_failure, unpacked

from agglo_core import samples
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.webpage import write_page
from agglo_core.draw.webpage.packing import differences, integers, reals, separate_bytes
from agglo_core.draw.webpage.sections import OWN
from agglo_core.errors import FileError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.agglomerates import measure_levels
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, Registry, hookimpl


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return named_ring()


@pytest.fixture(scope="module")
def runs(mesh: Mesh) -> list[RunResult]:
    return two_and_a_failure(mesh)


@pytest.fixture(scope="module")
def page(mesh: Mesh, runs: list[RunResult], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(path, mesh, runs, note="a <note>")
    assert list(path.parent.iterdir()) == [path]
    return path


def test_arrays_are_those_of_the_mesh_and_levels(page: Path, mesh: Mesh, runs: list[RunResult]) -> None:
    data = data_of(page)
    order = unpacked(data["order"])
    np.testing.assert_array_equal(np.sort(order), np.arange(mesh.n_cells))
    assert [len(run["levels"]) for run in data["runs"]] == [2, 0, 3]
    for run, shown in zip(runs, data["runs"], strict=True):
        for level, packed in zip(run.levels, shown["levels"], strict=True):
            np.testing.assert_array_equal(unpacked(packed["labels"]), level.labels[order])
            np.testing.assert_array_equal(unpacked(packed["colours"]), colouring(level.mesh, len(PALETTE)))
            for name, values in level.values.items():
                np.testing.assert_allclose(unpacked(packed["values"][name]), values, rtol=1e-6)
            assert packed["parts"] == level.mesh.n_cells


@pytest.mark.parametrize("mesh", [samples.ring(24), samples.voronoi(300, seed=4)], ids=str)
def test_faces_are_those_of_the_mesh_and_turn_the_same_way(mesh: Mesh, tmp_path: Path) -> None:
    write_page(tmp_path / "a.html", mesh, [made(mesh, "run", 4)])
    data = data_of(tmp_path / "a.html")
    shown, cells = faces_of(data)
    corner = mesh.local_points[np.unique(mesh.face_vertices)].min(axis=0)
    own = mesh.local_points[mesh.face_vertices].reshape(-1, 2, 2) - corner
    turned = cells[:, 0] > np.where(cells[:, 1] < 0, mesh.n_cells, cells[:, 1])
    shown[turned], cells[turned] = shown[turned][:, ::-1], cells[turned][:, ::-1]
    owned = np.array(mesh.face_cells)
    back = owned[:, 0] > np.where(owned[:, 1] < 0, mesh.n_cells, owned[:, 1])
    own[back], owned[back] = own[back][:, ::-1], owned[back][:, ::-1]
    ours, theirs = np.lexsort(cells.T), np.lexsort(owned.T)
    np.testing.assert_array_equal(cells[ours], owned[theirs])
    once = (np.diff(owned[theirs], axis=0) != 0).any(axis=1)
    sure = np.append(True, once) & np.append(once, True)  # two cells may share several faces
    step = data["plane"]["step"]
    assert abs(shown[ours][sure] - own[theirs][sure]).max() < 0.51 * step
    lengths = np.linalg.norm(np.diff(own, axis=1)[:, 0], axis=1)
    assert (lengths > 15.9 * step).mean() > 0.98 or step < 1e-8


def test_names_stay_text(page: Path) -> None:
    data, text = data_of(page), page.read_text()
    assert data["name"] == EVIL
    assert data["runs"][1]["error"].endswith("<i>no</i>")
    assert text.count("<script") == 2
    assert text.count("<style") == 1
    assert f"<title>{html.escape(EVIL)}" in text


def test_nothing_is_fetched(page: Path) -> None:
    text = page.read_text().replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?:|\bsrc=|\bhref=|url\(|\bimport\b|\bfetch\(|XMLHttp|@import", text)
    assert "default-src 'none'" in text


def test_the_smallest_type_is_chosen(tmp_path: Path) -> None:
    mesh = samples.squares(20)
    labels = np.arange(mesh.n_cells)
    hierarchy = Hierarchy(mesh, mesh.graph, [labels, labels // 200], [{}, {"n_parts": 2}], nested=True)
    write_page(tmp_path / "a.html", mesh, [RunResult("r", hierarchy, measure_levels(mesh, hierarchy))])
    levels = data_of(tmp_path / "a.html")["runs"][0]["levels"]
    assert [level["labels"]["type"] for level in levels] == ["Uint16", "Uint8"]
    assert [level["target"] for level in levels] == ["–", "2 parts"]
    assert [level["diameter_ratio"] for level in levels] == [None, None]


def test_a_large_comparison_is_a_few_megabytes(tmp_path: Path) -> None:
    mesh = samples.triangles(86)  # 14,792 cells
    runs = [made(mesh, f"run {i}", 256, 64, 16) for i in range(6)]
    path = tmp_path / "a.html"
    write_page(path, mesh, runs)
    assert path.stat().st_size < 3e5
    (told,) = re.findall(r"this file has ([\d.]+) MB", path.read_text())
    assert float(told) == pytest.approx(path.stat().st_size / 1e6, abs=0.006)


def test_labels_are_short_however_cells_are_numbered(tmp_path: Path) -> None:
    mesh = samples.voronoi(3000, seed=5)  # numbered as its seeds were drawn
    run = made(mesh, "run", 64)
    write_page(tmp_path / "a.html", mesh, [run])
    (level,) = data_of(tmp_path / "a.html")["runs"][0]["levels"]
    assert len(level["labels"]["data"]) < 0.6 * len(integers(run.levels[0].labels)["data"])


@given(st.lists(st.integers(0, 2**31 - 1), max_size=40))
def test_what_is_packed_comes_back(values: list[int]) -> None:
    for packed in (integers(values), separate_bytes(values), differences(values)):
        assert unpacked(packed).tolist() == values
    np.testing.assert_array_equal(unpacked(reals(values)), np.float32(values))


def test_tags_of_few_values_are_names_and_others_numbers(tmp_path: Path) -> None:
    ring = samples.ring(24)
    tags = {"rock": np.arange(ring.n_cells) % 3 - 1, "depth": np.arange(ring.n_cells)}
    mesh = Mesh(ring.points, ring.face_offsets, ring.face_vertices, ring.face_cells, tags)
    write_page(tmp_path / "a.html", mesh, [made(mesh, "run", 4)])
    data = data_of(tmp_path / "a.html")
    order, (rock, depth) = unpacked(data["order"]), data["tags"]
    assert (rock["name"], rock["known"], depth["name"]) == ("rock", ["-1", "0", "1"], "depth")
    np.testing.assert_array_equal(unpacked(rock["cells"]), tags["rock"][order] + 1)
    np.testing.assert_array_equal(unpacked(depth["cells"]), order)
    assert "known" not in depth


def test_what_cannot_be_shown_is_refused_and_leaves_nothing(
    mesh: Mesh, runs: list[RunResult], tmp_path: Path
) -> None:
    (tmp_path / "folder.html").mkdir()
    for nothing in ([], [runs[1]]):
        with pytest.raises(OptionError, match="nothing to report"):
            write_page(tmp_path / "a.html", mesh, nothing)
    with pytest.raises(FileError, match=r"end in \.html, given '\.txt'"):
        write_page(tmp_path / "a.txt", mesh, runs)
    with pytest.raises(FileError, match="there is no folder"):
        write_page(tmp_path / "absent" / "a.html", mesh, runs)
    with pytest.raises(FileError, match="not a regular file"):
        write_page(tmp_path / "folder.html", mesh, runs)
    assert [each.name for each in tmp_path.iterdir()] == ["folder.html"]


class Steps:
    """A section of a plugin."""

    title = "Steps & <more>"

    def html(self, mesh: Mesh, runs: Sequence[RunResult]) -> str:
        return f"<p onclick='f()'>{mesh.n_cells} cells, {len(runs)} runs</p><script>f()</script>"


class Raises(Steps):
    title = "never seen"

    def html(self, mesh: Mesh, runs: Sequence[RunResult]) -> str:
        raise ZeroDivisionError("no <steps>")


class Numbers(Steps):
    def html(self, mesh: Mesh, runs: Sequence[RunResult]) -> str:
        return 7  # type: ignore[return-value]


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """One with sections: good, bad and not here."""
    home = SimpleNamespace(Steps=Steps, Raises=Raises, Numbers=Numbers)
    monkeypatch.setitem(sys.modules, "sections_home", home)
    names = {"raises": "Raises", "steps": "Steps", "numbers": "Numbers"}
    sections = [Component("section", name, f"sections_home:{target}") for name, target in names.items()]
    absent = Component("section", "absent", "sections_home:Absent", requires=("no_such_package",))
    made = Registry()
    made.register(
        SimpleNamespace(agglo_components=hookimpl(lambda: [*sections, absent])),
        "mine",
        distribution="theirs",
        version="2",
    )
    return made


def test_sections_of_plugins_come_last_and_cannot_do_harm(
    mesh: Mesh, runs: list[RunResult], registry: Registry, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.html"
    write_page(path, mesh, runs, registry=registry)
    text = path.read_text()
    own, theirs = text.split('<section class="theirs">', 1)
    assert own.count("<section") == len(OWN) == 5
    assert own.index("</script>", own.index('"use strict"')) > own.index("</main>")  # ours is read before
    assert "<h2>Steps &amp; &lt;more&gt;</h2>" in theirs
    assert "<p onclick='f()'>240 cells, 3 runs</p><script>f()</script>" in theirs
    assert "never seen" not in text
    assert "absent" not in theirs
    who = (
        "section 'raises' (plugin 'mine', distribution theirs 2) is left out of the report: ZeroDivisionError"
    )
    assert f"{html.escape(who)}: no &lt;steps&gt;" in theirs
    assert who in caplog.text
    assert "section 'numbers' (plugin 'mine'" in caplog.text
    assert "html returned int, expected a string" in caplog.text


def test_the_policy_lets_the_script_of_the_page_run_and_no_other(page: Path) -> None:
    text = page.read_text()
    (policy,) = re.findall(r'Content-Security-Policy"\s+content="([^"]*)"', text)
    scripts = dict(each.strip().split(" ", 1) for each in policy.split(";"))
    for kind, tag in (("script-src", 'script type="module"'), ("style-src", "style")):
        (inside,) = re.findall(rf"<{tag}>(.*?)</{tag.split()[0]}>", text, re.S)
        digest = hashlib.sha256(inside.encode()).digest()
        assert scripts[kind] == f"'sha256-{base64.b64encode(digest).decode()}'"
    assert scripts["default-src"] == scripts["form-action"] == scripts["base-uri"] == "'none'"


def test_chosen_metrics_have_their_own_axes(tmp_path: Path) -> None:
    mesh = samples.ring(24)
    hierarchy = Hierarchy(mesh, mesh.graph, [sectors(mesh, 4)], [{"n_parts": 4}], nested=True)

    class Holes:
        better, bounds, homogeneity = "low", (0.0, np.inf), 0

        def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
            return np.array([np.nan, 2.0, 4.0, 3.0])

    levels = measure_levels(mesh, hierarchy, metrics=["CR", "cells", Holes(), "balance"])
    write_page(tmp_path / "a.html", mesh, [RunResult("r", hierarchy, levels)])
    data = data_of(tmp_path / "a.html")
    assert data["metrics"] == [
        {"name": "CR", "low": 0.0, "high": 1.0},
        {"name": "cells", "low": 17.5, "high": 18.5},
        {"name": "Holes", "low": 2.0, "high": 4.0},
    ]
    assert data["objectives"] == ["balance"]
    (level,) = data["runs"][0]["levels"]
    assert level["Holes"] == pytest.approx(3.0)
    assert level["undefined"] == {"Holes": 1}
    assert level["objectives"]["balance"] == pytest.approx(levels[0].objectives["balance"])
    np.testing.assert_array_equal(unpacked(level["values"]["cells"]), np.full(4, 18.0))
