"""Constraints: no part is joined across an edge that one of them forbids, in any mode, at any level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from toy_constraints import Line, Regions, pairs

import agglo_core as agglo
from agglo_core import samples

MODES = {
    "recursive": {},
    "not nested": {"nested": False},
    "merged": {"merge": True},
    "polished": {"post_refiners": ["interface"]},
    "merged and polished": {"merge": True, "post_refiners": ["interface"]},
    "k-way": {"method": "kway"},
    "k-way, not nested": {"method": "kway", "nested": False},
    "k-way, merged and polished": {"method": "kway", "merge": True, "post_refiners": ["interface"]},
    "metis": {"bisector": "metis", "method": "kway"},
    "inertial": {"bisector": "inertial", "refiners": ()},
}


def check(mesh, hierarchy, constraint):
    """Parts are connected without the forbidden edges, counts exact, sizes met, nested if it says so."""
    graph = mesh.graph
    row, column = pairs(graph)
    allowed = ~constraint.forbidden(graph)
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        inside = allowed & (labels[row] == labels[column])
        assert components(graph.n, row[inside], column[inside]) == labels.max() + 1
        if "n_parts" in target:
            assert labels.max() + 1 == target["n_parts"]
        else:
            wide = graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
            assert (np.bincount(labels)[wide] == 1).all()
    if hierarchy.nested:
        for level in range(len(hierarchy.levels) - 1):
            parents = hierarchy.parents(level)
            np.testing.assert_array_equal(parents[hierarchy.levels[level]], hierarchy.levels[level + 1])


def components(n, row, column):
    """Number of components by union and find."""
    root = list(range(n))

    def find(i):
        while root[i] != i:
            i = root[i]
        return i

    for i, j in zip(row.tolist(), column.tolist(), strict=True):
        root[find(i)] = find(j)
    return sum(root[i] == i for i in range(n))


def pieces(mesh, constraint):
    row, column = pairs(mesh.graph)
    allowed = ~constraint.forbidden(mesh.graph)
    return components(mesh.graph.n, row[allowed], column[allowed])


def one_region_each(labels, regions):
    return all(len(set(regions[labels == part])) == 1 for part in range(labels.max() + 1))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sample", ["squares:8", "voronoi:n=70,seed=3", "boxes:4", "tetrahedra:2"])
def test_no_part_crosses_in_any_mode(sample, mode):
    mesh = samples.from_spec(sample)
    regions = (mesh.cell_centroids[:, 0] > 0.45).astype(int) + 2 * (mesh.cell_centroids[:, 1] > 0.6)
    regions, line = Regions(regions), Line()
    for constraint in (regions, line):
        least = pieces(mesh, constraint)
        for target in ({"h_factor": (1.3, 2, 30)}, {"n_parts": (least + 9, least)}):
            options = dict(MODES[mode])
            if "n_parts" in target:
                options.pop("merge", None)
            hierarchy = agglo.agglomerate(mesh, constraints=[constraint], **options, **target)
            check(mesh, hierarchy, constraint)
    for labels in hierarchy.levels:
        assert one_region_each(labels, mesh.cell_centroids[:, 0] > 0.5)
    assert hierarchy.parts[-1] == 2


@settings(max_examples=30)
@given(st.data())
def test_random_regions(data):
    mesh = data.draw(st.sampled_from([samples.voronoi(50, 1), samples.disconnected(4), samples.boxes(3)]))
    kinds = data.draw(st.integers(1, 4))
    seed = data.draw(st.integers(0, 1000))
    regions = Regions(np.random.default_rng(seed).integers(0, kinds, mesh.n_cells))
    options = dict(MODES[data.draw(st.sampled_from(sorted(MODES)))])
    least = pieces(mesh, regions)
    if data.draw(st.booleans()):
        options.pop("merge", None)
        counts = st.lists(st.integers(least, mesh.n_cells), min_size=1, max_size=3)
        target = {"n_parts": data.draw(counts)}
    else:
        target = {"h_factor": data.draw(st.lists(st.floats(0.5, 12), min_size=1, max_size=3))}
    hierarchy = agglo.agglomerate(mesh, constraints=[regions], seed=seed, **options, **target)
    check(mesh, hierarchy, regions)
    assert all(one_region_each(labels, regions.regions) for labels in hierarchy.levels)


def test_a_region_is_agglomerated_as_if_it_were_alone():
    """What is joined to nothing is a mesh of its own: the outer boundary of a region is where it ends."""
    mesh = samples.squares(8)
    left = np.flatnonzero(mesh.cell_centroids[:, 0] < 0.5)
    both = agglo.agglomerate(mesh, constraints=[Line()], bisector="inertial", h_star=0.3).levels[0]
    graph = mesh.graph.subgraph(left, [0, len(left)])
    alone = agglo.agglomerate(graph, bisector="inertial", h_star=0.3).levels[0]
    assert len(set(zip(both[left], alone, strict=True))) == alone.max() + 1 == len(set(both[left]))


def test_several_constraints_hold_together():
    mesh = samples.squares(6)
    upper = Regions(mesh.cell_centroids[:, 1] > 0.5)
    hierarchy = agglo.agglomerate(mesh, constraints=[Line(), upper], h_factor=100)
    assert hierarchy.parts == [4]


def test_a_barrier_with_an_open_end_is_not_crossed_but_gone_around():
    mesh = samples.squares(8)
    barrier = Line(above=0.3)
    assert agglo.agglomerate(mesh, constraints=[barrier], n_parts=1).parts == [1]
    for mode in ({}, {"method": "kway"}):
        check(mesh, agglo.agglomerate(mesh, constraints=[barrier], n_parts=(12, 5, 1), **mode), barrier)


def test_the_hierarchy_keeps_the_whole_graph():
    mesh = samples.squares(6)
    hierarchy = agglo.agglomerate(mesh, constraints=[Line()], n_parts=4)
    assert hierarchy.graph is mesh.graph
    assert hierarchy.graph.coarsen(hierarchy.levels[0]).components().max() == 0


@pytest.mark.parametrize("options", [{}, {"method": "kway"}, {"bisector": "spectral", "n_parts": 9}])
def test_a_constraint_that_forbids_nothing_changes_nothing(options):
    mesh = samples.voronoi(60, seed=4)
    plain = agglo.agglomerate(mesh, **options)
    free = agglo.agglomerate(mesh, constraints=[Regions(np.zeros(60))], **options)
    for one, other in zip(plain.levels, free.levels, strict=True):
        np.testing.assert_array_equal(one, other)


# --- graphs without edges ---------------------------------------------------------------------------


def test_outlines_stay_when_edges_are_taken_out():
    graph = samples.voronoi(40, seed=2).graph
    cut = graph.without_edges(Line().forbidden(graph))
    cut.check()
    assert len(cut.indices) < len(graph.indices)

    def outline(each):
        return each.boundary + each.to_scipy().sum(axis=1)

    np.testing.assert_allclose(outline(cut), outline(graph), rtol=1e-14)
    assert cut.boundary.sum() > graph.boundary.sum() + 0.9  # twice the line, which has the height of the mesh


def test_the_mask_of_edges_is_checked():
    graph = samples.squares(3).graph
    assert graph.without_edges(np.zeros(len(graph.indices), bool)) is graph
    for bad in (np.zeros(3, bool), np.zeros(len(graph.indices), int)):
        with pytest.raises(agglo.MeshError, match="removed must be a mask of shape"):
            graph.without_edges(bad)
