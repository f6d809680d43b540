"""Rules for parts by keyword: exact cases, refusals, files, the command line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Graph, OptionError, PluginError, samples

FINE = samples.squares(8)  # cell 8 i + j has its centre at ((i + .5) / 8, (j + .5) / 8)
LEFT = FINE.cell_centroids[:, 0] < 0.5
LOW = FINE.cell_centroids[:, 1] < 0.5


def fracture(mesh, height):
    """Faces on x = 1/2 below a height."""
    one, other = mesh.face_cells.T
    left = mesh.cell_centroids[:, 0] < 0.5
    return (other >= 0) & (left[one] != left[other]) & (mesh.cell_centroids[one, 1] < height)


# --- regions, cells that stay alone -------------------------------------------------------------------


def test_regions_by_tag_by_tags_and_by_array():
    mesh = replace(FINE, cell_tags={"rock": LEFT.astype(int), "layer": 7 * LOW})
    by_array = agglo.agglomerate(mesh, n_parts=9, regions=LEFT.astype(int)).levels[0]
    np.testing.assert_array_equal(agglo.agglomerate(mesh, n_parts=9, regions="rock").levels[0], by_array)
    assert agglo.agglomerate(mesh, n_parts=2, regions=LEFT).levels[0].tolist() == (~LEFT).astype(int).tolist()
    quarters = agglo.agglomerate(mesh, n_parts=4, regions=("rock", "layer")).levels[0]
    assert len(set(zip(quarters, LEFT, LOW, strict=True))) == 4
    component = agglo.agglomerate(mesh, n_parts=9, constraints=[("regions", {"tags": "rock"})]).levels[0]
    np.testing.assert_array_equal(component, by_array)
    with pytest.raises(OptionError, match=r"too few parts, 3: .*'regions'.* into 4 components"):
        agglo.agglomerate(mesh, n_parts=3, regions=("rock", "layer"))


def test_cells_outside_where_stay_single():
    for where in (LEFT, "rock", "rock=1", {"rock": [1, 5]}, ["none", "rock"]):
        mesh = replace(FINE, cell_tags={"rock": LEFT.astype(int), "none": 0 * LEFT})
        labels = agglo.agglomerate(mesh, cells_per_part=8, where=where).levels[0]
        sizes = np.bincount(labels)[labels]
        assert (sizes[~LEFT] == 1).all()
        assert (sizes[LEFT] > 1).all()
        assert labels.max() + 1 == 32 + 4  # 32 single cells, and 32 cells in parts of 8
    alone = agglo.agglomerate(FINE, h_factor=(3, 6), where=np.zeros(64, bool))
    assert alone.parts == [64, 64]


# --- barriers -------------------------------------------------------------------------------------------


def test_a_barrier_is_not_gone_around():
    barrier = fracture(FINE, 0.4)
    one, other = FINE.face_cells[barrier].T
    assert agglo.agglomerate(FINE, n_parts=2, barriers=barrier).parts == [2]
    for target in ({"n_parts": (12, 5, 2)}, {"h_star": (0.5, 9.0)}):
        for method in ("recursive", "kway"):
            for labels in agglo.agglomerate(FINE, barriers=barrier, method=method, **target).levels:
                assert (labels[one] != labels[other]).all()
    with pytest.raises(OptionError, match="cannot find 1 parts that satisfy the constraints"):
        agglo.agglomerate(FINE, n_parts=1, barriers=barrier)


def test_the_sides_of_a_barrier_are_continued_beyond_its_tip():
    """With a size that allows one part there are two: the halves on both sides of the fracture."""
    labels = agglo.agglomerate(FINE, h_star=9.0, barriers=fracture(FINE, 0.4)).levels[0]
    assert labels.tolist() == (~LEFT).astype(int).tolist()


def test_barriers_by_tag_value_and_component():
    tag = np.where(fracture(FINE, 0.4), 3, np.where(fracture(FINE, 1.0), 4, 0))
    mesh = replace(FINE, face_tags={"fault": tag})
    assert agglo.agglomerate(mesh, h_star=9.0, barriers="fault").parts == [2]
    for short in ("fault=3", {"fault": 3}, tag == 3):
        np.testing.assert_array_equal(
            agglo.agglomerate(mesh, n_parts=6, barriers=short).levels[0],
            agglo.agglomerate(FINE, n_parts=6, barriers=fracture(FINE, 0.4)).levels[0],
        )
    assert agglo.agglomerate(mesh, h_star=9.0, constraints=[("barriers", {"tags": "fault"})]).parts == [2]


def test_several_barrier_constraints_hold_together():
    """One fracture by keyword, another as a component; a part may reach around either, or both."""
    one, other = FINE.face_cells.T
    low = FINE.cell_centroids[:, 1] < 0.5
    level = (other >= 0) & (low[one] != low[other]) & (FINE.cell_centroids[one, 0] > 0.7)
    mesh = replace(FINE, face_tags={"level": level.astype(int)})
    both = {"barriers": fracture(FINE, 0.3), "constraints": [("barriers", {"tags": "level"})]}
    for target in ({"h_star": 9.0}, {"n_parts": (9, 4)}):
        for labels in agglo.agglomerate(mesh, **both, **target).levels:
            for faces in (level, fracture(FINE, 0.3)):
                i, j = FINE.face_cells[faces].T
                assert (labels[i] != labels[j]).all()


# --- bounds ---------------------------------------------------------------------------------------------


def test_bounds_are_hard_and_counts_exact():
    mesh = samples.voronoi(400, seed=5)
    for method in ("recursive", "kway"):
        hierarchy = agglo.agglomerate(mesh, n_parts=25, max_cells=16, method=method)
        assert set(np.bincount(hierarchy.levels[0])) == {16}
        hierarchy = agglo.agglomerate(
            mesh, n_parts=(50, 25), max_cells=18, min_cells=5, method=method, nested=False
        )
        for labels, k in zip(hierarchy.levels, (50, 25), strict=True):
            sizes = np.bincount(labels)
            assert len(sizes) == k
            assert 5 <= sizes.min() <= sizes.max() <= 18
        assert hierarchy.statistics["small_parts"] == 0
    with pytest.raises(OptionError, match="too few parts, 24: constraint 'max_cells' needs at least 25"):
        agglo.agglomerate(mesh, n_parts=24, max_cells=16)
    most = 3 * mesh.cell_measures.max()
    labels = agglo.agglomerate(mesh, h_factor=6, max_measure=most).levels[0]
    assert np.bincount(labels, mesh.cell_measures).max() <= most * (1 + 1e-9)


def test_bounds_are_of_true_measures_whatever_the_metric():
    for method in ("recursive", "kway"):
        wide = {"metric": 100.0 * np.eye(2), "max_measure": 1 / 16 + 1e-9, "method": method}
        labels = agglo.agglomerate(FINE, n_parts=16, **wide).levels[0]
        assert set(np.bincount(labels)) == {4}
    with pytest.raises(OptionError, match="too few parts, 15: constraint 'max_measure' needs at least 16"):
        agglo.agglomerate(FINE, n_parts=15, **wide)


def loaded(n=400):
    """A mesh with up to 39 people in a cell, none in some."""
    mesh = samples.voronoi(n, seed=5)
    return mesh.with_tags(people=np.random.default_rng(0).integers(0, 40, mesh.n_cells))


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_bounds_on_weights(method):
    mesh = loaded()
    people = mesh.cell_tags["people"]
    merged = agglo.agglomerate(mesh, cells_per_part=1, weights="people", min_weight=100, method=method)
    assert np.bincount(merged.levels[0], people).min() >= 100
    assert merged.statistics["small_parts"] == 0
    assert merged.targets[0]["n_parts"] == merged.parts[0] <= people.sum() // 100
    for target in ({"h_factor": (2, 6)}, {"cells_per_part": (4, 40)}, {"n_parts": 90}):
        hierarchy = agglo.agglomerate(mesh, weights=people, max_weight=150.0, method=method, **target)
        for labels in hierarchy.levels:
            assert np.bincount(labels, people).max() <= 150
    counted = {"n_parts": 30, "weights": "people", "balance": "cells", "min_weight": 50, "max_weight": 500}
    labels = agglo.agglomerate(mesh, method=method, **counted).levels[0]
    assert len(np.unique(labels)) == 30
    assert 50 <= np.bincount(labels, people).min() <= np.bincount(labels, people).max() <= 500
    fewest = -(-people.sum() // 500)
    with pytest.raises(
        OptionError, match=f"too few parts, 3: constraint 'max_weight' needs at least {fewest}"
    ):
        agglo.agglomerate(mesh, n_parts=3, weights="people", max_weight=500, method=method)


def test_bounds_on_weights_as_a_component_from_a_file_and_of_a_graph(tmp_path):
    mesh = loaded()
    rules = {"weights": "people", "max_weight": 150}
    wanted = agglo.agglomerate(mesh, h_factor=3, **rules).levels[0]
    plain = agglo.agglomerate(mesh, h_factor=3).levels[0]
    assert (
        np.bincount(plain, mesh.cell_tags["people"]).max()
        > 150
        >= np.bincount(wanted, mesh.cell_tags["people"]).max()
    )
    component = ("bounds", {"max_weight": 150, "weights": "people"})
    np.testing.assert_array_equal(
        agglo.agglomerate(mesh, h_factor=3, constraints=[component]).levels[0], wanted
    )
    path = tmp_path / "run.toml"
    path.write_text('n_parts = 9\nweights = "people"\nmax_weight = 150\n')
    from_file = agglo.agglomerate(mesh, config=path, h_factor=3)  # weights stay beside the size
    np.testing.assert_array_equal(from_file.levels[0], wanted)
    weights = mesh.cell_tags["people"].astype(float)
    of_graph = agglo.agglomerate(mesh.graph, h_factor=3, weights=weights, max_weight=150)
    np.testing.assert_array_equal(of_graph.levels[0], wanted)


def test_single_cells_may_be_heavier_than_the_bound():
    weights = np.where(np.arange(64) == 27, 50.0, 1.0)
    labels = agglo.agglomerate(FINE, cells_per_part=16, weights=weights, max_weight=12).levels[0]
    assert np.flatnonzero(labels == labels[27]).tolist() == [27]
    of_parts = np.bincount(labels, weights)
    assert sorted(of_parts)[-2] <= 12 < sorted(of_parts)[-1] == 50


def test_small_parts_join_or_are_counted():
    mesh = samples.voronoi(400, seed=5)
    least = agglo.agglomerate(mesh, h_factor=1.5, min_cells=4)
    small = int((np.bincount(least.levels[0]) < 4).sum())
    assert small == least.statistics["small_parts"]
    assert small < (np.bincount(agglo.agglomerate(mesh, h_factor=1.5).levels[0]) < 4).sum()
    whole = agglo.agglomerate(samples.disconnected(2), h_star=100.0, min_cells=5)
    assert whole.parts == [2]
    assert whole.statistics["small_parts"] == 2  # nobody to join


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"max_cells": 0}, "max_cells must be positive"),
        ({"min_measure": float("nan")}, "min_measure must be positive and finite, given nan"),
        ({"min_cells": 5, "max_cells": 4}, "min_cells = 5 exceeds max_cells = 4"),
        ({"max_cells": True}, "max_cells must be positive and finite, given True"),
        ({"max_cells": "many"}, "max_cells must be positive and finite, given 'many'"),
        ({"min_weight": 3}, "min_weight needs weights: the name of cell data, or a number for each cell"),
        ({"max_weight": -1, "weights": "x"}, "max_weight must be positive and finite, given -1"),
        ({"max_weight": 1, "min_weight": 2, "weights": "x"}, "min_weight = 2 exceeds max_weight = 1"),
        ({"max_weight": 1, "weights": "x"}, "weights: no cell tag is named 'x'; the mesh has none"),
        ({"max_weight": 1, "weights": np.full(64, np.nan)}, "weights must be finite and not negative"),
        ({"max_weight": 1, "weights": np.ones(3)}, "weights must be 64 numbers, one for each cell"),
    ],
)
def test_bounds_that_mean_nothing(bounds, message):
    with pytest.raises(OptionError, match=message):
        agglo.agglomerate(FINE, n_parts=30, **bounds)


# --- mean sizes that pieces or bounds do not allow -------------------------------------------------------


def with_islands(n=12):
    """A square of n × n cells, and two triangles off it."""
    square = samples.squares(n)
    loops = np.split(square.boundary_loops.vertices, square.boundary_loops.loop_offsets[1:-1])
    k = len(square.points)
    islands = [[5, 5], [6, 5], [6, 6], [7, 7], [8, 7], [8, 8]]
    cells = [*loops, [k, k + 1, k + 2], [k + 3, k + 4, k + 5]]
    return agglo.Mesh.from_polygons(np.vstack([square.points, islands]), cells)


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_a_mean_size_beside_islands(method):
    """Islands are parts; the size is that of the parts of the square, which is one part at the coarsest."""
    mesh = with_islands()
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(8, 64, 512), method=method)
    assert hierarchy.parts == [20, 4, 3]
    assert [target["n_parts"] for target in hierarchy.targets] == [20, 4, 3]
    assert [target["cells_per_part"] for target in hierarchy.targets] == [8, 64, 512]
    for labels in hierarchy.levels:
        assert np.bincount(labels)[labels[-2:]].tolist() == [1, 1]
    with pytest.raises(OptionError, match="too few parts, 2: the mesh has 3 disconnected components"):
        agglo.agglomerate(mesh, n_parts=2, method=method)


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_a_mean_size_within_regions_and_ridges(method):
    sizes = {"cells_per_part": (8, 100), "method": method}
    column = np.arange(144) % 12
    strip = agglo.agglomerate(samples.squares(12), regions=np.digitize(column, (10, 11)), **sizes)
    assert strip.parts == [18, 3]
    assert sorted(np.bincount(strip.levels[1])) == [12, 12, 120]
    square = samples.squares(12)
    side = sum(
        k * np.isclose(square.face_centroids[:, axis], at)
        for k, (axis, at) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1)], 1)
    )
    ridges = agglo.agglomerate(square.with_face_tags(side=side), boundary_rules="ridges", **sizes)
    assert sorted(np.bincount(ridges.levels[1])) == [1] * 4 + [10] * 4 + [100]


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_a_mean_size_on_a_matrix_with_dirichlet_rows(method):
    """Two bodies of 400 and 100 nodes, and 200 rows with nothing but a diagonal."""
    one, other = samples.squares(20).graph, samples.squares(10).graph
    shift = one.n
    links = np.concatenate((one.indptr, one.indptr[-1] + other.indptr[1:]))
    alone = 200
    graph = Graph.from_arrays(
        np.concatenate((links, np.full(alone, links[-1]))),
        np.concatenate((one.indices, other.indices + shift)),
        np.concatenate((one.centroids, other.centroids + 3, np.random.default_rng(0).random((alone, 2)) + 9)),
    )
    labels = agglo.agglomerate(graph, cells_per_part=10, method=method).levels[0]
    parts = [len(np.unique(labels[nodes])) for nodes in np.split(np.arange(graph.n), [400, 500])]
    assert parts == [40, 10, 200]


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_a_mean_size_gives_way_to_barriers_and_bounds(method):
    barrier = agglo.agglomerate(FINE, cells_per_part=64, barriers=fracture(FINE, 0.4), method=method)
    assert barrier.parts == [2]
    assert barrier.targets[0]["n_parts"] == 2
    bounded = agglo.agglomerate(FINE, cells_per_part=(4, 40), max_cells=16, method=method)
    assert bounded.parts[0] == 16
    assert bounded.parts[1] == bounded.targets[1]["n_parts"] >= 4
    assert np.bincount(bounded.levels[1]).max() <= 16
    least = agglo.agglomerate(FINE, cells_per_part=(2, 30), min_cells=8, method=method)
    assert np.bincount(least.levels[0]).min() >= 8


# --- what counts are shared out by -----------------------------------------------------------------------


def test_counts_are_shared_out_by_cells_measure_or_weights():
    """Two squares of 4 × 4 cells, the second with sides three times as long."""
    mesh = samples.disconnected(4)
    points = mesh.points.copy()
    points[points[:, 0] > 1.2] *= 3.0
    mesh = replace(mesh, points=points)
    second = mesh.cell_centroids[:, 0] > 2

    def parts_of_second(**how):
        labels = agglo.agglomerate(mesh, n_parts=10, **how).levels[0]
        return len(set(labels[second]))

    assert parts_of_second() == parts_of_second(balance="cells") == 5
    assert parts_of_second(balance="measure") == 9
    assert parts_of_second(weights=np.where(second, 1.0, 4.0)) == 2
    tagged = replace(mesh, cell_tags={"load": np.where(second, 1, 4)})
    assert agglo.agglomerate(tagged, n_parts=10, weights="load").parts == [10]


def test_the_imbalance_is_in_the_statistics():
    mesh = samples.voronoi(300, seed=1)
    weights = np.random.default_rng(0).uniform(1, 5, mesh.n_cells)
    hierarchy = agglo.agglomerate(mesh, n_parts=(20, 5), weights=weights)
    for labels, told in zip(hierarchy.levels, hierarchy.statistics["imbalance"], strict=True):
        of_parts = np.bincount(labels, weights)
        assert told == pytest.approx(of_parts.max() / of_parts.mean())
    assert "imbalance" not in agglo.agglomerate(mesh, h_factor=3).statistics


# --- boundary rules ---------------------------------------------------------------------------------------


def test_corners_stay_single_and_sides_to_themselves():
    middle = FINE.points[FINE.face_vertices].reshape(-1, 2, 2).mean(axis=1)
    sides = sum(
        k * (np.abs(middle - at).T[axis] < 1e-9)
        for k, axis, at in ((1, 0, 0.0), (2, 0, 1.0), (3, 1, 0.0), (4, 1, 1.0))
    )
    mesh = replace(FINE, face_tags={"side": np.where(FINE.face_cells[:, 1] < 0, sides, 0)})
    labels = agglo.agglomerate(mesh, h_star=9.0, boundary_rules="ridges").levels[0]
    assert sorted(np.bincount(labels)) == [1, 1, 1, 1, 6, 6, 6, 6, 36]
    with pytest.raises(OptionError, match="the mesh has no boundary patches"):
        agglo.agglomerate(FINE, n_parts=9, boundary_rules="ridges")


def test_ridges_in_space():
    """A cube of 4³: 8 corners, 12 ridges of 2, 6 sides of 4, 8 inside; only the corners are to stay alone."""
    mesh = samples.boxes(4)
    normals, outer = mesh.face_normals, mesh.face_cells[:, 1] < 0
    side = 1 + np.argmax(np.abs(normals), axis=1) + 3 * (normals.sum(axis=1) > 0)
    mesh = replace(mesh, face_tags={"side": np.where(outer, side, 0)})
    labels = agglo.agglomerate(mesh, h_star=9.0, boundary_rules="ridges").levels[0]
    assert sorted(np.bincount(labels)) == [1] * 8 + [2] * 12 + [4] * 6 + [8]


# --- lines and metrics ------------------------------------------------------------------------------------


def layer():
    """A boundary layer: 12 columns of 8 cells, 1.6 times as high from one to the next."""
    heights = np.concatenate(([0.0], np.cumsum(1.6 ** np.arange(8)))) * 0.002
    x, y = np.meshgrid(np.linspace(0, 1, 13), heights, indexing="ij")
    corner = np.arange(12 * 9).reshape(12, 9)[:, :-1].ravel()
    cells = np.stack((corner, corner + 9, corner + 10, corner + 1), axis=1)
    return agglo.Mesh.from_polygons(np.stack((x.ravel(), y.ravel()), axis=1), cells)


@pytest.mark.parametrize(
    "how", [{"n_parts": (40, 12, 4)}, {"h_factor": (0.3, 1.2, 3)}, {"n_parts": (12, 4), "method": "kway"}]
)
def test_lines_are_whole_or_cut_along(how):
    mesh = layer()
    columns = np.arange(96) // 8
    hierarchy = agglo.agglomerate(mesh, lines=True, **how)
    for labels in hierarchy.levels:
        for part in range(labels.max() + 1):
            inside = labels == part
            assert len(set(columns[inside])) == 1 or np.isin(columns, columns[inside]).sum() == inside.sum()
    if "n_parts" in how:
        assert hierarchy.parts == list(how["n_parts"])
        at_twelve = hierarchy.levels[hierarchy.parts.index(12)]
        np.testing.assert_array_equal(at_twelve, columns)
    assert len(hierarchy.parents(0)) == hierarchy.parts[0]


def test_a_metric_makes_parts_long_where_lengths_are_short():
    mesh = samples.squares(24)
    metric = np.diag([1.0, 64.0])
    labels = agglo.agglomerate(mesh, n_parts=36, metric=metric).levels[0]
    extents = np.array([np.ptp(mesh.cell_centroids[labels == part], axis=0) for part in range(36)])
    assert extents[:, 0].mean() > 3 * extents[:, 1].mean()
    each = agglo.agglomerate(mesh, n_parts=36, metric=np.tile(metric, (mesh.n_cells, 1, 1))).levels[0]
    extents = np.array([np.ptp(mesh.cell_centroids[each == part], axis=0) for part in range(36)])
    assert extents[:, 0].mean() > 3 * extents[:, 1].mean()


def test_a_metric_is_the_mesh_in_other_coordinates():
    mesh = samples.voronoi(200, seed=3)
    metric = np.array([[2.0, 0.5], [0.5, 1.0]])
    values, vectors = np.linalg.eigh(metric)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    there = replace(mesh, points=mesh.points @ root)
    for target in ({"h_factor": (2, 4)}, {"h_star": 0.3}, {"n_parts": 12}):
        one = agglo.agglomerate(mesh, metric=metric, **target)
        other = agglo.agglomerate(there, **target)
        assert one.parts == other.parts
        for labels, same in zip(one.levels, other.levels, strict=True):
            np.testing.assert_array_equal(labels, same)
    graph = agglo.agglomerate(mesh, metric=4.0 * np.eye(2), h_star=0.6)
    np.testing.assert_array_equal(graph.levels[0], agglo.agglomerate(mesh, h_star=0.3).levels[0])


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (np.eye(3), r"metric must have shape \(2, 2\), or \(64, 2, 2\)"),
        ([[1, 2], [0, 1]], "the metric is not symmetric positive definite"),
        ([[1, 0], [0, -1]], "the metric is not symmetric positive definite"),
        ([[1, 0], [0, np.nan]], "the metric is not symmetric positive definite"),
        (np.concatenate((np.tile(np.eye(2), (63, 1, 1)), np.zeros((1, 2, 2)))), "the metric of cell 63"),
    ],
)
def test_metrics_that_are_none(metric, message):
    with pytest.raises(OptionError, match=message):
        agglo.agglomerate(FINE, n_parts=4, metric=metric)


# --- refusals, files, the command line ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"regions": "rock"}, "no cell tag is named 'rock'; there are none"),
        ({"regions": np.zeros(3, int)}, r"regions have shape \(3,\), expected \(64,\)"),
        (
            {"regions": np.zeros(64)},
            "regions must be names of cell tags, integers or booleans, given float64",
        ),
        ({"barriers": "fault"}, "barriers: no face tag is named 'fault'; the mesh has none"),
        ({"barriers": LEFT}, "barriers must be the name of a face tag or 144 booleans"),
        ({"where": np.ones(64, int)}, "where must be the name of a cell tag or 64 booleans"),
        ({"weights": np.full(64, -1.0)}, "weights must be finite and not negative; cell 0 has -1.0"),
        ({"weights": "load"}, "weights: no cell tag is named 'load'"),
        ({"weights": np.ones(64), "balance": "cells"}, "weights have no effect with balance='cells'"),
        ({"balance": "area"}, "balance must be one of cells, measure, weights, given 'area'"),
        ({"boundary_rules": "corners"}, "boundary_rules must be 'ridges'"),
        ({"lines": "yes"}, "lines must be true or false"),
        ({"lines": True, "max_weight": 4, "weights": np.ones(64)}, "lines=True cannot be combined with"),
        ({"lines": True, "max_cells": 4}, "lines=True cannot be combined with"),
    ],
)
def test_rules_that_cannot_be_kept_are_refused(rules, message):
    with pytest.raises(OptionError, match=message):
        agglo.agglomerate(FINE, n_parts=8, **rules)


def test_weights_share_out_counts_and_nothing_else():
    for rule in ({"weights": np.ones(64)}, {"balance": "cells"}):
        with pytest.raises(OptionError, match="applies to counts"):
            agglo.agglomerate(FINE, h_factor=2, **rule)


def test_a_graph_has_no_faces():
    for rule in ({"barriers": "fault"}, {"boundary_rules": "ridges"}, {"constraints": ["ridges"]}):
        with pytest.raises(OptionError, match="needs a mesh: a graph has no faces"):
            agglo.agglomerate(FINE.graph, n_parts=8, **rule)
    arrays = FINE.graph
    bare = Graph.from_arrays(arrays.indptr, arrays.indices, arrays.centroids)
    assert agglo.agglomerate(bare, n_parts=4, regions=LEFT, max_cells=16).parts == [4]
    assert agglo.agglomerate(bare, n_parts=4, metric=np.eye(2)).parts == [4]


def test_rules_of_a_file(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(
        'n_parts = 8\nregions = ["rock"]\nmax_cells = 8\nbalance = "measure"\nwhere = {rock = [0, 1]}\n'
        'barriers = "fault=3"\nmetric = [[1, 0], [0, 1]]\n'
    )
    mesh = replace(
        FINE,
        cell_tags={"rock": LEFT.astype(int)},
        face_tags={"fault": np.where(fracture(FINE, 0.4), 3, 0)},
    )
    from_file = agglo.agglomerate(mesh, config=path).levels[0]
    same = {"regions": LEFT, "max_cells": 8, "balance": "measure", "barriers": fracture(FINE, 0.4)}
    np.testing.assert_array_equal(from_file, agglo.agglomerate(mesh, n_parts=8, **same).levels[0])
    assert set(np.bincount(from_file)) == {8}


class Sees:
    """A constraint that wants the mesh."""

    def __init__(self, answer):
        self.answer = answer

    def for_mesh(self, mesh):
        return self.answer


def test_what_a_constraint_returns_for_a_mesh_is_checked():
    with pytest.raises(PluginError, match="for_mesh returned 3, expected a constraint"):
        agglo.agglomerate(FINE, n_parts=4, constraints=[Sees(3)])


class Bad:
    def admissible(self, graph, labels):
        return np.ones(3)


def test_answers_about_parts_are_checked():
    with pytest.raises(
        PluginError, match=r"admissible returned shape \(3,\) of float64, expected \(4,\) of bool"
    ):
        agglo.agglomerate(FINE, n_parts=4, constraints=[Bad()])


class AtMostTwo:
    """No part of more than two cells."""

    def admissible(self, graph, labels):
        return np.bincount(labels) <= 2


def test_lines_that_are_not_admissible_are_no_result():
    """A line is whole at coarse levels: a rule that forbids that is refused, not broken in silence."""
    with pytest.raises(OptionError, match="parts violate the constraints"):
        agglo.agglomerate(layer(), h_factor=3, lines=True, constraints=[AtMostTwo()])
