"""The report of a solid: its stills hold what is seen, and Chromium colours them and finds agglomerates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from browser import visited
from report_data import data_of, unpacked

from agglo_core import agglomerate, samples
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.solids.surfaces import SIDE, mark_cells_beyond, outer_faces, project_surface
from agglo_core.draw.webpage import write_page
from agglo_core.measure.agglomerates import measure_levels
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return samples.boxes(6)


@pytest.fixture(scope="module")
def run(mesh: Mesh) -> RunResult:
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(27, 4))
    return RunResult("halves", hierarchy, measure_levels(mesh, hierarchy), cpu_seconds=1.0)


@pytest.fixture(scope="module")
def page(mesh: Mesh, run: RunResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(path, mesh, [run])
    return path


def pixels_of(still: dict[str, object], order: np.ndarray) -> np.ndarray:
    """Cell at each pixel, −1 for none."""
    numbers = np.repeat(unpacked(still["faces"]), unpacked(still["lengths"]))  # type: ignore[arg-type]
    cells = np.append(-1, order[unpacked(still["cells"])])  # type: ignore[arg-type]
    return cells[numbers].reshape(still["height"], still["width"])  # type: ignore[call-overload, no-any-return]


def test_stills_hold_the_cells_that_are_seen(page: Path, mesh: Mesh, run: RunResult) -> None:
    data = data_of(page)
    one = np.zeros(mesh.n_cells, int)
    surface = outer_faces(mesh, one)
    sight = project_surface(surface, SIDE, 720)
    order = unpacked(data["order"])
    first = pixels_of(data["stills"][0], order)
    np.testing.assert_array_equal(first, np.append(surface.cells, -1)[sight.faces])
    assert [still["name"][:8] for still in data["stills"]] == ["from +x "] * 2 + ["from −x "] * 2 + [
        "from +x "
    ] + ["cut open"] * 3
    for still, normal in zip(data["stills"][5:], ((1, 0, 0), (0, -1, 0), (0, 0, 1)), strict=True):
        shown = np.unique(pixels_of(still, order))[1:]
        assert not mark_cells_beyond(mesh, normal)[shown].any()
        inner = mesh.local_centroids[shown] @ np.array(normal, float) > -1 / 6
        assert inner.sum() == 36  # the whole section
    for level, shown_level in zip(run.levels, data["runs"][0]["levels"], strict=True):
        parts = level.labels[np.unique(pixels_of(shown_level["apart"], order))[1:]]
        assert len(np.unique(parts)) >= len(np.unique(level.labels)) - 8
    assert data["size"] == "volume"
    assert "points" not in data


@pytest.mark.slow
def test_a_report_of_a_large_solid_is_a_few_megabytes(tmp_path: Path) -> None:
    mesh = samples.boxes(40)  # 64,000 cells
    hierarchy = agglomerate(mesh, bisector="coordinate", cells_per_part=(64, 512))
    runs = [RunResult(f"run {k}", hierarchy, measure_levels(mesh, hierarchy)) for k in range(3)]
    write_page(tmp_path / "a.html", mesh, runs)
    assert (tmp_path / "a.html").stat().st_size < 6e6


def test_pointing_finds_the_agglomerate_and_colours_are_right(page: Path, mesh: Mesh, run: RunResult) -> None:
    level, data = run.levels[0], data_of(page)
    cells = pixels_of(data["stills"][6], unpacked(data["order"]))
    places = np.random.default_rng(0).integers((0, 0), cells.shape, (60, 2))
    script = f"""
      const map = document.querySelector(".map"), pick = document.getElementById("pick");
      const [height, width] = {json.dumps(cells.shape)}, frame = map.getBoundingClientRect();
      const scale = Math.min((map.clientWidth - 16) / width, (map.clientHeight - 16) / height);
      document.getElementById("cells").click();
      const drawn = map.getContext("2d");
      return {json.dumps(places.tolist())}.map(([row, column]) => {{
        const x = map.clientWidth / 2 + scale * (column + 0.5 - width / 2);
        const y = map.clientHeight / 2 + scale * (row + 0.5 - height / 2);
        const event = {{ clientX: frame.left + map.clientLeft + x, clientY: frame.top + map.clientTop + y }};
        pick.value = "";
        pick.dispatchEvent(new Event("input"));
        const colour = [...drawn.getImageData(Math.floor(x), Math.floor(y), 1, 1).data];
        map.dispatchEvent(new PointerEvent("pointermove", event));
        return {{ part: pick.value, colour }};
      }});"""
    with visited(page, "run=halves&level=0&view=6") as tab:
        found = tab.run(script)
    wanted = [
        "" if cells[row, column] < 0 else str(level.labels[cells[row, column]]) for row, column in places
    ]
    assert [each["part"] for each in found] == wanted
    tones = np.array([tuple(bytes.fromhex(colour[1:])) for colour in PALETTE], float)
    tones /= np.linalg.norm(tones, axis=1)[:, None]
    colours = colouring(level.mesh, len(PALETTE))
    near_a_line = 0
    for part, each in zip(wanted, found, strict=True):
        if part:
            drawn = np.array(each["colour"][:3], float)
            near_a_line += drawn @ tones[colours[int(part)]] / max(np.linalg.norm(drawn), 1.0) < 0.9995
    assert near_a_line < 8


def test_views_zoom_and_say_what_they_hide(page: Path, run: RunResult) -> None:
    data = data_of(page)
    visible_parts = run.levels[0].labels[np.unique(pixels_of(data["stills"][6], unpacked(data["order"])))[1:]]
    script = """
      const text = (id) => document.getElementById(id).textContent, pick = document.getElementById("pick");
      const hints = Array.from({ length: 27 }, (_, part) => {
        pick.value = part;
        pick.dispatchEvent(new Event("input"));
        return text("hint");
      });
      const side = document.getElementById("side"), names = [...side.options].map((each) => each.textContent);
      pick.value = "";
      pick.dispatchEvent(new Event("input"));
      side.value = -1;
      side.dispatchEvent(new Event("change"));
      return { hints, names, hash: location.hash };"""
    with visited(page, "run=halves&level=0&hover=0&view=6", width=1400) as tab:
        found = tab.run(script)
        tab.run("document.getElementById('two').click(); document.querySelector('.map').focus();")
        tab.settle()
        pictures = "return [...document.querySelectorAll('.map')].map((each) => each.toDataURL());"
        before = tab.run(pictures)
        tab.press("+")
        after = tab.run(pictures)
    assert [hint.startswith("Point at") for hint in found["hints"]] == [
        part in visible_parts for part in range(27)
    ]
    assert 0 < len(set(visible_parts)) < 27
    assert len(found["names"]) == 9
    assert "view=-1" in found["hash"]
    assert before[0] == before[1]  # there is but one run
    assert after[0] == after[1] != before[0]
