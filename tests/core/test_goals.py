"""Targets: one kind at a time, resolved against the mesh, finest first; nonsense is refused."""

from __future__ import annotations

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Graph, Mesh, OptionError, samples
from agglo_core.agglomeration.targets import resolve_targets

GRID = samples.squares(4)


def resolved(**targets):
    return resolve_targets(GRID.graph, GRID.h, **targets)


def test_default_is_two_four_eight_mesh_sizes():
    levels = resolved()
    assert levels.sizes == pytest.approx([np.sqrt(2) / 4 * f for f in (2, 4, 8)], rel=1e-14)
    assert [each["h_factor"] for each in levels.asked] == [2, 4, 8]
    assert [each["h_star"] for each in levels.asked] == list(levels.sizes)
    assert levels.counts == ()


def test_sizes_come_finest_first_and_repeats_stay():
    assert resolved(h_star=(0.5, 0.2, 0.5)).sizes == (0.2, 0.5, 0.5)
    assert resolved(h_star=0.3).sizes == (0.3,)
    assert resolved(h_star=np.array([0.5, 0.2])).sizes == (0.2, 0.5)
    assert resolved(h_star=np.float32(0.5)).sizes == (0.5,)


def test_counts_come_finest_first_and_repeats_stay():
    levels = resolved(n_parts=[2, 7, 2])
    assert levels.counts == (7, 2, 2)
    assert levels.sizes == ()
    assert [dict(each) for each in levels.asked] == [{"n_parts": 7}, {"n_parts": 2}, {"n_parts": 2}]
    assert resolved(n_parts=np.int64(3)).counts == (3,)
    assert resolved(n_parts=16).counts == (16,)


@pytest.mark.parametrize(
    ("per_part", "parts"), [(1, 16), (2, 8), (3, 5), (4, 4), (6, 3), (6.4, 3), (10, 2), (32, 1), (1e300, 1)]
)
def test_cells_per_part_is_the_nearest_count(per_part, parts):
    levels = resolved(cells_per_part=per_part)
    assert levels.counts == (parts,)
    assert levels.asked[0] == {"n_parts": parts, "cells_per_part": per_part}


def test_mesh_size_of_a_graph_is_that_of_its_mesh():
    mesh = samples.voronoi(30, seed=4)
    assert resolve_targets(mesh.graph, None).sizes == pytest.approx([2 * mesh.h, 4 * mesh.h, 8 * mesh.h])
    from_mesh, from_graph = agglo.agglomerate(mesh), agglo.agglomerate(mesh.graph)
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
    assert resolved(n_parts=value).counts == (2,)


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
        agglo.agglomerate(graph)
    assert agglo.agglomerate(graph, n_parts=1).parts == [1]


def test_a_mesh_of_one_cell():
    mesh = Mesh.from_polygons([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    assert agglo.agglomerate(mesh).parts == [1, 1, 1]
    assert agglo.agglomerate(mesh, n_parts=1).parts == [1]
    assert agglo.agglomerate(mesh, h_star=0.1).statistics["oversized_cells"] == 1
