"""The HTML report: what is inside the file, and what Chromium makes of it."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, data_of, unpacked, visited

from agglo_core import samples
from agglo_core.draw.plot import PALETTE, colouring
from agglo_core.draw.webpage import write_page
from agglo_core.draw.webpage.sections import OWN
from agglo_core.errors import FileError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.comparison import RunResult, measure_levels
from agglo_core.mesh import Mesh
from agglo_core.registry import Component, Registry, hookimpl

EVIL = '<b>&amp;</script><script>document.title = "taken"</script><!--title-->/*data*/'


def sectors(mesh: Mesh, k: int) -> np.ndarray:
    """Labels: k sectors about the origin, in order of the angle."""
    x, y = mesh.local_centroids.T
    return np.floor((np.arctan2(y, x) / (2 * np.pi) % 1.0) * k).astype(int) % k


def made(mesh: Mesh, name: str, *counts: int) -> RunResult:
    targets = [{"h_star": 10.0 / k} for k in counts]
    hierarchy = Hierarchy(mesh, mesh.graph, [sectors(mesh, k) for k in counts], targets, nested=True)
    return RunResult(name, hierarchy, measure_levels(mesh, hierarchy), seconds=1.5)


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    ring = samples.ring(48)
    return Mesh(ring.points, ring.face_offsets, ring.face_vertices, ring.face_cells, name=EVIL)


@pytest.fixture(scope="module")
def runs(mesh: Mesh) -> list[RunResult]:
    failed = RunResult("broken", None, error="bisector 'broken' said <i>no</i>")
    return [made(mesh, "one", 8, 4), failed, made(mesh, "two & <b>more</b>", 12, 6, 3)]


@pytest.fixture(scope="module")
def page(mesh: Mesh, runs: list[RunResult], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(path, mesh, runs, note="a <note>")
    assert list(path.parent.iterdir()) == [path]
    return path


def test_arrays_are_those_of_the_mesh_and_levels(page: Path, mesh: Mesh, runs: list[RunResult]) -> None:
    data = data_of(page)
    points = unpacked(data["points"]).reshape(-1, 2)
    np.testing.assert_allclose(
        points[unpacked(data["faces"])], mesh.local_points[mesh.face_vertices], atol=1e-6
    )
    outside = np.where(mesh.face_cells < 0, mesh.n_cells, mesh.face_cells)
    np.testing.assert_array_equal(unpacked(data["sides"]), outside.ravel())
    assert [len(run["levels"]) for run in data["runs"]] == [2, 0, 3]
    for run, shown in zip(runs, data["runs"], strict=True):
        for level, packed in zip(run.levels, shown["levels"], strict=True):
            np.testing.assert_array_equal(unpacked(packed["labels"]), level.labels)
            np.testing.assert_array_equal(unpacked(packed["colours"]), colouring(level.mesh, len(PALETTE)))
            for name, values in level.values.items():
                np.testing.assert_allclose(unpacked(packed["values"][name]), values, rtol=1e-6)
            assert packed["parts"] == level.mesh.n_cells


def test_names_stay_text(page: Path) -> None:
    data, text = data_of(page), page.read_text()
    assert data["name"] == EVIL
    assert data["runs"][1]["error"].endswith("<i>no</i>")
    assert text.count("<script") == 2
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
    write_page(tmp_path / "a.html", mesh, runs)
    assert (tmp_path / "a.html").stat().st_size < 3e6


def test_what_cannot_be_shown_is_refused_and_leaves_nothing(
    mesh: Mesh, runs: list[RunResult], tmp_path: Path
) -> None:
    (tmp_path / "folder.html").mkdir()
    for nothing in ([], [runs[1]]):
        with pytest.raises(OptionError, match="nothing to report"):
            write_page(tmp_path / "a.html", mesh, nothing)
    with pytest.raises(FileError, match=r"end in \.html, not '\.txt'"):
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
    digest = hashlib.sha256(re.findall(r"<script>(.*?)</script>", text, re.S)[0].encode()).digest()
    assert scripts["script-src"] == f"'sha256-{base64.b64encode(digest).decode()}'"
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


# -- in a browser ------------------------------------------------------------------------------

Visit = Callable[[str, str], Any]


@pytest.fixture
def visit(page: Path, tmp_path: Path) -> Visit:
    """Function that opens the page at ``fragment``, runs a script in it and returns what it returns."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: the report is not tested in a browser")

    def call(fragment: str, script: str) -> Any:
        return visited(page, tmp_path, fragment, script)

    return call


