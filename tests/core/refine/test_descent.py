"""The refiner descent: objectives fall, metrics rise, parts stay whole and large enough."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from agglo_core import Mesh, OptionError, PluginError, agglomerate, quality, samples
from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.conformance.base.subject import subject_of
from agglo_core.conformance.engine.judging import judge, laws_for
from agglo_core.graph import Graph, moves
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import IncrementalMetric, Target
from agglo_core.refine.articulation import cut_cells
from agglo_core.refine.descent import DescentRefiner
from agglo_core.registry import Component, default, hookimpl

INCREMENTAL = [name for name, each in OBJECTIVES.items() if each.changes is not None]
METRICS = ["interface_length", "cut", "ncut", "isoperimetric"]
SEEDS = np.zeros(1, np.uint64)


class Weights:
    """A metric of a stranger: the negative of the squared weight, which is better the higher."""

    better, bounds, homogeneity = "high", (-np.inf, 0.0), 4

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        return -(np.bincount(labels, mesh.graph.weights) ** 2)

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        return -moves.squared_weight_changes(graph, labels, cells, parts)


class Touchy(Weights):
    """Its values look at the neighbours of the moved cell, so that moves influence each other."""

    better = "low"

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        self.requests = getattr(self, "requests", 0) + 1
        return np.where(self.requests % 2 == 1, -1.0, -2.0) * np.ones(len(cells))


def refined(graph: Graph, labels: Int, objective: str | IncrementalMetric, sweeps: int = 60) -> Int:
    return DescentRefiner(objective, sweeps).refine(graph, labels, SEEDS, Target())


def ragged(mesh: Mesh, k: int) -> Int:
    """Stripes with ragged borders."""
    x = mesh.local_centroids[:, 0]
    noise = np.random.default_rng(0).normal(0.0, 0.04 * np.ptp(x), len(x))
    rank = np.argsort(np.argsort(x + noise))
    return frozen_int(rank * k // len(x))


@pytest.mark.parametrize("name", INCREMENTAL)
def test_objectives_fall(name: str) -> None:
    graph = samples.voronoi(300, seed=2).graph
    labels = ragged(samples.voronoi(300, seed=2), 6)
    before, after = (OBJECTIVES[name].value(graph, each) for each in (labels, refined(graph, labels, name)))
    assert after < 0.97 * before or (name == "balance" and after < before)


@pytest.mark.parametrize("name", METRICS)
def test_metrics_improve(name: str) -> None:
    mesh = samples.voronoi(300, seed=2)
    labels = ragged(mesh, 6)
    result = refined(mesh.graph, labels, name)
    before, after = (quality(mesh, each, [name])[name].sum() for each in (labels, result))
    assert (after > 1.2 * before) if name == "isoperimetric" else (after < 0.9 * before)


@pytest.mark.parametrize("name", METRICS)
def test_changes_of_metrics_are_differences_of_their_sums(name: str) -> None:
    mesh = samples.voronoi(40, seed=3)
    labels = agglomerate(mesh, n_parts=6, bisector="inertial").levels[0]
    cells, parts = moves.boundary_moves(mesh.graph, labels)
    lone = np.bincount(labels)[labels[cells]] == 1
    cells, parts = frozen_int(cells[~lone]), frozen_int(parts[~lone])
    metric = default().build("metric", name)
    before = metric.measure(mesh, labels).sum()
    for cell, part, change in zip(
        cells, parts, metric.changes(mesh.graph, labels, cells, parts), strict=True
    ):
        moved = labels.copy()
        moved[cell] = part
        assert metric.measure(mesh, moved).sum() - before == pytest.approx(change, abs=1e-9 * abs(before))


def test_parts_keep_their_pieces_and_their_size() -> None:
    mesh = samples.voronoi(300, seed=2)
    graph, labels = mesh.graph, ragged(mesh, 6)
    result = refined(graph, labels, "compactness")

    def pieces(parts: Int) -> Int:
        component = graph.components(parts)
        return np.bincount(parts[np.unique(component, return_index=True)[1]], minlength=6)

    assert (pieces(result) <= pieces(labels)).all()
    sizes = [np.bincount(each, graph.measures) for each in (labels, result)]
    assert (sizes[1] >= 0.85 * sizes[0] - 1e-12).all()
    assert (result != labels).any()


def test_of_two_parts_none_falls_below_the_smaller_one() -> None:
    graph = samples.squares(8).graph
    labels = frozen_int(np.arange(64) >= 16)
    result = refined(graph, labels, "balance")
    assert np.bincount(result).tolist() == [32, 32]  # the larger part may well give up half of its cells


_ELSEWHERE = ("same_in_another_process",)  # a metric is registered in this process alone


def test_a_metric_of_a_stranger_by_name_and_as_an_object(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = samples.squares(8).graph
    labels = frozen_int(np.arange(64) >= 16)
    wanted = refined(graph, labels, "balance")
    tool = DescentRefiner(Weights())
    assert (tool.objective, type(tool.metric)) == ("Weights", Weights)
    np.testing.assert_array_equal(tool.refine(graph, labels, SEEDS, Target()), wanted)
    with registered(monkeypatch, "evenness", Weights):
        np.testing.assert_array_equal(refined(graph, labels, "evenness"), wanted)


@pytest.mark.slow
def test_laws_hold_for_a_metric_of_a_stranger(monkeypatch: pytest.MonkeyPatch) -> None:
    with registered(monkeypatch, "evenness", Weights):
        subject = subject_of("refiner:descent", options={"objective": "evenness"})
        laws = [law for law in laws_for(subject) if law.name in ("answers", "objective_kept", *_ELSEWHERE)]
        failed = [law.name for law in laws if not judge(law, subject).passed]
    assert (len(laws), failed) == (3, [*_ELSEWHERE])


def test_moves_that_do_not_help_together_are_taken_back() -> None:
    graph = samples.squares(6).graph
    labels = frozen_int(np.arange(36) // 18)
    assert refined(graph, labels, Touchy(), sweeps=5).tolist() == labels.tolist()


def test_the_number_of_sweeps_is_bounded() -> None:
    mesh = samples.voronoi(300, seed=2)
    labels = ragged(mesh, 2)
    assert np.count_nonzero(refined(mesh.graph, labels, "interface", sweeps=3) != labels) <= 3


def test_cells_that_hold_a_part_together_are_found() -> None:
    graph = samples.squares(3).graph
    ring = frozen_int([0, 0, 0, 0, 1, 0, 0, 0, 0])
    hook = frozen_int([0, 0, 0, 1, 1, 0, 1, 1, 0])
    assert not cut_cells(graph.indptr, graph.indices, ring).any()
    assert np.flatnonzero(cut_cells(graph.indptr, graph.indices, hook)).tolist() == [1, 2, 5]
    rng = np.random.default_rng(4)
    graph = samples.voronoi(80, seed=5).graph
    labels = frozen_int(rng.integers(2, size=graph.n))
    pieces = graph.components(labels).max() + 1
    for cell, cut in enumerate(cut_cells(graph.indptr, graph.indices, labels)):
        alone = labels.copy()
        alone[cell] = 2
        assert cut == (graph.components(alone).max() + 1 > pieces + 1)


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (
            "compactnes",
            r"no objective is named 'compactnes' \(did you mean 'compactness'\?\); there are inter",
        ),
        ("isoperimetri", "did you mean 'isoperimetric'"),
        ("diameter", "objective 'diameter' cannot evaluate single moves; use one of interface, cut, "),
        ("CR", "metric 'CR' .* cannot be optimised: it has no method changes"),
        (object(), "metric object cannot be optimised"),
    ],
)
def test_what_cannot_be_pursued_is_refused(objective: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        DescentRefiner(objective)


def test_options_and_answers_of_a_wrong_kind_are_refused() -> None:
    for sweeps in (0, 2.5, True):
        with pytest.raises(OptionError, match="sweeps must be a whole number, 1 or more"):
            DescentRefiner(sweeps=sweeps)  # type: ignore[arg-type]
    short = Weights()
    short.changes = lambda graph, labels, cells, parts: np.zeros(1)  # type: ignore[method-assign]
    graph = samples.squares(4).graph
    with pytest.raises(PluginError, match=r"metric Weights: changes returned shape \(1,\)"):
        refined(graph, frozen_int(np.arange(16) // 8), short)


def test_it_works_in_a_run_as_refiner_and_as_post_refiner() -> None:
    mesh = samples.voronoi(400, seed=1)
    plain = agglomerate(mesh, n_parts=8, bisector="coordinate", refiners=(), polish=False)
    chosen = ("descent", {"objective": "compactness"})
    for how in ({"refiners": (chosen,), "polish": False}, {"refiners": (), "post_refiners": (chosen,)}):
        better = agglomerate(mesh, n_parts=8, bisector="coordinate", **how)  # type: ignore[arg-type]
        values = [OBJECTIVES["compactness"].value(mesh.graph, each.levels[0]) for each in (plain, better)]
        assert values[1] < values[0]


class registered:
    """Context in which a class is the metric of that name."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str, target: type) -> None:
        home = SimpleNamespace(Target=target)
        monkeypatch.setitem(__import__("sys").modules, f"{name}_home", home)
        self.name, self.component = name, Component("metric", name, f"{name}_home:Target")

    def __enter__(self) -> None:
        plugin = SimpleNamespace(agglo_components=hookimpl(lambda: [self.component]))
        default().register(plugin, self.name)

    def __exit__(self, *_: object) -> None:
        default().unregister(self.name)
