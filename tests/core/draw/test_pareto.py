"""Runs weighed against one another: what dominates what, where labels go, the picture and the section."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from agglo_core import samples
from agglo_core.draw.label_places import label_places, overlaps, stair_boxes, ties
from agglo_core.draw.pareto import draw_pareto, stairs
from agglo_core.draw.webpage.page import write_page
from agglo_core.draw.webpage.pareto_section import ParetoSection
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.measure.agglomerates import measure_levels
from agglo_core.measure.comparison import RunResult
from agglo_core.measure.trade_offs import not_dominated, trade_offs
from agglo_core.mesh import Mesh

MESH = samples.squares(8)


class Skew:
    """A metric of which less is better: the first cell of each part."""

    better, bounds, homogeneity = "low", (0.0, np.inf), 0

    def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
        return np.unique(labels, return_index=True)[1].astype(float)


def run_of(
    name: str,
    labels: np.ndarray,
    seconds: float = 1.0,
    size: float | None = None,
    metrics: Sequence[object] | None = None,
    mesh: Mesh = MESH,
) -> RunResult:
    """A run with one level."""
    target = {"n_parts": int(labels.max()) + 1} if size is None else {"h_star": size}
    made = Hierarchy(mesh, mesh.graph, [labels], [target], nested=True)
    return RunResult(name, made, measure_levels(mesh, made, metrics=metrics), cpu_seconds=seconds)


def bands(*heights: int) -> np.ndarray:
    """Bands of rows of the 8 by 8 squares."""
    return np.repeat(np.repeat(np.arange(len(heights)), heights), 8)


QUARTERS = (np.arange(8) // 4)[None, :] + 2 * (np.arange(8) // 4)[:, None]
BROKEN = RunResult("broken", None, error="no <luck>")


def three() -> list[RunResult]:
    """Quarters are roundest and even, bands of two heights neither, even bands as even and faster."""
    uneven, even = run_of("uneven", bands(1, 3, 3, 1), 2.0), run_of("even", bands(2, 2, 2, 2), 0.5)
    return [uneven, BROKEN, even, run_of("quarters", QUARTERS.ravel(), 1.0)]


def test_axes_are_what_runs_have() -> None:
    found = trade_offs(three())
    assert found.names == ["uneven", "even", "quarters"]
    assert (found.places, found.missing, found.labels) == ([0, 2, 3], ["broken"], found.names)
    assert (found.roundness.label, found.roundness.high) == ("mean CR", True)
    np.testing.assert_allclose(found.roundness.values[2], 0.5**0.5)
    assert (found.evenness.label, found.evenness.high) == ("variation of the measures", False)
    np.testing.assert_allclose(found.evenness.values, [0.5, 0.0, 0.0], atol=1e-12)
    assert found.front.tolist() == [2]
    assert found.best.tolist() == [False, True, True]


def test_evenness_for_sizes_is_the_mean_diameter_over_h_star() -> None:
    found = trade_offs([run_of("quarters", QUARTERS.ravel(), size=1.0), run_of("whole", bands(8), size=2.0)])
    assert found.evenness.label == "mean diameter over h*"
    np.testing.assert_allclose(found.evenness.values, [0.5**0.5, 0.5**0.5])
    assert found.labels == ["quarters, K = 4", "whole, K = 1"]


def test_the_direction_of_a_metric_is_respected() -> None:
    runs = [
        run_of(name, labels, metrics=[Skew()]) for name, labels in (("a", bands(4, 4)), ("b", bands(2, 6)))
    ]
    found = trade_offs(runs)
    assert (found.roundness.label, found.roundness.high) == ("mean Skew", False)
    assert found.roundness.values.tolist() == [16.0, 8.0]
    assert found.front.tolist() == [1, 0]  # the skewest is the most even
    assert found.roundness.scores.tolist() == [-16.0, -8.0]


def test_solids_are_weighed_alike_and_what_cannot_be_weighed_is_refused() -> None:
    mesh = samples.boxes(2)
    found = trade_offs([run_of("halves", np.arange(8) // 4, mesh=mesh)])
    assert found.roundness.label == "mean CR"
    with pytest.raises(OptionError, match="no run, or none completed"):
        trade_offs([BROKEN])
    with pytest.raises(OptionError, match="no metric is available in all runs"):
        trade_offs([run_of("a", bands(8), metrics=["interface"])])


SCORES = arrays(float, st.tuples(st.integers(1, 12), st.integers(1, 3)), elements=st.integers(0, 4))


@given(SCORES)
def test_the_front_is_what_nothing_dominates(scores: np.ndarray) -> None:
    slow = [
        not any((a >= b).all() and (a > b).any() for a in scores)
        for b in scores
    ]  # fmt: skip
    assert not_dominated(scores).tolist() == slow
    assert any(slow)


def test_what_differs_by_rounding_dominates_nothing() -> None:
    assert not_dominated(np.array([[1.0, 1.0], [1.0 + 1e-13, 1.0]])).all()


def test_stairs_run_along_the_front() -> None:
    runs = [run_of("a", bands(4, 4), metrics=[Skew()]), run_of("b", bands(2, 6), metrics=[Skew()])]
    corners = stairs(trade_offs(runs))
    x, y = [0.5, 0.0], [8.0, 16.0]
    inner = [[x[0], y[0]], [x[0], y[1]], [x[1], y[1]]]
    np.testing.assert_allclose(corners[1:4], inner, atol=1e-12)
    assert (corners[0, 1], corners[-1, 0]) == (8.0, pytest.approx(0.0))


def test_overlaps_are_areas() -> None:
    others = np.array([[1.0, 1.0, 3.0, 2.0], [5.0, 5.0, 6.0, 6.0]])
    np.testing.assert_allclose(overlaps(np.array([[0.0, 0.0, 2.0, 2.0], [5, 5, 6, 6]]), others), [1.0, 1.0])


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 14))
def test_labels_lie_inside_and_on_nothing(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    frame, gap = np.array([1000.0, 600.0]), 10.0
    dots = rng.uniform([20, 20], [980, 580], (n, 2))
    sizes = np.stack([rng.uniform(40, 200, n), np.full(n, 18.0)], axis=1)
    line = stair_boxes(np.array([[0.0, 300.0], [1000.0, 300.0]]), 2.0)
    places = label_places(dots, sizes, frame, gap, line)
    boxes = np.concatenate([places, places + sizes], axis=1)
    assert (places >= 0).all()
    assert (boxes[:, 2:] <= frame).all()
    around = np.concatenate([dots - gap, dots + gap], axis=1)
    for own in range(n):
        others = np.concatenate([np.delete(boxes, own, axis=0), around, line])
        assert overlaps(boxes[own : own + 1], others).sum() == 0.0


def test_dots_on_one_spot_have_labels_apart_and_lines_to_them() -> None:
    dots, sizes = np.full((8, 2), 300.0), np.full((8, 2), [90.0, 18.0])
    places = label_places(dots, sizes, np.array([600.0, 600.0]), 8.0)
    boxes = np.concatenate([places, places + sizes], axis=1)
    assert all(overlaps(boxes[k : k + 1], np.delete(boxes, k, axis=0)).sum() == 0.0 for k in range(8))
    assert set(ties(dots, sizes, places, 8.0)) == set(range(8))
    assert (
        ties(dots[:1], sizes[:1], label_places(dots[:1], sizes[:1], np.array([600.0, 600.0]), 8.0), 8.0) == {}
    )


@pytest.mark.parametrize("count", [1, 2, 3, 15])
def test_pictures_of_few_and_many_runs_are_written(tmp_path: Path, count: int) -> None:
    pytest.importorskip("matplotlib")
    path, runs = tmp_path / "a.svg", (three() * 5)[:count]
    draw_pareto(runs, path, "some <title>")
    text = path.read_text()
    assert ElementTree.fromstring(text) is not None
    assert ("not shown: broken" in re.sub(r"\s+", " ", text)) == any(run.error for run in runs)


def test_labels_of_the_picture_are_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    seen = []
    monkeypatch.setattr("agglo_core.draw.pareto.save_figure", lambda figure, path: seen.append(figure))
    draw_pareto(three() * 4, tmp_path / "a.png")
    (axis, _) = seen[0].axes
    boxes = np.array([text.get_window_extent().extents for text in axis.texts])
    assert len(boxes) == 12
    assert all(overlaps(boxes[k : k + 1], np.delete(boxes, k, axis=0)).sum() < 1e-6 for k in range(12))
    assert axis.xaxis_inverted()
    assert not axis.yaxis_inverted()


def test_the_section_shows_every_run_and_escapes_names() -> None:
    runs = [*three(), run_of("<b>evil</b>", bands(3, 2, 3), 0.1)]
    text = ParetoSection().html(MESH, runs)
    figure = ElementTree.fromstring(text.replace("<br>", "<br/>"))
    (svg,) = figure.findall("div/svg")
    assert len(svg.findall("circle")) == 4
    shown = {each.text for each in svg.findall("text")}
    assert {"uneven, K = 4", "even, K = 4", "quarters, K = 4"} <= shown
    assert "&lt;b&gt;evil&lt;/b&gt;, K = 3" in text
    assert "<b>" not in text
    assert "Not shown: broken." in text
    assert sum(each.get("stroke-width") == "2.5" for each in svg.findall("circle")) == 3
    assert ParetoSection().html(MESH, runs[:1]) == ParetoSection().html(MESH, [BROKEN, BROKEN]) == ""


def test_reports_of_one_run_have_no_such_section(tmp_path: Path) -> None:
    write_page(tmp_path / "one.html", MESH, three()[:1])
    write_page(tmp_path / "more.html", MESH, three())
    assert "Round, even, fast" not in (tmp_path / "one.html").read_text()
    assert "<h2>Round, even, fast</h2>" in (tmp_path / "more.html").read_text()