def test_the_address_chooses_run_level_and_agglomerate(visit: Visit, runs: list[RunResult]) -> None:
    script = """
      const text = (id) => document.getElementById(id).textContent;
      const facts = [...document.querySelectorAll("#facts dd")].map((each) => each.textContent);
      return { title: document.title, heading: text("title"), about: text("about"), facts,
        hash: location.hash,
        level: text("level-name"), run: document.getElementById("run").selectedOptions[0].textContent,
        bold: document.querySelectorAll("main b, main i, header b").length, runs: text("runs"),
        said: document.getElementById("level").getAttribute("aria-valuetext"),
        rows: document.querySelectorAll("#parts tbody tr").length,
        marks: document.querySelectorAll("#boxes svg line[stroke='#b00020']").length };
    """
    seen = visit("run=two+%26+%3Cb%3Emore%3C%2Fb%3E&level=1&hover=4", script)
    level = runs[2].levels[1]
    assert seen["title"] == f"{EVIL} · agglo report"
    assert seen["heading"] == EVIL
    assert seen["about"].endswith("a <note>")
    assert seen["run"] == "two & <b>more</b>"
    assert seen["bold"] == 0
    assert seen["level"] == seen["said"] == "1: h ≤ 1.667, 6 agglomerates"
    assert seen["rows"] == 6
    assert seen["marks"] == 5
    assert "said <i>no</i>" in seen["runs"]
    assert "hover=4" in seen["hash"]
    values = [float(text.replace(",", "")) for text in seen["facts"]]
    names = ["cells", "diameter", "measure", "UF", "CR", "CRc", "J", "isoperimetric", "components"]
    assert values == pytest.approx([level.values[name][4] for name in names], abs=1e-3)


def test_pointing_finds_the_agglomerate_and_colours_are_right(
    visit: Visit, mesh: Mesh, runs: list[RunResult]
) -> None:
    corner = 0.99 * mesh.local_points[mesh.face_vertices].max(axis=0)
    places = [*mesh.local_centroids.tolist(), [0.0, 0.0], corner.tolist()]  # the hole, the outside
    script = f"""
      const map = document.getElementById("map");
      document.getElementById("cells").click();
      const frame = map.getBoundingClientRect(), ratio = map.width / map.clientWidth;
      const {{ scale }} = fitted(map);
      const at = ([px, py]) =>
        [scale * (px - BOX.low[0] - BOX.width / 2), -scale * (py - BOX.low[1] - BOX.height / 2)];
      const places = {json.dumps(places)};
      const image = map.getContext("2d").getImageData(0, 0, map.width, map.height).data;
      const colours = places.map(at).map(([px, py]) => {{
        const column = Math.floor(map.width / 2 + ratio * px);
        const row = Math.floor(map.height / 2 + ratio * py);
        return [...image.slice(4 * (row * map.width + column)).slice(0, 4)];
      }});
      const found = places.map(at).map(([px, py]) => {{
        const clientX = frame.left + frame.width / 2 + px;
        const clientY = frame.top + frame.height / 2 + py;
        map.dispatchEvent(new PointerEvent("pointermove", {{ clientX, clientY }}));
        return document.getElementById("pick").value;
      }});
      return {{ found, colours }};
    """
    seen = visit("run=one&level=0", script)
    level = runs[0].levels[0]
    assert seen["found"] == [*map(str, level.labels), "", ""]
    tones = [tuple(bytes.fromhex(colour[1:])) for colour in PALETTE]
    wanted = np.array(tones)[colouring(level.mesh, len(PALETTE))][level.labels]
    drawn = np.array(seen["colours"])
    near_a_line = (abs(drawn[:-2, :3] - wanted) > 3).any(axis=1)
    assert near_a_line.mean() < 0.1
    np.testing.assert_array_equal(drawn[-2:], 0)  # holes and the outside are left open


def test_slider_and_tables_work(visit: Visit, runs: list[RunResult]) -> None:
    script = """
      const level = document.getElementById("level"), out = {};
      out.range = [level.min, level.max, level.type, level.tabIndex];
      out.names = [-1, 0, 1, 2].map((value) => {
        level.value = value;
        level.dispatchEvent(new Event("input"));
        return document.getElementById("level-name").textContent;
      });
      const heads = [...document.querySelectorAll("#runs thead button")];
      const head = heads.find((each) => each.textContent === "CR");
      const column = [...document.querySelectorAll("#runs thead th")].indexOf(head.parentElement);
      out.orders = [1, 2].map(() => {
        head.click();
        const rows = [...document.querySelectorAll("#runs tbody tr")];
        const texts = rows.map((row) => row.cells[column]?.textContent ?? null);
        return [head.parentElement.getAttribute("aria-sort"), texts];
      });
      document.querySelector("#runs tbody tr button").click();
      out.chosen = document.querySelectorAll("#runs tr.chosen").length;
      const pick = document.getElementById("pick");
      pick.value = "999";
      pick.dispatchEvent(new Event("input"));
      out.beyond = document.querySelectorAll("#facts dd").length;
      out.wide = document.documentElement.scrollWidth <= window.innerWidth;
      return out;
    """
    seen = visit("run=two+%26+%3Cb%3Emore%3C%2Fb%3E&level=7", script)
    assert seen["range"] == ["-1", "2", "range", 0]
    assert [name.split(":")[0] for name in seen["names"]] == ["the mesh", "0", "1", "2"]
    (up, rising), (down, falling) = seen["orders"]
    assert (up, down) == ("ascending", "descending")
    ratios = sorted(level.line["CR"] for run in runs for level in run.levels)
    assert rising == [*(f"{ratio:.3f}" for ratio in ratios), None]  # the failed run stays at the end
    assert falling[:-1] == rising[:-1][::-1]
    assert seen["chosen"] == 1
    assert seen["beyond"] == 0
    assert seen["wide"]
