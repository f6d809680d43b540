"""What is drawn and reported of solutions: curves, the section Solve of the page."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import visited
from scipy import sparse

from agglo_core import samples
from agglo_core.draw.convergence import Curves, draw_convergence
from agglo_core.draw.webpage import write_page
from agglo_core.draw.webpage.solve_curves import history_picture
from agglo_core.draw.webpage.solve_section import solve_section
from agglo_core.errors import FileError, OptionError
from agglo_core.problems import Linear, Solution
from agglo_core.solvers.solution_report import report

EVIL = "<b>&amp;</script><script>document.title = 1</script>"
MESH = samples.squares(2)
A, b = sparse.eye_array(4).tocsr(), np.ones(4)
SOLUTION = Solution(
    b,
    A,
    b,
    [(A, None), (A, None)],
    np.array([2.0, 1.0, 0.1, 0.002]),
    True,
    "tolerance met",
    3,
    {"assemble": 0.25, "hierarchy": 3.0, "solve": 0.5},
    energy_error=1e-4,
    energy_errors=np.array([1.0, 0.1, 0.01, 1e-4]),
    tests=("residual", "energy error"),
    cpu_seconds={"assemble": 0.125, "hierarchy": 2.0, "solve": 0.375},
    memory=12_300_000,
    choice="W-cycle",
    advice=f"take {EVIL}",
    tolerance=1e-3,
)


def data_of(solution: Solution) -> dict[str, Any]:
    return report(MESH, Linear(A, b, np.arange(5)), solution)


def text_of(markup: str) -> str:
    return " ".join(html.unescape(re.sub("<[^>]*>", " ", markup)).split())


def test_curves_are_relative_and_leave_out_what_has_no_logarithm() -> None:
    curves = Curves.of(SOLUTION)
    np.testing.assert_allclose(curves.residuals, [1.0, 0.5, 0.05, 0.001])
    np.testing.assert_array_equal(curves.errors, SOLUTION.energy_errors)
    stranger = replace(SOLUTION, energy_errors=np.array([]), residuals=np.array([2.0, 0.0, np.inf, 1.0]))
    np.testing.assert_allclose(Curves.of(stranger).residuals, [1.0, np.nan, np.nan, 0.5])
    np.testing.assert_allclose(Curves.of(stranger).errors, [np.nan, np.nan, np.nan, 1e-4])
    unknown = replace(stranger, energy_error=None, residuals=np.zeros(1))
    assert not np.isfinite(Curves.of(unknown).residuals).any()
    assert not np.isfinite(Curves.of(unknown).errors).any()


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_pictures_of_convergence(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / f"c.{suffix}"
    nothing = replace(SOLUTION, residuals=np.zeros(1), energy_error=None, tolerance=None, iterations=0)
    draw_convergence({"ours": SOLUTION, "theirs": nothing}, path, title="two")
    assert list(tmp_path.iterdir()) == [path]
    if suffix == "svg":
        words = re.findall("<!-- (.*) -->", path.read_text())
        assert "ours: residual, contraction 0.1" in words
        assert {"ours: energy error, estimated", "theirs: residual", "tolerance 0.001"} <= set(words)
    with pytest.raises(OptionError, match="give at least one solution"):
        draw_convergence({}, path)
    with pytest.raises(FileError, match="unknown picture format"):
        draw_convergence({"ours": SOLUTION}, tmp_path / "c.xyz")


def test_the_section_contains_levels_phases_and_recipe() -> None:
    section = solve_section({"ours": data_of(SOLUTION)})
    said = text_of(section)
    assert "Converged after 3 iterations: tolerance met by residual and energy error." in said
    assert "Recipe: W-cycle" in said
    assert "memory of the levels 12.3 MB" in said
    assert "level unknowns nonzeros parts mesh 4 4 4 1 4 4 4" in said
    phases = "hierarchy 2.00 3.00 assembly 0.12 0.25 solve 0.38 0.50 together 2.50 3.75"
    assert f"phase processor clock {phases}" in said
    assert "contraction, mean 0.1 " in said
    assert f"Advice: take {EVIL}" in said
    assert "<script" not in section
    assert solve_section({}) == ""


def test_several_solutions_are_a_table_and_their_details() -> None:
    failed = replace(SOLUTION, converged=False, reason="no <luck>", cpu_seconds={}, seconds={}, memory=None)
    solves = {EVIL: data_of(SOLUTION), "two": data_of(failed), "three": {"error": "refused & gone"}}
    section = solve_section(solves)
    said = text_of(section)
    assert section.count("<details>") == 2
    assert f"{EVIL} 4 3 yes 0.1 2.00 12.3 2.00 0.12 – 0.38 two 4 3 no 0.1 2.00 – – – – –" in said
    assert "three: refused & gone" in said
    assert "Not converged: no <luck>; the solution is from iteration 3." in said
    assert "<script" not in section


@pytest.mark.parametrize("steps", [0, 1, 3, 40, 5000])
def test_histories_of_any_length_fit_into_the_picture(steps: int) -> None:
    sizes = np.geomspace(1.0, 1e-9, steps + 1)
    long = replace(SOLUTION, residuals=3.0 * sizes, energy_errors=sizes[::-1], iterations=steps)
    picture = history_picture({"long": data_of(long)})
    places = [float(each) for each in re.findall(r'\b[xc][12x]?="([\d.-]+)%"', picture)]
    heights = [float(each) for each in re.findall(r'\b[yc][12y]?="([\d.-]+)"', picture)]
    assert min(places) >= 8.0
    assert max(places) <= 98.0
    assert min(heights) >= 5.0
    assert max(heights) <= 300.0
    assert len(picture) < 120_000


def test_a_page_of_a_solution_alone_has_no_script(tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    write_page(path, MESH, (), note="constant <solved>", solves={"ours": data_of(SOLUTION)})
    page = path.read_text()
    assert "<script" not in page
    assert "script-src 'none'" in page
    assert text_of(page[page.index("<header") :]).startswith(
        "squares 2x2 4 cells, h0 = 0.7071; constant <solved>"
    )
    with pytest.raises(OptionError, match="nothing to report"):
        write_page(path, MESH, ())


@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_sticks_out_in_a_browser(tmp_path: Path, width: int) -> None:
    page = tmp_path / "a.html"
    write_page(page, MESH, (), solves={"ours": data_of(SOLUTION), "n" * 60: data_of(SOLUTION)})
    with visited(page, width=width) as tab:
        seen = tab.run("""
          document.querySelectorAll("details").forEach((each) => { each.open = true; });
          const { left, right, height } = document.querySelector("figure svg").getBoundingClientRect();
          return [document.documentElement.scrollWidth, left, right, height];""")
    whole, left, right, height = seen
    assert whole <= width
    assert 0 <= left < right <= width
    assert height == 300
