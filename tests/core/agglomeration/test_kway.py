"""Direct k-way partitions: exact counts and connected parts whatever the partitioner returns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import samples

MESHES = [samples.voronoi(70, seed=1), samples.disconnected(5), samples.tetrahedra(2)]


class Scatter:
    """Any labels at all: disconnected, unbalanced, with gaps."""

    def __init__(self, share=1.0):
        self.share = share
        self.calls = []

    def partition(self, graph, target, seed):
        self.calls.append((graph.n, target.parts, graph.n_blocks))
        used = max(1, int(self.share * target.parts))
        return np.random.default_rng(seed).integers(0, used, graph.n) * (target.parts // used)


@settings(max_examples=25)
@given(st.sampled_from(MESHES), st.integers(2, 50), st.floats(0.01, 1), st.integers(0, 100), st.booleans())
def test_any_partition_becomes_an_exact_connected_one(mesh, parts, share, seed, nested):
    result = agglo.agglomerate(
        mesh, bisector=Scatter(share), method="kway", n_parts=[parts, 2], seed=seed, nested=nested
    )
    assert result.parts == [parts, 2]
    for labels in result.levels:
        assert len(np.unique(mesh.graph.components(labels))) == labels.max() + 1
    if nested:
        np.testing.assert_array_equal(result.parents(0)[result.levels[0]], result.levels[1])


def test_components_share_the_parts_and_are_partitioned_one_at_a_time():
    scatter = Scatter()
    agglo.agglomerate(samples.disconnected(6), bisector=scatter, method="kway", n_parts=10)
    assert scatter.calls == [(36, 5, 1), (36, 5, 1)]


def test_nested_levels_partition_the_level_below_and_others_the_mesh():
    mesh = samples.squares(8)
    nested, loose = Scatter(), Scatter()
    agglo.agglomerate(mesh, bisector=nested, method="kway", n_parts=[16, 4, 2])
    agglo.agglomerate(mesh, bisector=loose, method="kway", n_parts=[16, 4, 2], nested=False)
    assert [(n, k) for n, k, _ in nested.calls] == [(64, 16), (16, 4), (4, 2)]
    assert [(n, k) for n, k, _ in loose.calls] == [(64, 16), (64, 4), (64, 2)]


@pytest.mark.parametrize("bisector", ["kmeans", "metis", Scatter()])
@pytest.mark.parametrize("mesh", MESHES)
def test_sizes_are_met(bisector, mesh):
    result = agglo.agglomerate(mesh, bisector=bisector, method="kway", h_factor=(1.3, 2, 3))
    for labels, target in zip(result.levels, result.targets, strict=True):
        alone = np.bincount(labels) == 1
        diameters = mesh.graph.part_diameters(labels)
        assert (alone | (diameters <= target["h_star"] * (1 + 1e-9))).all()
        assert len(np.unique(mesh.graph.components(labels))) == labels.max() + 1


def test_one_part_needs_no_partitioner():
    scatter = Scatter()
    result = agglo.agglomerate(samples.disconnected(3), bisector=scatter, method="kway", n_parts=2)
    assert result.parts == [2]
    assert scatter.calls == []


def test_the_papers_ratios_of_metis():
    """Independent k-way partitions into n/4, n/16 and n/64 parts, as the paper compares with."""
    mesh = samples.voronoi(256, seed=3)
    result = agglo.agglomerate(
        mesh, bisector="metis", method="kway", cells_per_part=(4, 16, 64), nested=False
    )
    assert result.parts == [64, 16, 4]
