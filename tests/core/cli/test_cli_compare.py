"""``agglo compare`` and ``agglo run --report``: every combination in its place, whatever becomes of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Agglo

from agglo_core.cli.options.specs import split_specs
from agglo_core.errors import MeshError
from agglo_core.graph import Graph
from agglo_core.registry import Component, default, hookimpl


class Stubborn:
    """A bisector that works on small meshes alone, such as the one that warms it up."""

    def bisect(self, graph: Graph, rng: np.random.Generator) -> np.ndarray:
        if graph.n > 16:
            raise MeshError("too many cells for me")
        return np.arange(graph.n) % 2


@pytest.fixture
def stubborn(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(__import__("sys").modules, "stubborn_home", SimpleNamespace(Stubborn=Stubborn))
    component = Component(kind="bisector", name="stubborn", target="stubborn_home:Stubborn")
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: [component])), "stubborn")
    yield
    default().unregister("stubborn")


def test_lists_of_components_are_split() -> None:
    assert split_specs("kmeans") == ["kmeans"]
    assert split_specs("kmeans, inertial") == ["kmeans", "inertial"]
    assert split_specs("metis:ufactor=30,contig=true,kmeans,theirs/x:a=b:c,d=1") == [
        "metis:ufactor=30,contig=true",
        "kmeans",
        "theirs/x:a=b:c,d=1",
    ]


def test_combinations_come_in_the_given_order(agglo: Agglo) -> None:
    ask = ["--bisector", "inertial,kmeans", "--method", "kway,recursive", "--parts", "16,4", "--json"]
    code, out, _ = agglo("compare", "squares:n=8", *ask)
    assert code == 0
    data = json.loads(out)
    assert data["mesh"]["cells"] == 64
    pairs = [(run["bisector"], run["method"]) for run in data["runs"]]
    assert pairs == [(b, m) for b in ("inertial", "kmeans") for m in ("kway", "recursive")]
    assert "no k-way partition" in data["runs"][0]["error"]
    assert data["runs"][0]["levels"] == []
    for run in data["runs"][1:]:
        assert run["error"] is None
        assert run["seconds"] > 0
        assert [level["parts"] for level in run["levels"]] == [16, 4]
        assert all(level["diameter_ratio"] is None for level in run["levels"])
    keys = {"target", "parts", "min_cells", "max_cells", "max_diameter", "connected", "diameter_ratio"}
    keys |= {"UF", "CR", "CRc", "J", "isoperimetric"}
    assert set(data["runs"][1]["levels"][0]) == keys


def test_the_table_names_what_is_missing(agglo: Agglo) -> None:
    code, out, _ = agglo(
        *("compare", "squares:n=8", "--h-factor", "2,4"),
        *("--bisector", "inertial,kmeans", "--method", "kway,recursive"),
    )
    assert code == 0
    assert "inertial kway" in out
    assert "not implemented: it has no k-way partition" in out
    assert "mean diam/h*" in out
    assert "h ≤ 2 h0" in out


def columns_of(text: str) -> list[str]:
    """Headings of the table in a text."""
    (head,) = [line for line in text.splitlines() if line.startswith("┃")]
    return [each.strip() for each in head.strip("┃").split("┃")]


def test_the_mean_diameter_over_the_size_stands_beside_the_number_of_parts_where_there_is_a_size(
    agglo: Agglo,
) -> None:
    ratios = ["UF", "CR", "CRc", "J", "isoperimetric", "connected"]
    for command in ("run", "compare"):
        sized = columns_of(agglo(command, "squares:n=8", "--bisector", "inertial", "--h-star", "0.5").out)
        assert sized[:5] == ["bisector", "target", "K", "cells each", "mean diam/h*"]
        assert sized[5:] == [*ratios, "CPU s"]
        counted = columns_of(agglo(command, "squares:n=8", "--bisector", "inertial", "--parts", "4").out)
        assert counted == ["bisector", "target", "K", "cells each", *ratios, "CPU s"]
    agglo("run", "squares:n=8", "--bisector", "inertial", "--h-star", "0.5", "-o", "sized.npz")
    agglo("run", "squares:n=8", "--bisector", "inertial", "--parts", "4", "-o", "counted.npz")
    assert columns_of(agglo("quality", "sized.npz").out)[:5] == [
        *("level", "parts", "min_cells", "max_cells", "diameter_ratio")
    ]
    assert "diameter_ratio" not in agglo("quality", "counted.npz").out


def test_diameters_are_compared_with_h_star(agglo: Agglo) -> None:
    code, out, _ = agglo("compare", "squares:n=8", "--bisector", "kmeans", "--h-star", "0.5", "--json")
    assert code == 0
    (level,) = json.loads(out)["runs"][0]["levels"]
    assert level["parts"] == 16  # quarters of a side: the halves would be too large
    assert level["diameter_ratio"] == pytest.approx(2**0.5 / 4 / 0.5)


def test_one_failing_run_is_a_line(agglo: Agglo, stubborn: None) -> None:
    ask = ["squares:n=8", "--bisector", "stubborn,kmeans", "--report", "out.html"]
    code, out, _ = agglo("compare", *ask)
    assert code == 3
    assert "too many cells for me" in out
    assert "too many cells for me" in Path("out.html").read_text()
    runs = json.loads(agglo("compare", *ask, "--json").out)["runs"]
    assert [run["error"] is None for run in runs] == [False, True]
    code, out, err = agglo("compare", "squares:n=8", "--bisector", "stubborn", "--report", "other.html")
    assert (code, out) == (2, "")
    assert "all runs failed" in err
    assert not Path("other.html").exists()


@pytest.mark.parametrize(
    ("target", "reason"),
    [("stubborn_home:Unbuildable", "no such model"), ("stubborn_home:Missing", "Missing")],
)
def test_a_plugin_that_cannot_be_built_is_a_line(
    agglo: Agglo, monkeypatch: pytest.MonkeyPatch, target: str, reason: str
) -> None:
    class Unbuildable(Stubborn):
        def __init__(self) -> None:
            raise ValueError("no such model")

    monkeypatch.setitem(__import__("sys").modules, "stubborn_home", SimpleNamespace(Unbuildable=Unbuildable))
    component = Component(kind="bisector", name="unbuildable", target=target)
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: [component])), "unbuildable")
    try:
        done = agglo("compare", "squares:n=8", "--parts", "4", "--bisector", "unbuildable,inertial", "--json")
        alone = agglo("compare", "squares:n=8", "--parts", "4", "--bisector", "unbuildable")
    finally:
        default().unregister("unbuildable")
    assert done.code == 3
    broken, good = done.data["runs"]
    assert reason in broken["error"]
    assert (broken["levels"], good["error"], good["levels"][0]["parts"]) == ([], None, 4)
    assert (alone.code, alone.out) == (2, "")
    assert "all runs failed: unbuildable: " in alone.err


def test_runs_are_weighed_in_a_picture(agglo: Agglo, stubborn: None) -> None:
    pytest.importorskip("matplotlib")
    ask = ["squares:n=8", "--bisector", "stubborn,kmeans,inertial", "--parts", "4", "--pareto", "out.svg"]
    code, out, _ = agglo("compare", *ask)
    assert code == 3
    assert "wrote out.svg" in out
    text = Path("out.svg").read_text()
    assert "not shown: stubborn" in text
    code, _, err = agglo("compare", "squares:n=4", "--metrics", "interface", "--pareto", "none.png")
    assert code == 3
    assert "no metric is available in all runs" in err
    assert not Path("none.png").exists()


def test_run_writes_a_report(agglo: Agglo) -> None:
    code, out, _ = agglo(
        "run", "ring:n=24", "--bisector", "kmeans", "--bisector", "inertial", "--report", "o.html"
    )
    assert code == 0
    assert "wrote o.html" in out
    assert Path("o.html").read_text().startswith("<!DOCTYPE html>")
    assert agglo("run", "squares:n=4", "--report", "q.html", "--quiet") == (0, "", "")
    assert Path("q.html").exists()


WRONG: dict[str, tuple[list[str], str]] = {
    "no such sample": (["compare", "sqares"], "neither an existing file"),
    "an unknown bisector": (
        ["compare", "squares:n=4", "--bisector", "kmeans,kmean"],
        "did you mean 'kmeans'?",
    ),
    "an unknown option": (
        ["compare", "squares:n=4", "--bisector", "kmeans:no_such=1"],
        "no option 'no_such'",
    ),
    "one bisector twice": (["compare", "squares:n=4", "--bisector", "kmeans,kmeans"], "given twice"),
    "an unknown method": (["compare", "squares:n=4", "--method", "direct"], "unknown method 'direct'"),
    "no bisector that can": (
        ["compare", "squares:n=4", "--bisector", "inertial", "--method", "kway"],
        "no k-way partition",
    ),
    "two targets": (["compare", "squares:n=4", "--parts", "2", "--h-star", "1"], "--h-star and --parts"),
    "a negative size": (["compare", "squares:n=4", "--bisector", "kmeans", "--h-star", "-1"], "-1"),
    "more parts than cells": (["compare", "squares:n=2", "--bisector", "kmeans", "--parts", "5"], "5"),
    "not a web page": (["compare", "squares:n=4", "--report", "out.vtu"], "reports end in .html"),
    "not a picture": (["compare", "squares:n=4", "--pareto", "out.html"], "pictures end in"),
    "no folder for the picture": (["compare", "squares:n=4", "--pareto", "absent/out.png"], "absent"),
    "not a web page of run": (["run", "squares:n=4", "--report", "out.txt"], "reports end in .html"),
    "no folder for the page": (["run", "squares:n=4", "--report", "absent/out.html"], "absent"),
}


@pytest.mark.parametrize(("arguments", "message"), WRONG.values(), ids=WRONG.keys())
def test_bad_input_is_one_line_and_leaves_nothing(
    agglo: Agglo, tmp_path: Path, arguments: list[str], message: str
) -> None:
    code, out, err = agglo(*arguments)
    assert (code, out) == (2, "")
    errors = [line for line in err.splitlines() if not line.startswith(("note: ", "warning: ", "usage: "))]
    assert len(errors) == 1
    assert errors[0].startswith("error: ")
    assert message in errors[0]
    assert list(tmp_path.iterdir()) == []
