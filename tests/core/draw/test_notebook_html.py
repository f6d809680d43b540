"""What notebooks show of objects: small, escaped, never a traceback; progress that keeps to one line."""

from __future__ import annotations

import re
import sys
from base64 import b64decode
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import samples
from agglo_core.errors import MeshError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure import Quality
from agglo_core.mesh import Mesh
from agglo_core.problems import Solution
from agglo_core.progress import phase, shown
from agglo_core.progress.notebook_line import in_notebook

SIZE = 60_000
EVIL = "<script>alert('x')</script>&"


def levels(mesh: Mesh, *counts: int) -> Hierarchy:
    made = [np.arange(mesh.n_cells) * count // mesh.n_cells for count in counts]
    return Hierarchy(mesh, mesh.graph, made, [{"parts": count} for count in counts], nested=False)


def solution(**more: Any) -> Solution:
    given: dict[str, Any] = {
        "x": np.ones(2),
        "A": np.eye(2),
        "b": np.ones(2),
        "operators": [],
        "residuals": np.array([1.0, 0.1]),
        "converged": True,
        "reason": "tolerance met",
        "iterations": 1,
        "seconds": {"solve": 0.25},
    }
    return Solution(**(given | more))


def html(shown: Any) -> str:
    text: str = shown._repr_html_()
    return text


def pictures(text: str) -> list[bytes]:
    return [b64decode(each) for each in re.findall(r'src="data:image/png;base64,([^"]+)"', text)]


def cells(text: str) -> list[list[str]]:
    """The table, row by row."""
    return [re.findall(r"<t[dh]>(.*?)</t[dh]>", row) for row in re.findall(r"<tr>(.*?)</tr>", text)]


MESHES = {
    "squares": samples.squares(3),
    "ring": samples.ring(12),
    "disconnected": samples.disconnected(3),
    "one cell": samples.squares(1),
    "flat": Mesh.from_polygons([[0, 0], [1e6, 0], [1e6, 1e-3], [0, 1e-3]], [[0, 1, 2, 3]]),
    "far": Mesh.from_polygons(np.array([[0, 0], [1, 0], [0, 1]]) + 1e9, [[0, 1, 2]]),
    "boxes": samples.boxes(3),
    "one box": samples.boxes(1),
    "dense": samples.voronoi(4000, seed=1),
}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES.keys())
def test_meshes_and_levels_have_small_pictures(mesh: Mesh) -> None:
    pytest.importorskip("matplotlib")
    counts = sorted({1, (mesh.n_cells + 1) // 2, mesh.n_cells}, reverse=True)
    for text in (html(mesh), html(levels(mesh, *counts))):
        assert len(text) < SIZE
        assert [each[:4] for each in pictures(text)] == [b"\x89PNG"]


def test_tables_say_what_there_is() -> None:
    mesh = samples.squares(4).with_tags(rock=lambda x: x[:, 0] < 0.5)
    rows = dict(row for row in cells(html(mesh)) if len(row) == 2)
    assert rows["cells"] == "16"
    assert rows["faces"] == "40"
    assert rows["extent"] == "1 × 1"
    assert rows["cell tag &#x27;rock&#x27;"] == "2 values"
    assert cells(html(levels(mesh, 8, 2)))[1:] == [
        ["0", "8", "2.0", "parts = 8"],
        ["1", "2", "8.0", "parts = 2"],
    ]
    assert "Hierarchy of 16 cells, not nested" in html(levels(mesh, 8, 2))


def test_quality_is_a_dict_that_shows_a_table() -> None:
    values = Quality(UF=np.array([0.5, 1.0]), odd=np.array([np.nan, 3.0]))
    assert dict(values).keys() == {"UF", "odd"}
    assert repr(values).splitlines() == [
        "Quality of 2 agglomerates",
        "     mean  least  largest  undefined",
        "UF   0.75    0.5        1          0",
        "odd     3      3        3          1",
    ]
    assert cells(html(values)) == [
        ["metric", "mean", "least", "largest", "undefined"],
        ["UF", "0.75", "0.5", "1", ""],
        ["odd", "3", "3", "3", "1"],
    ]
    assert isinstance(agglo.quality(samples.squares(2), [0] * 4, ("cells",)), Quality)
    for empty in (Quality(), Quality(UF=np.array([np.nan]))):
        assert "Quality of" in html(empty)
        assert "Quality of" in repr(empty)


def test_solutions_say_how_they_were_reached() -> None:
    text = html(solution(choice="recipe & cycle"))
    rows = dict(cells(text))
    assert (rows["iterations"], rows["residual over the first"], rows["seconds: solve"]) == (
        "1",
        "1.00e-01",
        "0.25",
    )
    assert "Solution, converged: tolerance met" in text
    assert "recipe &amp; cycle" in text


@pytest.mark.parametrize("residuals", [[], [0.0], [1.0], [np.nan, np.nan], [0.0, 0.0], [np.inf, 1.0]])
def test_odd_residuals_are_shown_as_well(residuals: list[float]) -> None:
    assert "not converged" in html(solution(residuals=np.array(residuals), converged=False))


def test_names_are_escaped() -> None:
    mesh = Mesh.from_polygons(
        [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], name=EVIL, cell_tags={EVIL: np.array([1])}
    )
    level = Hierarchy(mesh, mesh.graph, [np.zeros(1, int)], [{EVIL: EVIL}], nested=True)
    for each in (mesh, level, Quality({EVIL: np.ones(2)}), solution(reason=EVIL, seconds={EVIL: 1.0})):
        text = html(each)
        assert "&lt;script&gt;" in text
        assert "<script" not in text


def test_dollars_in_names_are_no_formulas() -> None:
    assert "Quality" in html(Quality({"$\\no$": np.ones(2)}))


def test_large_meshes_have_tables_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agglo_core.draw.notebook._MOST", 15)
    mesh = samples.squares(4)
    for text, call in ((html(mesh), "mesh.plot()"), (html(levels(mesh, 2)), "hierarchy.plot(level)")):
        assert pictures(text) == []
        assert f"16 cells: no automatic picture above 15; {call} draws one" in text


def test_many_levels_and_tags_stay_small() -> None:
    mesh = samples.squares(4).with_tags(**{f"tag{k}": np.zeros(16, int) for k in range(30)})
    assert len(cells(html(mesh))) == 12
    text = html(levels(mesh, *range(16, 0, -1)))
    assert len(cells(text)) == 9
    assert "8 more levels" in text


def test_without_matplotlib_there_is_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for each in (samples.squares(2), levels(samples.boxes(2), 2), Quality(UF=np.ones(2)), solution()):
        text = html(each)
        assert cells(text)
        assert pictures(text) == []
        assert "pictures need matplotlib: pip install" in text


def test_levels_of_graphs_have_no_picture() -> None:
    graph = samples.squares(2).graph
    text = html(Hierarchy(None, graph, [np.zeros(4, int)], [{}], nested=True))
    assert "of a graph: nothing to draw" in text
    assert cells(html(Hierarchy(None, graph, [], [], nested=True))) == [
        ["level", "parts", "cells per part", "target"]
    ]


def test_what_cannot_be_drawn_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")

    def refuse(self: Any, axis: Any) -> None:
        raise MeshError("too odd")

    monkeypatch.setattr("agglo_core.draw.plane_panels.PlanePanels.fine", refuse)
    assert "no picture: too odd" in html(samples.squares(2))


# -- progress ------------------------------------------------------------------------------------
@pytest.fixture
def displayed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a notebook displays in one place, as it changes."""
    lines: list[str] = []

    def display(data: dict[str, str], *, raw: bool, display_id: bool = True) -> Any:
        assert raw
        assert display_id
        lines.append(data["text/plain"])
        return SimpleNamespace(update=lambda data, raw: lines.append(data["text/plain"]))

    fake = ModuleType("IPython.display")
    fake.display = display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", fake)
    monkeypatch.setattr("agglo_core.progress.display.in_notebook", lambda: True)
    return lines


def test_a_notebook_is_known_by_its_stderr(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not in_notebook()
    monkeypatch.setattr(sys, "stderr", type("OutStream", (), {"__module__": "ipykernel.iostream"})())
    assert in_notebook()


def test_progress_is_one_line_that_ends_with_the_phases(displayed: list[str]) -> None:
    with shown() as listen:
        for name in ("counting", "sorting"):
            with phase(listen, name) as notify:
                notify(0.5, "half")
    assert displayed[0] == f"{'░' * 20}   0% counting"
    assert f"{'░' * 20}   0% sorting" in displayed
    assert re.fullmatch(r"counting, sorting: \d+\.\d s", displayed[-1])


def test_the_progress_line_stays_after_an_error(displayed: list[str]) -> None:
    with pytest.raises(ZeroDivisionError), shown() as listen, phase(listen, "counting"):
        _ = 1 / 0
    assert displayed == [f"{'░' * 20}   0% counting"]
    displayed.clear()
    with shown():
        pass
    assert displayed == []


def test_verbose_shows_progress_in_notebooks(displayed: list[str]) -> None:
    agglo.agglomerate(samples.squares(4), n_parts=2, verbose=True)
    assert "agglomerating" in displayed[-1]
