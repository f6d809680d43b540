"""Goals: one kind of target at a time, resolved against the mesh, finest first; nonsense is refused."""

from __future__ import annotations

import logging
from itertools import pairwise
from math import log

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import Graph, Mesh, OptionError, samples
from agglo_core.agglomeration.goals import CountGoal, SizeGoal, default_sizes, resolve_goals
from agglo_core.arrays import frozen_int

GRID = samples.squares(4)


def resolved(**targets):
    return resolve_goals(GRID.n_cells, lambda: GRID.h, **targets)


def sizes(goals):
    assert all(isinstance(goal, SizeGoal) for goal in goals)
    return tuple(goal.h_star for goal in goals)


def counts(goals):
    assert all(isinstance(goal, CountGoal) for goal in goals)
    return tuple(goal.parts for goal in goals)


@pytest.mark.parametrize(
    ("cells", "per_part"),
    [
        (1, (8,)),
        (271, (8,)),
        (272, (8, 64)),
        (2172, (8, 64)),
        (2173, (8, 64, 512)),
        (5976, (8, 64, 512)),
        (10**6, (8, 64, 512, 4096, 32768)),
    ],
)
def test_default_is_eight_cells_per_part_and_eight_parts_per_part(cells, per_part):
    assert default_sizes(cells) == per_part
    goals = resolve_goals(cells, lambda: 1.0)
    assert goals == resolve_goals(cells, lambda: 1.0, cells_per_part=per_part)
    assert [goal.requested["cells_per_part"] for goal in goals] == list(per_part)


