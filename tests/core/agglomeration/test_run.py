"""The border: every way a component can misbehave ends in a PluginError that names it."""

from __future__ import annotations

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import OptionError, PluginError, samples
from agglo_core.agglomeration.border import bisect_by_block
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import splitmix
from agglo_core.registry.attribution import Member

GRID = samples.squares(4)


class Bisector:
    """A bisector whose output is what a function of the graph says."""

    def __init__(self, output, fallback=None):
        self.output = output
        if fallback is not None:
            self.fallback = fallback

    def bisect(self, graph, rng):
        return self.output(graph)


class Level(Bisector):
    def bisect_level(self, level, seeds):
        return self.output(level)


class Refiner:
    objective = "none"

    def __init__(self, output):
        self.output = output

    def refine(self, graph, labels, seeds, target):
        return self.output(graph, labels)


class Fixer:
    def __init__(self, output):
        self.output = output

    def fix(self, graph, labels):
        return self.output(graph, labels)


class Parts:
    def __init__(self, output):
        self.output = output

    def partition(self, graph, target, seed):
        return self.output(graph, target)


def halves(graph):
    return (np.arange(graph.n) % 2).astype(float)


def checkered(graph):
    """Sides that no refiner is asked about and the fixer must mend."""
    return np.arange(graph.n) % 2


def overwrite(array):
    array[0] = 1
    return array


def explode(*_):
    raise KeyError("a bug of the component")


def leave(*_):
    raise SystemExit(3)


def only_last(graph, value=1, dtype=int):
    sides = np.zeros(graph.n, dtype)
    sides[-1] = value
    return sides


BAD_SIDES = {
    "too short": (lambda g: np.zeros(g.n - 1), "shape"),
    "two columns": (lambda g: np.zeros((g.n, 2)), "shape"),
    "a number": (lambda g: 1, "shape"),
    "nothing": (lambda g: None, "returned None, expected"),
    "text": (lambda g: np.array(["a"] * g.n), "expected integers, booleans or floats"),
    "objects": (lambda g: only_last(g, dtype=object), "expected integers, booleans or floats"),
    "complex": (lambda g: only_last(g, dtype=complex), "expected integers, booleans or floats"),
    "NaN": (lambda g: only_last(g, np.nan, float), r"NaN or outside \[0, 1\]"),
    "above one": (lambda g: only_last(g, 1.01, float), r"NaN or outside \[0, 1\]"),
    "below zero": (lambda g: only_last(g, -1e-9, float), r"NaN or outside \[0, 1\]"),
    "three sides": (lambda g: only_last(g, 2), "expected 0 and 1"),
    "negative side": (lambda g: only_last(g, -1), "expected 0 and 1"),
    "one side": (lambda g: np.zeros(g.n, int), "all 16 cells of a piece on one side"),
    "low probabilities": (lambda g: np.full(g.n, 0.49), "all 16 cells of a piece on one side"),
    "the other side": (lambda g: np.ones(g.n, bool), "all 16 cells of a piece on one side"),
    "raises": (explode, "raised KeyError.*a bug of the component"),
    "exits": (leave, "SystemExit"),
    "writes on its input": (lambda g: overwrite(g.centroids)[:, 0], "read-only"),
}


@pytest.mark.parametrize("form", [Bisector, Level])
@pytest.mark.parametrize("name", BAD_SIDES)
def test_bad_sides(name, form):
    output, message = BAD_SIDES[name]
    with pytest.raises(PluginError, match=message) as caught:
        agglo.agglomerate(GRID, bisector=form(output), n_parts=2)
    assert f"bisector {form.__name__}" in str(caught.value)


@pytest.mark.parametrize(
    "output",
    [
        lambda g: only_last(g).tolist(),
        lambda g: only_last(g, dtype=bool),
        lambda g: only_last(g, dtype=np.uint8),
        lambda g: only_last(g, dtype=np.float32),
        lambda g: only_last(g, 0.5, float),  # 1 iff p >= 0.5
    ],
)
@pytest.mark.parametrize("form", [Bisector, Level])
def test_good_sides_of_any_type(form, output):
    labels = agglo.agglomerate(GRID, bisector=form(output), refiners=(), n_parts=2, polish=False).levels[0]
    assert sorted(np.bincount(labels)) == [1, 15]


def test_blocks_may_answer_in_different_types():
    def output(graph):
        return only_last(graph) if graph.n % 2 else only_last(graph, 0.75, float)

    assert agglo.agglomerate(samples.voronoi(31), bisector=Bisector(output), n_parts=7).parts == [7]


BAD_LABELS = {
    "too short": (lambda g, x: x[:-1], "shape"),
    "floats": (lambda g, x: x * 1.0, "float64"),
    "nothing": (lambda g, x: None, "returned None, expected"),
    "emptied": (lambda g, x: x * 0, "emptied part 1 of block 0"),
    "new label": (lambda g, x: np.arange(g.n) % 3, "created"),
    "negative": (lambda g, x: x - 1, "created"),
    "raises": (explode, "raised KeyError.*a bug of the component"),
    "exits": (leave, "SystemExit"),
    "writes on its input": (lambda g, x: overwrite(x), "read-only"),
}


@pytest.mark.parametrize("name", BAD_LABELS)
def test_bad_labels_of_a_refiner(name):
    output, message = BAD_LABELS[name]
    with pytest.raises(PluginError, match=message) as caught:
        agglo.agglomerate(GRID, refiners=["interface", Refiner(output)], n_parts=2)
    assert "refiner Refiner" in str(caught.value)


