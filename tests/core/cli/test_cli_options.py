"""Options that several commands share: the same words, the same outcome, hints where a word is wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
from command_line import Agglo

from agglo_core import Mesh
from agglo_core.registry import Command, Component, default, hookimpl


class Corners:
    """A metric of a stranger: a number for each part, times ``scale``."""

    better, bounds, homogeneity = "low", (0.0, np.inf), 0

    def __init__(self, scale: float = 1.0) -> None:
        self.scale = scale

    def measure(self, mesh: Mesh, labels: np.ndarray) -> np.ndarray:
        return self.scale * np.arange(int(np.max(labels)) + 1)


@click.group()
def tools() -> None:
    """Tools of a plugin."""


@tools.command()
@click.option("--colour")
def paint(colour: str) -> None:
    """Paint something."""


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    home = SimpleNamespace(Corners=Corners, tools=tools)
    monkeypatch.setitem(__import__("sys").modules, "options_home", home)
    made = SimpleNamespace(
        agglo_components=hookimpl(lambda: [Component("metric", "corners", "options_home:Corners")]),
        agglo_commands=hookimpl(lambda: [Command("tools", "options_home:tools", "Tools.")]),
    )
    default().register(made, "theirs")
    yield
    default().unregister("theirs")


def test_metrics_of_all_commands_and_of_strangers(agglo: Agglo, plugin: None) -> None:
    pick = ["--metrics", "corners:scale=2,convexity,balance,CR"]
    code, out, _ = agglo("run", "squares:n=4", "--bisector", "coordinate", "--parts", "4", "--json", *pick)
    assert code == 0
    (level,) = json.loads(out)["runs"][0]["levels"]
    keys = [
        "target",
        "parts",
        "min_cells",
        "max_cells",
        "max_diameter",
        "corners",
        "convexity",
        "CR",
        "connected",
    ]
    keys += ["diameter_ratio", "objectives"]
    assert list(level) == keys
    assert level["corners"] == 3.0
    assert level["objectives"] == {"balance": pytest.approx(0.25)}
    agglo(
        "run",
        "squares:n=4",
        "--bisector",
        "coordinate",
        "--parts",
        "4",
        "-o",
        "a.npz",
        "--report",
        "a.html",
        *pick,
    )
    (row,) = json.loads(agglo("quality", "a.npz", "--json", *pick).out)["levels"]
    assert row == {"level": "level_0"} | {key: level[key] for key in keys[1:]}
    assert '"name":"corners","low":0.0,"high":6.0' in Path("a.html").read_text()
    assert "CRc" in agglo("quality", "a.npz").out
    chosen = agglo("quality", "a.npz", "--metrics", "corners,compactness").out
    assert "corners" in chosen
    assert "compactness" in chosen
    assert "CRc" not in chosen


def test_metrics_of_a_comparison(agglo: Agglo) -> None:
    ask = ["squares:n=4", "--bisector", "coordinate,inertial", "--parts", "4", "--metrics", "cells,interface"]
    code, out, _ = agglo("compare", *ask, "--json")
    assert code == 0
    for run in json.loads(out)["runs"]:
        (level,) = run["levels"]
        assert (level["cells"], level["objectives"]) == (4.0, {"interface": pytest.approx(2.0)})
        assert "UF" not in level
        assert level["diameter_ratio"] is None
    table = agglo("compare", *ask).out
    assert "interface" in table
    assert " UF " not in table


def test_metrics_that_solids_lack_are_refused_before_the_run(agglo: Agglo) -> None:
    code, out, err = agglo("run", "boxes:n=2", "--metrics", "UF,edge_ratio", "-o", "left.vtu")
    assert (code, out) == (2, "")
    assert "metric edge_ratio exists only for 2-D meshes" in err
    assert not Path("left.vtu").exists()
    assert agglo("run", "boxes:n=2", "--parts", "2", "--metrics", "UF,cut,balance").code == 0


@pytest.mark.parametrize("command", ["run", "compare"])
def test_a_run_from_a_file_and_from_options_are_the_same(agglo: Agglo, command: str) -> None:
    Path("run.toml").write_text(
        "h_factor = [4, 2]\nnested = false\nmerge = true\nseed = 3\nrefiners = []\n"
        'post_refiners = [{ name = "descent", objective = "compactness" }]\n'
    )
    words = "--h-factor 4,2 --not-nested --merge --seed 3 --refiner none"
    words += " --post-refiner descent:objective=compactness"
    mesh = [
        "voronoi:n=200,seed=1",
        "--bisector",
        "coordinate",
        "--metrics",
        "compactness,interface",
        "--json",
    ]
    answers = [
        json.loads(agglo(command, *mesh, *how).out) for how in (["--config", "run.toml"], words.split())
    ]
    levels = [each["runs"][0]["levels"] for each in answers]
    assert levels[0] == levels[1]
    assert [level["target"] for level in levels[0]] == sorted(level["target"] for level in levels[0])
    won = json.loads(agglo(command, *mesh, "--config", "run.toml", "--parts", "5").out)
    assert [level["parts"] for level in won["runs"][0]["levels"]] == [5]


def test_all_bisectors(agglo: Agglo) -> None:
    pick = ["run", "squares:n=4", "--parts", "4", "--json"]
    runs = json.loads(agglo(*pick, "--bisector", "all", "--quiet").out)["runs"]
    assert {"kmeans", "coordinate", "inertial", "sweep"} <= {run["bisector"] for run in runs}


HINTS: dict[str, tuple[list[str], str]] = {
    "a command": (["comparee"], "did you mean 'compare'?"),
    "an option": (["run", "squares:n=4", "--bisctor", "kmeans"], "--bisector"),
    "an option of compare": (["compare", "squares:n=4", "--metric", "UF"], "--metrics"),
    "a command of a plugin's": (["tools", "pant"], "Did you mean 'paint'?"),
    "an option of a plugin's": (["tools", "paint", "--color", "x"], "Did you mean '--colour'?"),
    "an option of a component": (
        ["run", "squares:n=4", "--refiner", "descent:objectiv=cut"],
        "did you mean 'objective'?",
    ),
    "an objective": (
        ["run", "squares:n=4", "--refiner", "descent:objective=blance"],
        "did you mean 'balance'?",
    ),
    "a metric": (["quality", "absent.npz", "--metrics", "convexty"], "did you mean 'convexity'?"),
    "a sample": (["run", "sqares:n=4"], "did you mean 'squares'?"),
}


@pytest.mark.parametrize(("arguments", "hint"), HINTS.values(), ids=HINTS.keys())
def test_a_misspelt_word_names_the_right_one(
    agglo: Agglo, plugin: None, arguments: list[str], hint: str
) -> None:
    code, out, err = agglo(*arguments)
    assert (code, out) == (2, "")
    assert hint in err
