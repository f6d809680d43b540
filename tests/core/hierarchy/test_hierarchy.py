"""Trees, hierarchies, and the identities between parents, overlaps and prolongations."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import (
    Hierarchy,
    Mesh,
    MeshError,
    OptionError,
    agglomerate,
    quality,
    read_hierarchy,
    samples,
    write,
)
from agglo_core.hierarchy import Tree, by_first_cell


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


def hierarchy_of(mesh: Mesh, *levels: np.ndarray, nested: bool = True) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, levels, [{"h_star": 1.0}] * len(levels), nested)


@st.composite
def nested(draw: st.DrawFn) -> Hierarchy:
    mesh = samples.voronoi(draw(st.integers(2, 30)), seed=draw(st.integers(0, 20)))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    levels, labels = [], np.arange(mesh.n_cells)
    for _ in range(draw(st.integers(1, 4))):
        k = int(labels.max()) + 1
        labels = by_first_cell(rng.integers(0, rng.integers(1, k + 1), k)[labels])
        levels.append(labels)
    return hierarchy_of(mesh, *levels)


@settings(max_examples=25, deadline=None)
@given(nested())
def test_parents_prolongations_and_overlaps_agree(hierarchy: Hierarchy) -> None:
    measures = hierarchy.graph.measures
    total = None
    for level, labels in enumerate(hierarchy.levels):
        prolongation = hierarchy.prolongation(level)
        k = hierarchy.parts[level]
        assert prolongation.shape == ((hierarchy.parts[level - 1] if level else hierarchy.graph.n), k)
        assert (prolongation.sum(axis=1) == 1).all()
        total = prolongation if total is None else total @ prolongation
        np.testing.assert_array_equal(total.toarray(), np.eye(k)[labels])
        if level + 1 == len(hierarchy.levels):
            continue
        parents, coarse = hierarchy.parents(level), hierarchy.levels[level + 1]
        np.testing.assert_array_equal(parents[labels], coarse)
        overlap = hierarchy.overlap(level)
        assert overlap.shape == (hierarchy.parts[level + 1], k)
        assert overlap.nnz == k  # nested: every part lies in one
        np.testing.assert_allclose(overlap.sum(axis=1), np.bincount(coarse, measures))
        np.testing.assert_allclose(overlap.sum(axis=0), np.bincount(labels, measures))
        wanted = np.bincount(labels, measures) * (parents == np.arange(hierarchy.parts[level + 1])[:, None])
        np.testing.assert_allclose(overlap.toarray(), wanted)


@settings(max_examples=25, deadline=None)
@given(nested())
def test_meshes_of_the_levels(hierarchy: Hierarchy) -> None:
    for level, k in enumerate(hierarchy.parts):
        coarse = hierarchy.mesh(level)
        assert coarse.n_cells == k
        if level:
            again = hierarchy.mesh(level - 1).coarsen(hierarchy.parents(level - 1))
            assert again.fingerprint == coarse.fingerprint


def test_overlaps_of_levels_that_are_not_nested() -> None:
    mesh = samples.squares(4)
    x, y = np.round(mesh.cell_centroids.T * 4 - 0.5).astype(int)
    hierarchy = hierarchy_of(mesh, compact(y // 2), compact(x // 2), nested=False)
    np.testing.assert_allclose(hierarchy.overlap(0).toarray(), np.full((2, 2), 0.25))
    for refused in (lambda: hierarchy.parents(0), lambda: hierarchy.prolongation(1)):
        with pytest.raises(ValueError, match="not nested"):
            refused()
    assert hierarchy.prolongation(0).shape == (16, 2)


def test_levels_beyond_the_last() -> None:
    hierarchy = hierarchy_of(samples.squares(2), np.array([0, 0, 1, 1]), np.zeros(4, int))
    assert repr(hierarchy) == "Hierarchy(4 cells -> 2, 1 parts)"
    for refused in (hierarchy.parents, hierarchy.overlap):
        with pytest.raises(IndexError, match="level 1 is the coarsest: no level contains its agglomerates"):
            refused(1)
        with pytest.raises(IndexError, match=r"level 2 is out of range: the hierarchy has levels 0\.\.1"):
            refused(2)
    with pytest.raises(IndexError, match=r"level -1"):
        hierarchy.prolongation(-1)
    for use in (hierarchy.quality, hierarchy.prolongation, hierarchy.__getitem__):
        with pytest.raises(TypeError, match="a level must be a whole number, given 'CR'"):
            use("CR")  # type: ignore[arg-type]
    assert hierarchy.mesh(-1).n_cells == 1


def test_a_hierarchy_is_a_sequence_of_labels() -> None:
    hierarchy = agglomerate(samples.squares(4), n_parts=(8, 4, 2))
    assert len(hierarchy) == 3
    assert hierarchy.labels is hierarchy[0] is hierarchy.levels[0]
    assert (hierarchy.labels.dtype, hierarchy.labels.shape) == (np.int64, (16,))
    assert all(labels is level for labels, level in zip(hierarchy, hierarchy.levels, strict=True))
    assert [int(hierarchy[place].max()) + 1 for place in (-3, -2, -1, np.int64(1))] == [8, 4, 2, 4]
    with pytest.raises(ValueError, match="read-only"):
        hierarchy.labels[0] = 1
    for place in (-4, 3):
        with pytest.raises(IndexError, match=rf"level {place} is out of range: .* levels 0\.\.2"):
            hierarchy[place]
    with pytest.raises(TypeError, match="slice"):
        hierarchy[1:]  # type: ignore[index]
    empty = hierarchy_of(samples.squares(2))
    assert len(empty) == 0
    assert (bool(hierarchy), bool(empty)) == (True, False)
    with pytest.raises(IndexError, match="level 0 is out of range: the hierarchy has no levels"):
        _ = empty.labels


def test_quality_and_files_are_those_of_the_functions(tmp_path: Path) -> None:
    hierarchy = agglomerate(samples.voronoi(60, seed=1), n_parts=(12, 3))
    for level in (0, 1, -1):
        wanted = quality(hierarchy.fine, hierarchy.levels[level])
        values = hierarchy.quality(level)
        assert list(values) == list(wanted)
        for name in wanted:
            np.testing.assert_array_equal(values[name], wanted[name])
    assert list(hierarchy.quality(metrics=["CR"], threads=1)) == ["CR"]
    with pytest.raises(IndexError, match="level 2"):
        hierarchy.quality(2)
    hierarchy.write(tmp_path / "method.npz")
    write(tmp_path / "function.npz", hierarchy.fine, hierarchy)
    assert (tmp_path / "method.npz").read_bytes() == (tmp_path / "function.npz").read_bytes()
    hierarchy.write(tmp_path / "small.npz", compress=True)
    assert read_hierarchy(tmp_path / "small.npz")[1].parts == [12, 3]
    alone = agglomerate(hierarchy.graph, n_parts=2)
    for refused in (alone.quality, lambda: alone.write(tmp_path / "graph.npz")):
        with pytest.raises(MeshError, match="a graph without a mesh: agglomerate the Mesh"):
            refused()


def test_what_does_not_fit_together_is_refused() -> None:
    mesh = samples.squares(2)
    with pytest.raises(OptionError, match="1 levels but 0 targets"):
        Hierarchy(mesh, mesh.graph, [np.zeros(4, int)], [], True)
    with pytest.raises(MeshError, match=r"must be \(4,\) integers.*given shape \(3,\)"):
        Hierarchy(mesh, mesh.graph, [np.zeros(3, int)], [{}], True)


def test_a_hierarchy_of_a_graph_has_no_meshes() -> None:
    graph = samples.squares(2).graph
    hierarchy = Hierarchy(None, graph, [np.zeros(4, int)], [{"parts": 1}], True)
    assert hierarchy.fingerprint == ""
    with pytest.raises(MeshError, match="belongs to a graph"):
        hierarchy.mesh(0)


def test_the_fingerprint_is_that_of_the_mesh() -> None:
    mesh = samples.squares(3)
    assert hierarchy_of(mesh, np.zeros(9, int)).fingerprint == mesh.fingerprint


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 7), min_size=1, max_size=30))
def test_labels_are_numbered_by_their_first_cell(labels: list[int]) -> None:
    seen: dict[int, int] = {}
    wanted = [seen.setdefault(label, len(seen)) for label in labels]
    assert by_first_cell(labels).tolist() == wanted


# --- trees -----------------------------------------------------------------------------------------------

#        0
#      /   \
#     1     2       cells in tree order: 4 2 | 0 | 3 1
#    / \            (nodes 3, 4 under 1; node 2 a leaf)
#   3   4
TREE = Tree(
    cells=np.array([4, 2, 0, 3, 1]),
    parent=np.array([-1, 0, 0, 1, 1]),
    start=np.array([0, 0, 3, 0, 2]),
    stop=np.array([5, 3, 5, 2, 3]),
    diameter=np.array([4.0, 2.0, 3.0, 1.0, 0.5]),
)


@pytest.mark.parametrize(
    ("h_star", "nodes"),
    [(5.0, [0]), (4.0, [0]), (3.9, [1, 2]), (2.0, [1, 2]), (1.9, [2, 3, 4]), (0.1, [2, 3, 4])],
)
def test_a_cut_takes_the_first_small_enough_node_on_each_path(h_star: float, nodes: list[int]) -> None:
    assert TREE.cut(h_star).tolist() == nodes


def test_labels_of_a_cut() -> None:
    assert TREE.labels([0]).tolist() == [0, 0, 0, 0, 0]
    assert TREE.labels([2, 1]).tolist() == [0, 1, 0, 1, 0]
    assert TREE.labels([3, 4, 2]).tolist() == [0, 1, 2, 1, 2]


def test_roots_of_several_pieces_are_cut_each() -> None:
    forest = Tree(
        cells=np.array([1, 0, 2]),
        parent=np.array([-1, -1, 0, 0]),
        start=np.array([0, 2, 0, 1]),
        stop=np.array([2, 3, 1, 2]),
        diameter=np.array([2.0, 9.0, 1.0, 1.0]),
    )
    assert forest.cut(3.0).tolist() == [0, 1]  # a single cell stays, however large
    assert forest.cut(1.0).tolist() == [1, 2, 3]
    assert forest.labels(forest.cut(1.0)).tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ([np.repeat([0, 5], 8)], "labels have gaps: no cell has label 1"),
        ([np.repeat([0, -3], 8)], "label of cell 8 is negative"),
        ([np.repeat([0.0, np.nan], 8)], "labels must be .* integers"),
        ([np.repeat([0.0, 1.9], 8)], "labels must be .* integers"),
        ([np.ma.masked_equal(np.arange(16), 15)], "labels has masked entries"),
        ([np.full(16, 2**64 - 1, np.uint64)], "labels must be whole numbers that fit in int64"),
        (
            [np.arange(16) // 4, np.arange(16) % 2],
            "not nested: part 0 of level 0 lies in several parts of level 1",
        ),
    ],
)
def test_labels_that_are_none_are_refused(levels: list[np.ndarray], message: str) -> None:
    with pytest.raises((MeshError, OptionError), match=message):
        hierarchy_of(samples.squares(4), *levels)


def test_levels_need_not_be_nested_if_that_is_said() -> None:
    levels = [np.arange(16) // 4, np.arange(16) % 2]
    assert hierarchy_of(samples.squares(4), *levels, nested=False).parts == [4, 2]
    with pytest.raises(MeshError, match="the mesh has 4 cells, its graph 16 nodes"):
        Hierarchy(samples.squares(2), samples.squares(4).graph, [], [], True)


def test_a_hierarchy_and_its_cuts_can_be_pickled() -> None:
    hierarchy = hierarchy_of(samples.squares(4), np.arange(16) // 2, np.arange(16) // 8)
    before = pickle.dumps(hierarchy)
    cut = hierarchy.cut_at(1).refine([0]).cut
    assert pickle.dumps(hierarchy) == before
    same, same_cut = pickle.loads(pickle.dumps((hierarchy, cut)))
    assert same.above(same_cut).levels[0].tolist() == hierarchy.above(cut).levels[0].tolist()
    assert same.above(cut).parts == [2]
    assert not same.levels[0].flags.writeable


def test_a_hierarchy_does_not_share_labels_that_can_be_written_to() -> None:
    labels = np.arange(16) // 4
    hierarchy = hierarchy_of(samples.squares(4), labels)
    labels[:] = 0
    assert hierarchy.levels[0].tolist() == np.repeat(range(4), 4).tolist()
