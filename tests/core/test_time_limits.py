"""Limits of seconds: searches end with what is best so far, and runs tell that they did."""

from __future__ import annotations

import json

import numpy as np
import pytest

from agglo_core import OptionError, agglomerate, samples
from agglo_core.anneal.refiner import AnnealRefiner
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.progress import TimeLimit, noted_limits
from agglo_kmeans.kmeans import KMeans

MESH = samples.voronoi(1200, seed=6)
ENDED = "the time limit stopped"


def kway(objective: str, seconds: float | None, effort: str = "best", **target):
    options = {"effort": effort, "objective": objective, "seconds": seconds}
    return agglomerate(MESH, bisector=("kmeans", options), method="kway", **target)


def test_a_limit_is_noted_once_and_only_where_it_ended_something() -> None:
    with noted_limits() as noted:
        assert not TimeLimit().over()
        assert not TimeLimit(1e6).over()
        short = TimeLimit(1e-9)
        while not short.over():
            pass
        assert short.over()
    assert noted == [1e-9]
    assert short.over()


@pytest.mark.parametrize("objective", ["solver", "roundness"])
def test_what_is_best_so_far_is_valid_and_no_worse_than_recursion(objective: str) -> None:
    kway(objective, None, "fast", n_parts=75)  # compiles
    score = OBJECTIVES["solver"].value
    for seconds in (1e-6, 0.02):
        result = kway(objective, seconds, n_parts=75)
        labels = result.levels[0]
        assert result.statistics["time_limits"] == 1
        assert labels.max() == 74
        assert len(np.unique(MESH.graph.components(labels))) == 75
        halved = agglomerate(MESH, n_parts=75).levels[0]
        if objective == "solver":
            assert score(MESH.graph, labels) <= score(MESH.graph, halved) * (1 + 1e-9)
        sized = kway(objective, seconds, h_star=0.2)
        assert sized.statistics["time_limits"] == 1
        assert MESH.graph.part_diameters(sized.levels[0]).max() <= 0.2 * (1 + 1e-9)


@pytest.mark.parametrize("objective", ["solver", "roundness"])
def test_a_limit_that_is_not_met_changes_nothing(objective: str) -> None:
    free, limited = (kway(objective, seconds, "fast", n_parts=75) for seconds in (None, 1e6))
    np.testing.assert_array_equal(free.levels[0], limited.levels[0])
    assert free.statistics["time_limits"] == limited.statistics["time_limits"] == 0


def test_each_level_has_its_own_limit() -> None:
    assert kway("solver", 1e-6, n_parts=(75, 20)).statistics["time_limits"] == 2


@pytest.mark.parametrize("objective", ["solver", "roundness"])
def test_the_refiner_ends_as_well(objective: str) -> None:
    options = {"moves": 100_000, "objective": objective, "seconds": 0.01}
    result = agglomerate(MESH, n_parts=75, post_refiners=[("anneal", options)])
    assert result.statistics["time_limits"] == 1
    labels = result.levels[0]
    assert labels.max() == 74
    assert len(np.unique(MESH.graph.components(labels))) == 75


@pytest.mark.parametrize("seconds", [0, -1.0, np.inf, np.nan, True, "1"])
def test_other_seconds_are_refused(seconds: object) -> None:
    with pytest.raises(OptionError, match="seconds"):
        KMeans(effort="fast", seconds=seconds)
    with pytest.raises(OptionError, match="seconds"):
        AnnealRefiner(seconds=seconds)


@pytest.mark.parametrize("options", [{"seconds": 1.0}, {"objective": "roundness"}])
def test_options_of_an_effort_without_one_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(OptionError, match="require an effort"):
        KMeans(**options)


def test_the_command_line_says_that_a_limit_ended_the_search(agglo) -> None:
    given = "run", "voronoi:1200,seed=6", "--method", "kway", "--parts", "75", "--bisector"
    done = agglo(*given, "kmeans:effort=best,seconds=0.001")
    assert done.code == 0, done.err
    assert f"{ENDED} a search; the results are the best parts found until then" in " ".join(done.out.split())
    data = json.loads(agglo(*given, "kmeans:effort=best,seconds=0.001", "--json").out)
    assert data["runs"][0]["statistics"]["time_limits"] == 1
    assert ENDED not in agglo(*given, "kmeans:effort=fast").out
