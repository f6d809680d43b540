"""The tables of the report in Chromium: they sort, and come down as CSV."""

from __future__ import annotations

import csv
import io
import json
import time
from pathlib import Path

import numpy as np
import pytest
from browser import Tab, downloads, visited
from report_data import OF_TWO, TWO, named_ring, two_and_a_failure

from agglo_core.draw.webpage import write_page
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh


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


def test_slider_and_tables_work(page: Path, runs: list[RunResult]) -> None:
    script = """
      const level = document.querySelector(".level"), out = {};
      out.range = [level.min, level.max, level.type, level.tabIndex];
      out.names = [-1, 0, 1, 2].map((value) => {
        level.value = value;
        level.dispatchEvent(new Event("input"));
        return document.querySelector(".level-name").textContent;
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
      out.beyond = document.querySelectorAll("#facts td").length;
      return out;"""
    with visited(page, f"{OF_TWO}&level=7") as tab:
        seen = tab.run(script)
    assert seen["range"] == ["-1", "2", "range", 0]
    assert [name.split(":")[0] for name in seen["names"]] == ["the mesh", "0", "1", "2"]
    (up, rising), (down, falling) = seen["orders"]
    assert (up, down) == ("ascending", "descending")
    ratios = sorted(level.line["CR"] for run in runs for level in run.levels)
    assert rising == [*(f"{ratio:.3f}" for ratio in ratios), None]  # the failed run stays at the end
    assert falling[:-1] == rising[:-1][::-1]
    assert (seen["chosen"], seen["beyond"]) == (1, 0)


def downloaded(tab: Tab, folder: Path, button: str) -> list[list[str]]:
    before, until = set(folder.iterdir()), time.monotonic() + 30
    tab.run(f"document.querySelector({json.dumps(button)}).click();")
    while not (new := [each for each in set(folder.iterdir()) - before if each.suffix == ".csv"]):
        assert time.monotonic() < until
        time.sleep(0.02)
    return list(csv.reader(io.StringIO(new[0].read_text(encoding="utf-8"), newline="")))


def test_tables_and_labels_are_downloaded_as_csv(page: Path, mesh: Mesh, runs: list[RunResult]) -> None:
    with downloads() as folder, visited(page, f"{OF_TWO}&level=1") as tab:
        head, *rows = downloaded(tab, folder, ".labels")
        assert head == ["cell", "level 0", "level 1", "level 2"]
        wanted = np.stack([np.arange(mesh.n_cells), *(level.labels for level in runs[2].levels)], axis=1)
        np.testing.assert_array_equal(np.array(rows, int), wanted)
        head, *rows = downloaded(tab, folder, "#parts-csv")
        values = runs[2].levels[1].values
        np.testing.assert_allclose(np.array(rows, float)[:, head.index("CR")], values["CR"], rtol=1e-6)
        np.testing.assert_array_equal(np.array(rows, float)[:, 0], np.arange(6))
        head, *rows = downloaded(tab, folder, "#runs-csv")
        assert [row[:2] for row in rows] == [
            ["one", "0"], ["one", "1"], ["broken", ""], [TWO, "0"], [TWO, "1"], [TWO, "2"]
        ]  # fmt: skip
        assert rows[2][head.index("error")] == runs[1].error
        assert float(rows[4][head.index("J")]) == pytest.approx(values["J"].mean(), rel=1e-6)
