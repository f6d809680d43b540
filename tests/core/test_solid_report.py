"""The report of a solid: its stills hold what is seen, and Chromium colours them and finds agglomerates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, data_of, unpacked, visited

from agglo_core import agglomerate, samples
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.surfaces import SIDE, beyond, outer_faces, seen
from agglo_core.draw.webpage import write_page
from agglo_core.measure.comparison import RunResult, measure_levels
from agglo_core.mesh import Mesh


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return samples.boxes(6)


@pytest.fixture(scope="module")
def run(mesh: Mesh) -> RunResult:
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(27, 4))
    return RunResult("halves", hierarchy, measure_levels(mesh, hierarchy), seconds=1.0)


@pytest.fixture(scope="module")
def page(mesh: Mesh, run: RunResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(path, mesh, [run])
    return path


def pixels_of(still: dict[str, object]) -> np.ndarray:
    """Cell at each pixel, −1 for none."""
    numbers = np.repeat(unpacked(still["faces"]), unpacked(still["lengths"]))  # type: ignore[arg-type]
    cells = np.append(-1, unpacked(still["cells"]).astype(int))  # type: ignore[arg-type]
    return cells[numbers].reshape(still["height"], still["width"])  # type: ignore[call-overload, no-any-return]


def test_stills_hold_the_cells_that_are_seen(page: Path, mesh: Mesh, run: RunResult) -> None:
    data = data_of(page)
    one = np.zeros(mesh.n_cells, int)
    surface = outer_faces(mesh, one)
    sight = seen(surface, SIDE, 720)
    first = pixels_of(data["stills"][0])
    np.testing.assert_array_equal(first, np.append(surface.cells, -1)[sight.faces])
    assert [still["name"][:8] for still in data["stills"]] == ["from +x "] * 2 + ["from −x "] * 2 + [
        "from +x "
    ] + ["cut open"] * 3
    for still, normal in zip(data["stills"][5:], ((1, 0, 0), (0, -1, 0), (0, 0, 1)), strict=True):
        shown = np.unique(pixels_of(still))[1:]
        assert not beyond(mesh, normal)[shown].any()
        inner = mesh.local_centroids[shown] @ np.array(normal, float) > -1 / 6
        assert inner.sum() == 36  # the whole section
    for level, shown_level in zip(run.levels, data["runs"][0]["levels"], strict=True):
        parts = level.labels[np.unique(pixels_of(shown_level["apart"]))[1:]]
        assert len(np.unique(parts)) >= len(np.unique(level.labels)) - 8
    assert data["size"] == "volume"
    assert "points" not in data


def test_a_report_of_a_large_solid_is_a_few_megabytes(tmp_path: Path) -> None:
    mesh = samples.boxes(40)  # 64,000 cells
    hierarchy = agglomerate(mesh, bisector="coordinate", cells_per_part=(64, 512))
    runs = [RunResult(f"run {k}", hierarchy, measure_levels(mesh, hierarchy)) for k in range(3)]
    write_page(tmp_path / "a.html", mesh, runs)
    assert (tmp_path / "a.html").stat().st_size < 6e6


def test_pointing_finds_the_agglomerate_and_colours_are_right(
    page: Path, mesh: Mesh, run: RunResult, tmp_path: Path
) -> None:
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: the report is not tested in a browser")
    level = run.levels[0]
    cells = pixels_of(data_of(page)["stills"][6])
    rng = np.random.default_rng(0)
    places = [(int(r), int(c)) for r, c in rng.integers((0, 0), cells.shape, (60, 2))]
    script = f"""
      const map = $("map"), frame = map.getBoundingClientRect();
      $("cells").click();
      const {{ width, scale }} = fitted(map, painted.still), ratio = map.width / map.clientWidth;
      const image = map.getContext("2d").getImageData(0, 0, map.width, map.height).data;
      const seen = {json.dumps(places)}.map(([row, column]) => {{
        const x = (map.clientWidth - width) / 2 + scale * (column + 0.5), y = scale * (row + 0.5);
        const at = 4 * (Math.floor(ratio * y) * map.width + Math.floor(ratio * x));
        const colour = [...image.slice(at, at + 4)];
        const event = {{ clientX: frame.left + map.clientLeft + x, clientY: frame.top + map.clientTop + y }};
        map.dispatchEvent(new PointerEvent("pointermove", event));
        return {{ part: $("pick").value, colour }};
      }});
      const hinted = (part) => {{ set({{ part }}); return $("hint").textContent; }};
      const hints = Array.from({{ length: 27 }}, (_, part) => hinted(part));
      const names = [...$("side").options].map((each) => each.textContent);
      $("side").value = -1;
      $("side").dispatchEvent(new Event("change"));
      const apart = painted.still.name;
      return {{ seen, names, hints, apart, hash: location.hash }};
    """
    found = visited(page, tmp_path, "run=halves&level=0&hover=0&view=6", script)
    assert len(found["names"]) == 9
    assert found["apart"] == found["names"][-1] == "moved apart"
    assert "view=-1" in found["hash"]
    shown = set(level.labels[np.unique(cells)[1:]])
    assert 0 < len(shown) < 27
    assert [hint.startswith("Point at") for hint in found["hints"]] == [part in shown for part in range(27)]
    wanted = ["" if cells[place] < 0 else str(level.labels[cells[place]]) for place in places]
    assert [each["part"] for each in found["seen"]] == wanted
    tones = np.array([tuple(bytes.fromhex(colour[1:])) for colour in PALETTE], float)
    tones /= np.linalg.norm(tones, axis=1)[:, None]
    colours = colouring(level.mesh, len(PALETTE))
    near_a_line = 0
    for part, each in zip(wanted, found["seen"], strict=True):
        if not part:
            continue
        drawn = np.array(each["colour"][:3], float)
        cosine = drawn @ tones[colours[int(part)]] / max(np.linalg.norm(drawn), 1.0)
        near_a_line += cosine < 0.9995
    assert near_a_line < 8