MESHES = {
    "triangles": lambda n, seed: samples.random_triangles(n // 2 + 4, seed=seed),
    "Voronoi cells": lambda n, seed: samples.voronoi(n, seed=seed),
    "tetrahedra": lambda n, seed: samples.random_tetrahedra(n // 6 + 4, seed=seed),
    "boxes": lambda n, seed: samples.boxes(round((n + seed) ** (1 / 3))),
}


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(sorted(MESHES)), st.integers(30, 1500), st.integers(0, 99))
def test_default_levels_follow_the_formula(family, size, seed):
    mesh = MESHES[family](size, seed)
    n, parts = mesh.n_cells, agglo.agglomerate(mesh).parts
    levels = max(1, round(log(n / 12, 8)))
    assert parts == [max(1, int(n / 8 ** (k + 1) + 0.5)) for k in range(levels)]
    assert all(coarse < fine for fine, coarse in pairwise([n, *parts]))
    assert n < 100 or 4 <= parts[-1] <= 34


def test_factors_are_multiples_of_the_mesh_size():
    goals = resolved(h_factor=(2, 4, 8))
    assert sizes(goals) == pytest.approx([np.sqrt(2) / 4 * f for f in (2, 4, 8)], rel=1e-14)
    assert [goal.requested["h_factor"] for goal in goals] == [2, 4, 8]
    assert tuple(goal.requested["h_star"] for goal in goals) == sizes(goals)
    assert tuple(goal.target.h_star for goal in goals) == sizes(goals)


def test_sizes_come_finest_first_and_repeats_stay():
    assert sizes(resolved(h_star=(0.5, 0.2, 0.5))) == (0.2, 0.5, 0.5)
    assert sizes(resolved(h_star=0.3)) == (0.3,)
    assert sizes(resolved(h_star=np.array([0.5, 0.2]))) == (0.2, 0.5)
    assert sizes(resolved(h_star=np.float32(0.5))) == (0.5,)


def test_counts_come_finest_first_and_repeats_stay():
    goals = resolved(n_parts=[2, 7, 2])
    assert counts(goals) == (7, 2, 2)
    assert [goal.target for goal in goals] == [agglo.Target(parts=k) for k in (7, 2, 2)]
    assert [dict(goal.requested) for goal in goals] == [{"n_parts": 7}, {"n_parts": 2}, {"n_parts": 2}]
    assert counts(resolved(n_parts=np.int64(3))) == (3,)
    assert counts(resolved(n_parts=16)) == (16,)


@pytest.mark.parametrize(
    ("per_part", "parts"), [(1, 16), (2, 8), (3, 5), (4, 4), (6, 3), (6.4, 3), (10, 2), (32, 1), (1e300, 1)]
)
def test_cells_per_part_is_the_nearest_count(per_part, parts):
    (goal,) = resolved(cells_per_part=per_part)
    assert counts([goal]) == (parts,)
    assert goal.requested == {"n_parts": parts, "cells_per_part": per_part}


@pytest.mark.parametrize(
    ("sizes_of_components", "per_part", "parts"),
    [
        ([144, 1, 1], (8, 64, 512), (20, 4, 3)),
        ([700, 100, *[1] * 200], (8, 1000), (300, 202)),
        ([99, 33, 9, 3], (8, 64), (19, 5)),
        ([1] * 7, (8,), (7,)),
    ],
)
def test_small_components_are_parts_beside_the_mean_of_the_others(sizes_of_components, per_part, parts):
    sizes = np.array(sizes_of_components)
    goals = resolve_goals(
        sizes.sum(), lambda: 1.0, cells_per_part=per_part, components=lambda: frozen_int(sizes)
    )
    assert counts(goals) == parts
    assert not any(goal.exact for goal in goals)


def test_mesh_size_of_a_graph_is_that_of_its_mesh():
    mesh = samples.voronoi(30, seed=4)
    from_mesh, from_graph = (agglo.agglomerate(each, h_factor=(2, 4, 8)) for each in (mesh, mesh.graph))
    targets = [each["h_star"] for each in from_graph.targets]
    assert targets == pytest.approx([2 * mesh.h, 4 * mesh.h, 8 * mesh.h])
    for one, other in zip(from_mesh.levels, from_graph.levels, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", ["h_star", "h_factor", "n_parts", "cells_per_part"])
@pytest.mark.parametrize(
    "value", [0, -1, float("nan"), float("inf"), -float("inf"), "0.3", 1j, None, [], (), [0.5, 0], [[2]], {2}]
)
def test_values_that_are_not_positive_and_finite(kind, value):
    if value is None:
        value = [None]
    with pytest.raises(OptionError, match=kind):
        resolved(**{kind: value})


@pytest.mark.parametrize("value", [np.array(2), np.array(2.0)])
def test_zero_dimensional_arrays_are_numbers(value):
    assert counts(resolved(n_parts=value)) == (2,)


@pytest.mark.parametrize("kind", ["h_star", "n_parts"])
def test_booleans_are_not_numbers(kind):
    with pytest.raises(OptionError, match=kind):
        resolved(**{kind: True})


def test_one_kind_at_a_time():
    with pytest.raises(OptionError, match="h_star and n_parts"):
        resolved(h_star=0.3, n_parts=4)


def test_counts_that_do_not_fit():
    with pytest.raises(OptionError, match=r"17.*the mesh has 16 cells"):
        resolved(n_parts=17)
    with pytest.raises(OptionError, match=r"whole number, given 2\.5"):
        resolved(n_parts=2.5)
    with pytest.raises(OptionError, match="too many"):
        resolved(cells_per_part=0.5)
    with pytest.raises(OptionError, match="too many"):
        resolved(n_parts=10**30)


def test_h_factor_needs_a_mesh_size():
    """A bare graph may have no cell vertices: its mesh size is zero, and so would be every target."""
    graph = Graph.from_arrays([0, 1, 2], [1, 0], [[0.0, 0.0], [1.0, 0.0]])
    with pytest.raises(OptionError, match="h_factor"):
        agglo.agglomerate(graph, h_factor=2)
    assert agglo.agglomerate(graph).parts == agglo.agglomerate(graph, n_parts=1).parts == [1]


def test_a_mesh_of_one_cell():
    mesh = Mesh.from_polygons([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    assert agglo.agglomerate(mesh).parts == [1]
    assert agglo.agglomerate(mesh, h_factor=(2, 4, 8)).parts == [1, 1, 1]
    assert agglo.agglomerate(mesh, n_parts=1).parts == [1]
    assert agglo.agglomerate(mesh, h_star=0.1).statistics["oversized_cells"] == 1


SMALL = "numbers of parts by level: 1; level 0 has one part. n_parts=… sets them"
ALIKE = (
    "numbers of parts by level: 1, 1; level 0 has one part, level 1 has as many parts as level 0. n_parts=… "
    "sets them"
)


@pytest.mark.parametrize(
    ("mesh", "targets", "messages"),
    [
        (samples.strip(5), {}, [SMALL]),
        (samples.squares(4), {}, []),
        (samples.squares(4), {"h_factor": (4, 8)}, [ALIKE]),
        (samples.squares(4), {"h_factor": (4, 8), "nested": False}, [ALIKE]),
        (samples.squares(4), {"cells_per_part": 16}, [SMALL]),
        (samples.squares(4), {"n_parts": (4, 4, 1, 1)}, []),
        (
            samples.squares(4),
            {"cells_per_part": (2, 4), "regions": np.arange(16) // 4 % 2 ^ np.arange(16) % 2},
            ["numbers of parts by level: 16, 16; level 1 has as many parts as level 0. n_parts=… sets them"],
        ),
    ],
)
def test_levels_of_one_part_and_equal_levels_are_noted(mesh, targets, messages, caplog):
    with caplog.at_level(logging.INFO, "agglo"):
        agglo.agglomerate(mesh, **targets)
    assert caplog.messages == messages


@pytest.mark.parametrize("targets", [{}, {"n_parts": 4}, {"cells_per_part": 4}])
def test_merge_needs_a_size(targets, tmp_path):
    with pytest.raises(OptionError, match="merge applies to sizes only: give h_star or h_factor"):
        agglo.agglomerate(GRID, merge=True, **targets)
    (tmp_path / "run.toml").write_text("merge = true")  # the size may come from the call
    merged = agglo.agglomerate(GRID, config=tmp_path / "run.toml", h_factor=2)
    assert merged.levels[0].tolist() == agglo.agglomerate(GRID, merge=True, h_factor=2).levels[0].tolist()


def test_weights_and_balance_apply_to_the_default():
    mesh = samples.voronoi(200, seed=3)
    for rule in ({"weights": np.arange(200.0)}, {"balance": "measure"}):
        found, expected = agglo.agglomerate(mesh, **rule), agglo.agglomerate(mesh, **rule, cells_per_part=8)
        np.testing.assert_array_equal(found.levels, expected.levels)
        assert found.statistics["imbalance"] == expected.statistics["imbalance"]
        assert found.parts == [25]