@pytest.mark.parametrize("name", [*BAD_LABELS, "disconnected"])
def test_bad_labels_of_a_fixer(name):
    output, message = BAD_LABELS.get(name, (lambda g, x: x, "left a part disconnected"))
    with pytest.raises(PluginError, match=message) as caught:
        agglo.agglomerate(GRID, bisector=Bisector(checkered), refiners=(), fixer=Fixer(output), n_parts=2)
    assert "fixer Fixer" in str(caught.value)


def test_the_fixer_sees_only_blocks_in_need():
    def refuse(graph, labels):
        raise AssertionError("nothing to fix")

    assert agglo.agglomerate(GRID, fixer=Fixer(refuse), n_parts=4).statistics["repairs"] == 0
    broken = agglo.agglomerate(GRID, bisector=Bisector(checkered), refiners=(), n_parts=2)
    assert broken.statistics["repairs"] == 1


def test_a_label_moved_to_another_block_is_noticed():
    """Both labels are in use, but not both in each block."""

    def output(graph, labels):
        if graph.n_blocks == 1:
            return labels
        moved = labels.copy()
        moved[: graph.offsets[1]] = 1
        return moved

    with pytest.raises(PluginError, match="Refiner emptied part 0 of block 0"):
        agglo.agglomerate(GRID, refiners=[Refiner(output)], n_parts=4)


BAD_PARTS = {
    "too short": (lambda g, t: np.zeros(g.n - 1, int), "shape"),
    "floats": (lambda g, t: np.zeros(g.n), "float64"),
    "too many": (lambda g, t: np.arange(g.n), r"labels 0\.\.15, but there are 5 parts"),
    "negative": (lambda g, t: np.arange(g.n) % 5 - 1, r"labels -1\.\.3, but there are 5 parts"),
    "raises": (explode, "raised KeyError"),
}


@pytest.mark.parametrize("name", BAD_PARTS)
def test_bad_partitions(name):
    output, message = BAD_PARTS[name]
    with pytest.raises(PluginError, match=message) as caught:
        agglo.agglomerate(GRID, bisector=Parts(output), method="kway", n_parts=5)
    assert "bisector Parts" in str(caught.value)


@pytest.mark.parametrize("fallback", ["inertial", ("kmeans_sklearn", {"n_init": 20})])
@pytest.mark.parametrize("form", [Bisector, Level])
def test_a_one_sided_model_is_repaired_by_its_fallback_and_counted(form, fallback):
    def model(graph):
        """Splits level graphs of four cells, gives up on anything else."""
        sizes = np.diff(graph.offsets)[graph.block_ids]
        place = np.arange(graph.n) - graph.offsets[graph.block_ids]
        return np.where(sizes == 4, place // 2, 0.0)

    result = agglo.agglomerate(GRID, bisector=form(model, fallback), n_parts=8)
    assert result.parts == [8]
    assert result.statistics["fallbacks"] == 3
    assert result.statistics["bisections"] == 7


def test_a_fallback_that_fails_too_is_named():
    class Worse(Bisector):
        pass

    run = Run(
        bisector=Member(Bisector(lambda g: np.zeros(g.n)), "the model"),
        refiners=(),
        post_refiners=(),
        fixer=Member(Fixer(lambda g, x: x), "the fixer"),
        fallback=Member(Worse(lambda g: np.zeros(g.n)), "its fallback"),
    )
    with pytest.raises(PluginError, match="its fallback"):
        run.bisect(GRID.graph, np.zeros(1, np.uint64))


def test_an_unknown_fallback_is_refused_before_the_run():
    with pytest.raises((PluginError, OptionError), match="nothing"):
        agglo.agglomerate(GRID, bisector=Bisector(halves, "nothing"), n_parts=2)


# --- one piece at a time --------------------------------------------------------------------------------


def test_the_simple_way_gets_one_block_and_its_own_generator_at_a_time():
    level = GRID.graph.split(np.arange(16) // 4)[0]
    seen = []

    class Spy:
        def bisect(self, graph, rng):
            assert graph.n_blocks == 1
            assert len(graph.indptr) == graph.n + 1
            assert graph.indices.max() < graph.n
            seen.append((graph.centroids.copy(), rng.random()))
            return np.arange(graph.n) % 2

    seeds = np.array([5, 6, 5, 2**64 - 1], np.uint64)
    sides = bisect_by_block(Spy(), level, seeds)
    np.testing.assert_array_equal(sides, np.tile([0, 1], 8))
    np.testing.assert_array_equal(np.concatenate([each for each, _ in seen]), level.centroids)
    numbers = [number for _, number in seen]
    assert numbers[0] == numbers[2]
    assert len(set(numbers)) == 3
    assert numbers[1] == np.random.default_rng(6).random()


def test_splitmix_is_the_published_generator():
    """First outputs of splitmix64 from state 0 and 1234567 (Vigna's reference code)."""
    np.testing.assert_array_equal(splitmix(np.array([0], np.uint64)), [0xE220A8397B1DCDAF])
    state, step = np.uint64(1234567), np.uint64(0x9E3779B97F4A7C15)
    states = state + np.arange(3, dtype=np.uint64) * step
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    np.testing.assert_array_equal(splitmix(states), np.array(expected, np.uint64))


def test_checked_output_is_read_only():
    assert not agglo.agglomerate(GRID, n_parts=4).levels[0].flags.writeable
