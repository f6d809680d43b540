"""What Chromium makes of the report: pointing, colours, zoom, two panels, downloads."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import parse_qs

import numpy as np
import pytest
from browser import Tab, visited
from report_data import EVIL, OF_TWO, TWO, made, named_ring, two_and_a_failure

from agglo_core import samples
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.webpage import write_page
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh

MARGIN = 8


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
    return path


def shown_at(tab: Tab, mesh: Mesh, points: np.ndarray, panel: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Where points of the mesh are in the window, and their colours, as long as the whole mesh is shown."""
    left, top, width, height = tab.run(f"""
      const map = document.querySelectorAll(".map")[{panel}], frame = map.getBoundingClientRect();
      return [frame.left + map.clientLeft, frame.top + map.clientTop, map.clientWidth, map.clientHeight];""")
    corners = mesh.local_points[np.unique(mesh.face_vertices)]
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    scale = min((np.array([width, height]) - 2 * MARGIN) / extent)
    places = np.array([width, height]) / 2 + (points - low - extent / 2) * [scale, -scale]
    colours = tab.run(f"""
      const map = document.querySelectorAll(".map")[{panel}], ratio = map.width / map.clientWidth;
      return {json.dumps(places.tolist())}.map(([x, y]) =>
        [...map.getContext("2d").getImageData(Math.floor(ratio * x), Math.floor(ratio * y), 1, 1).data]);""")
    return places + np.array([left, top]), np.array(colours)


def test_the_address_chooses_run_level_and_agglomerate(page: Path, runs: list[RunResult]) -> None:
    with visited(page, f"{OF_TWO}&level=1&hover=4") as tab:
        seen = tab.run("""
          return { title: document.title, hash: location.hash,
            run: document.querySelector(".run").selectedOptions[0].textContent,
            bold: document.querySelectorAll("main td b, main td i, header b").length,
            said: document.querySelector(".level").getAttribute("aria-valuetext"),
            rows: document.querySelectorAll("#parts tbody tr").length,
            marks: document.querySelectorAll("#boxes svg line.marked").length };""")
        facts = tab.texts("#facts td")
        assert tab.text("#title") == EVIL
        assert tab.text("#about").endswith("a <note>")
        assert tab.text(".level-name") == seen["said"] == "1: h ≤ 1.667, 6 agglomerates"
        assert "said <i>no</i>" in tab.text("#runs")
    level = runs[2].levels[1]
    assert seen["title"] == f"{EVIL} · agglo report"
    assert (seen["run"], seen["bold"], seen["rows"], seen["marks"]) == (TWO, 0, 6, 5)
    assert parse_qs(seen["hash"][1:])["hover"] == ["4"]
    names = ["cells", "diameter", "measure", "UF", "CR", "CRc", "J", "isoperimetric", "components"]
    values = [float(each.replace(",", "")) for each in facts]
    assert values == pytest.approx([level.values[name][4] for name in names], abs=1e-3)


def test_pointing_finds_the_agglomerate_and_colours_are_right(
    page: Path, mesh: Mesh, runs: list[RunResult]
) -> None:
    level, few = runs[0].levels[0], np.arange(0, mesh.n_cells, 26)
    corner = 0.99 * mesh.local_points[mesh.face_vertices].max(axis=0)
    points = np.concatenate([mesh.local_centroids, [np.zeros(2), corner]])  # the hole, the outside
    with visited(page, "run=one&level=0", height=1100) as tab:
        tab.run("document.getElementById('cells').click();")
        places, drawn = shown_at(tab, mesh, points)
        found = []
        for x, y in [*places[:-2][few], *places[-2:]]:
            tab.mouse("Moved", x, y)
            found.append(tab.run("return document.getElementById('pick').value;"))
    assert found == [*map(str, level.labels[few]), "", ""]
    tones = np.array([tuple(bytes.fromhex(colour[1:])) for colour in PALETTE])
    wanted = tones[colouring(level.mesh, len(PALETTE))][level.labels]
    near_a_line = (abs(drawn[:-2, :3] - wanted) > 3).any(axis=1)
    assert near_a_line.mean() < 0.1
    np.testing.assert_array_equal(drawn[-2:], 0)  # holes and the outside are left open


def test_colours_by_value_and_by_tag_have_a_legend(tmp_path: Path) -> None:
    plain = samples.voronoi(200, seed=6)
    tags = {"rock": np.arange(plain.n_cells) // 70, "depth": np.arange(plain.n_cells) - 20}
    mesh = Mesh(plain.points, plain.face_offsets, plain.face_vertices, plain.face_cells, tags)
    run, path = made(mesh, "one", 8), tmp_path / "a.html"
    write_page(path, mesh, [run])
    with visited(path, "run=one&level=0&colour=value:CR") as tab:
        tab.run("document.getElementById('cells').click();")
        _, drawn = shown_at(tab, mesh, mesh.local_centroids)
        legend = tab.text("#legend")
        tab.choose("#colour", "tag:rock")
        _, rocks = shown_at(tab, mesh, mesh.local_centroids)
        assert tab.text("#legend") == "rock012"
        tab.choose("#colour", "tag:depth")
        assert tab.text("#legend") == "depth-20179middle 79.50"
        assert "colour=tag%3Adepth" in tab.run("return location.hash;")
    values, labels = run.levels[0].values["CR"], run.levels[0].labels
    low, high = values.min(), values.max()
    assert legend == f"CR{low:.4f}{high:.4f}middle {(low + high) / 2:.4f}"
    luminance = drawn[:, :3] @ [0.2126, 0.7152, 0.0722]
    brightness = [np.median(luminance[labels == part]) for part in range(8)]
    # brighter is more, also in grey
    np.testing.assert_array_equal(np.argsort(brightness), np.argsort(values))
    tones = np.array([tuple(bytes.fromhex(colour[1:])) for colour in PALETTE])
    assert (abs(rocks[:, :3] - tones[mesh.cell_tags["rock"]]) > 3).any(axis=1).mean() < 0.1


def test_keys_wheel_drag_and_buttons_move_the_sight_of_both_panels(page: Path) -> None:
    zoom = "#zoom"
    with visited(page, f"run=one&level=0&right={OF_TWO[4:]}", width=1400) as tab:
        tab.run("document.querySelector('.map').focus();")
        whole = [tab.picture(0), tab.picture(1)]
        assert whole[0] != whole[1]
        tab.press("+")
        assert tab.text(zoom) == "1.5×"
        tab.press("ArrowLeft")
        tab.press("-")
        tab.press("0")
        assert tab.text(zoom) == "1×"
        assert [tab.picture(0), tab.picture(1)] == whole
        x, y = tab.run(
            "const f = document.querySelector('.map').getBoundingClientRect(); return [f.x + 200, f.y + 200];"
        )
        tab.run("document.activeElement.blur();")
        tab.mouse("Wheel", x, y, deltaX=0, deltaY=-100)
        assert tab.text(zoom) == "1×"  # the page scrolls, or would
        tab.run("scrollTo(0, 0);")
        tab.mouse("Wheel", x, y, deltaX=0, deltaY=-100, modifiers=2)
        assert float(tab.text(zoom)[:-1]) > 1.5
        before = [tab.picture(0), tab.picture(1)]
        assert before[0] != whole[0]
        assert before[1] != whole[1]
        tab.mouse("Pressed", x, y)
        tab.mouse("Moved", x + 60, y + 30, buttons=1)
        tab.mouse("Released", x + 60, y + 30)
        assert tab.picture(1) != before[1]
        tab.run("document.getElementById('zoom-whole').click();")
        tab.settle()
        assert tab.text(zoom) == "1×"
        assert tab.run("return document.activeElement.className;") == "map"


def test_the_point_under_the_pointer_stays_there_when_zooming(page: Path, mesh: Mesh) -> None:
    with visited(page, "run=one&level=0") as tab:
        ((x, y),), _ = shown_at(tab, mesh, mesh.local_centroids[17:18])
        tab.mouse("Moved", x, y)
        marked = tab.run("return document.getElementById('pick').value;")
        for _ in range(6):
            tab.mouse("Wheel", x, y, deltaX=0, deltaY=-120, modifiers=2)
        assert float(tab.text("#zoom")[:-1]) > 20
        tab.mouse("Moved", x + 1, y)
        assert tab.run("return document.getElementById('pick').value;") == marked != ""


def test_two_fingers_zoom_and_one_moves(page: Path) -> None:
    with visited(page, "run=one&level=0", width=400) as tab:
        tab.do("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        x, y = tab.run(
            "const f = document.querySelector('.map').getBoundingClientRect(); return [f.x + 180, f.y + 150];"
        )

        def touch(kind: str, *places: float) -> None:
            points = [{"x": x + place, "y": y, "id": finger} for finger, place in enumerate(places)]
            tab.do("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)
            tab.settle()

        touch("Start", -20, 20)
        for gap in (30, 40):
            touch("Move", -gap, gap)
        touch("End")
        assert tab.text("#zoom") == "2×"
        before = tab.picture()
        touch("Start", 0)
        touch("Move", 30)
        touch("Move", 60)
        touch("End")
        assert tab.text("#zoom") == "2×"
        assert tab.picture() != before


def test_two_runs_are_side_by_side_from_the_start_where_there_is_room(page: Path) -> None:
    for width, panels in ((1400, 2), (360, 1)):
        with visited(page, width=width) as tab:
            shown = "return [...document.querySelectorAll('.map')].map((each) => each.checkVisibility());"
            assert sum(tab.run(shown)) == panels
            runs = tab.run("return [...document.querySelectorAll('.run')].map((each) => each.value);")
            assert runs == ["0", "2"]  # the one that failed is none


def test_two_panels_mark_what_holds_the_same_cell(page: Path, mesh: Mesh, runs: list[RunResult]) -> None:
    with visited(page, "run=one&level=0", width=1400) as tab:
        tab.run("document.getElementById('two').click();")
        tab.settle()
        (at,), _ = shown_at(tab, mesh, mesh.local_centroids[100:101], panel=1)
        tab.mouse("Moved", *at)
        left, right = runs[0].levels[0].labels[100], runs[2].levels[0].labels[100]
        assert tab.texts("#facts tr:first-child td") == [str(left), str(right)]
        tab.run("""const level = document.querySelector(".level"); level.value = 1;
          level.dispatchEvent(new Event("input"));""")
        names = tab.run(
            "return [...document.querySelectorAll('.level-name')].map((each) => each.textContent[0]);"
        )
        assert names == ["1", "1"]  # the right one goes along
        words = parse_qs(tab.run("return location.hash;")[1:])
        assert (words["right"], words["right-level"]) == ([TWO], ["1"])


def test_lines_that_would_be_grey_are_left_out_until_there_is_room(tmp_path: Path) -> None:
    mesh = samples.voronoi(20_000, seed=7)
    write_page(tmp_path / "a.html", mesh, [made(mesh, "one", 30)])
    with visited(tmp_path / "a.html", "run=one&level=0", width=360) as tab:
        assert tab.text("#hint") == "Cells are too small for lines here: zoom in to see them."
        far = tab.picture()
        tab.run("document.getElementById('cells').click();")
        tab.settle()
        assert tab.picture() == far
        tab.run("document.getElementById('cells').click(); document.querySelector('.map').focus();")
        tab.press(*"++++")
        tab.wait("document.getElementById('hint').textContent.startsWith('Point at')")
        near = tab.picture()
        tab.run("document.getElementById('cells').click();")
        tab.settle()
        assert tab.picture() != near
