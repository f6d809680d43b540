"""Cuts through the trees of a hierarchy: the best of a size, local changes, grades, transfers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import Graph, Hierarchy, MeshError, OptionError, agglomerate, samples
from agglo_core.hierarchy import Cut, Forest, by_first_cell


def hierarchy_of(graph: Graph, *levels: np.ndarray, nested: bool = True) -> Hierarchy:
    return Hierarchy(None, graph, levels, [{"n_parts": 1}] * len(levels), nested)


def random_levels(n: int, how_many: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Nested levels with no regard to neighbours; some repeat what the level before has."""
    levels, labels = [], np.arange(n)
    for _ in range(how_many):
        k = int(labels.max()) + 1
        labels = by_first_cell(rng.integers(0, rng.integers(1, k + 1), k)[labels])
        levels.append(labels)
    return levels


@st.composite
def hierarchies(draw: st.DrawFn, largest: int = 40) -> Hierarchy:
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    mesh = samples.voronoi(draw(st.integers(2, largest)), seed=draw(st.integers(0, 20)))
    return hierarchy_of(mesh.graph, *random_levels(mesh.n_cells, draw(st.integers(0, 4)), rng))


Part = tuple[frozenset[int], int, int]  # cells, finest and coarsest level


def trees(hierarchy: Hierarchy) -> list[tuple[Part, list]]:
    """Each tree as a part and the trees of what it is split into, from the levels alone."""
    n = hierarchy.graph.n
    levels = [np.arange(n), *hierarchy.levels]

    def tree(cells: frozenset[int], coarsest: int) -> tuple[Part, list]:
        finest = coarsest
        while finest >= 0 and len(split(cells, finest - 1)) == 1:
            finest -= 1
        below = [tree(each, finest - 1) for each in split(cells, finest - 1)] if finest >= 0 else []
        return (cells, finest, coarsest), below

    def split(cells: frozenset[int], level: int) -> list[frozenset[int]]:
        labels = levels[level + 1]
        return [frozenset(c for c in cells if labels[c] == k) for k in sorted({labels[c] for c in cells})]

    top = len(hierarchy.levels) - 1
    return [tree(each, top) for each in split(frozenset(range(n)), top)]


def all_cuts(hierarchy: Hierarchy) -> Iterator[list[Part]]:
    """Every cut there is."""

    def cuts(tree: tuple[Part, list]) -> list[list[Part]]:
        whole, below = tree
        return [[whole], *(together(below) if below else [])]

    def together(several: list) -> list[list[Part]]:
        return [list(itertools.chain(*each)) for each in itertools.product(*map(cuts, several))]

    yield from together(trees(hierarchy))


def how_many_cuts(tree: tuple[Part, list]) -> int:
    return 1 + (int(np.prod([how_many_cuts(each) for each in tree[1]])) if tree[1] else 0)


def is_graded(parts: list[Part], graph: Graph, grade: int) -> bool:
    of = {cell: part for part in parts for cell in part[0]}
    return all(
        of[int(y)][1] - of[x][2] <= grade
        for x in range(graph.n)
        for y in graph.indices[graph.indptr[x] : graph.indptr[x + 1]]
    )


def parts_of(cut: Cut) -> list[Part]:
    forest, levels = cut.forest, zip(cut.forest.finest[cut.nodes], cut.levels, strict=True)
    cells = [frozenset(np.flatnonzero(cut.labels == part).tolist()) for part in range(cut.n_parts)]
    assert [len(each) for each in cells] == (forest.stop - forest.start)[cut.nodes].tolist()
    return [(own, int(finest), int(coarsest)) for own, (finest, coarsest) in zip(cells, levels, strict=True)]


def small(seed: int) -> Hierarchy:
    """A hierarchy of some ten cells with at most some thousand cuts."""
    rng = np.random.default_rng(seed)
    while True:
        mesh = samples.voronoi(int(rng.integers(4, 18)), seed=int(rng.integers(1000)))
        hierarchy = hierarchy_of(mesh.graph, *random_levels(mesh.n_cells, int(rng.integers(1, 4)), rng))
        if 3 < np.prod([how_many_cuts(tree) for tree in trees(hierarchy)]) < 4000:
            return hierarchy


def indicator_of(n: int, rng: np.random.Generator) -> np.ndarray:
    """Some zeros, some equal, some far larger than others."""
    return rng.choice([0.0, 1.0, 1.0, rng.random(), rng.lognormal(0, 3)], n) * rng.choice([1.0, rng.random()])


# --- the best cut of a size --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_no_cut_of_the_size_has_a_smaller_largest_or_sum_of_squares(seed: int) -> None:
    hierarchy, rng = small(seed), np.random.default_rng(seed)
    indicator = indicator_of(hierarchy.graph.n, rng)
    every = list(all_cuts(hierarchy))
    largest = [max(indicator[list(part[0])].sum() for part in cut) for cut in every]
    squares = [sum(indicator[list(part[0])].sum() ** 2 for part in cut) for cut in every]
    fits = [is_graded(cut, hierarchy.graph, 1) for cut in every]
    for n_parts in sorted({len(cut) for cut in every}):
        few = [len(cut) <= n_parts for cut in every]
        best = hierarchy.cut(n_parts, indicator)
        graded = hierarchy.cut(n_parts, indicator, grade=1)
        even = hierarchy.cut(n_parts, indicator, objective="squares")
        assert max(best.n_parts, graded.n_parts, even.n_parts) <= n_parts
        assert np.bincount(best.labels, indicator).max() == pytest.approx(
            min(itertools.compress(largest, few))
        )
        both = np.logical_and(few, fits)
        assert is_graded(parts_of(graded), hierarchy.graph, 1)
        found = np.bincount(graded.labels, indicator).max()
        assert found == pytest.approx(min(itertools.compress(largest, both)))
        found = (np.bincount(even.labels, indicator) ** 2).sum()
        assert found == pytest.approx(min(itertools.compress(squares, few)), rel=1e-12, abs=1e-300)


def greedy(hierarchy: Hierarchy, indicator: np.ndarray, n_parts: int) -> set[frozenset[int]]:
    """The same cut as ``cut`` without grade makes, by lists; indicators of parts must all be different."""
    cut = trees(hierarchy)
    done: list = []
    while cut:
        cut.sort(key=lambda tree: indicator[list(tree[0][0])].sum())
        whole, below = tree = cut.pop()
        if below and indicator[list(whole[0])].sum() > 0 and len(cut) + len(done) + len(below) <= n_parts:
            cut += below
        else:
            done.append(tree)
    return {tree[0][0] for tree in done}


@settings(max_examples=25, deadline=None)
@given(hierarchies(), st.integers(0, 10**6), st.integers(0, 60))
def test_the_kernel_splits_as_lists_do(hierarchy: Hierarchy, seed: int, more: int) -> None:
    indicator = np.random.default_rng(seed).random(hierarchy.graph.n)
    n_parts = hierarchy.forest.n_roots + more
    cut = hierarchy.cut(n_parts, indicator)
    assert {part[0] for part in parts_of(cut)} == greedy(hierarchy, indicator, n_parts)


def test_sizes_are_met_from_below_and_what_is_left_goes_to_others() -> None:
    graph = samples.strip(8).graph  # two blocks of four cells
    hierarchy = hierarchy_of(graph, np.arange(8) // 4)
    indicator = np.array([9, 0, 0, 0, 1, 1, 1, 1.0])
    assert [hierarchy.cut(n, indicator).n_parts for n in (2, 4, 5, 7, 8, 99)] == [2, 2, 5, 5, 8, 8]
    assert hierarchy.cut(5, indicator).labels.tolist() == [0, 1, 2, 3, 4, 4, 4, 4]
    indicator[:4] = 0, 0, 0, 0
    assert hierarchy.cut(99, indicator).labels.tolist() == [0, 0, 0, 0, 1, 2, 3, 4]  # nothing to gain
    assert hierarchy.cut(99, indicator, objective="squares").n_parts == 5
    assert hierarchy.cut(n_parts=7).n_parts == 5  # by measure: both blocks alike


def test_without_a_grade_levels_meet_that_differ_by_more() -> None:
    mesh = samples.squares(16)
    x, y = np.round(mesh.cell_centroids.T * 16 - 0.5).astype(int)
    blocks = [by_first_cell((x // size) * 16 + y // size) for size in (2, 4, 8)]
    hierarchy = Hierarchy(mesh, mesh.graph, blocks, [{}] * 3, True)
    corner = (x == 7) & (y == 7)  # of its block of level 2, beside three others
    free, graded = (hierarchy.cut(64, corner, grade=grade) for grade in (None, 1))
    assert np.bincount(free.levels + 1).tolist() == [4, 3, 3, 3]
    assert not is_graded(parts_of(free), mesh.graph, 1)
    assert is_graded(parts_of(graded), mesh.graph, 1)
    assert np.bincount(graded.labels)[graded.labels[corner]] == 1
    assert is_graded(parts_of(hierarchy.cut(64, corner, grade=2)), mesh.graph, 2)
    assert free.mesh.n_cells == free.n_parts == 13


# --- grades and local changes ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(30))
def test_changes_with_a_grade_are_the_coarsest_there_are(seed: int) -> None:
    hierarchy, rng = small(100 + seed), np.random.default_rng(seed)
    graph = hierarchy.graph
    graded = [cut for cut in all_cuts(hierarchy) if is_graded(cut, graph, 1)]
    cut = hierarchy.cut_at(len(hierarchy.levels) - 1, grade=1)
    for _ in range(4):
        parts = rng.permutation(cut.n_parts)[: rng.integers(1, cut.n_parts + 1)]
        refine = bool(rng.integers(3))
        free = Cut(None, graph, cut.forest, cut.nodes)
        wanted = (free.refine(parts) if refine else free.coarsen(parts)).cut.labels
        finer = [each for each in graded if all(len({wanted[c] for c in part[0]}) == 1 for part in each)]
        fewest = min(len(each) for each in finer)
        best = [each for each in finer if len(each) == fewest]
        cut = (cut.refine(parts) if refine else cut.coarsen(parts)).cut
        assert len(best) == 1
        assert {part[0] for part in parts_of(cut)} == {part[0] for part in best[0]}


@settings(max_examples=25, deadline=None)
@given(hierarchies(), st.integers(0, 10**6), st.sampled_from([None, 1, 2]))
def test_refining_and_coarsening_again_gives_the_same_labels(
    hierarchy: Hierarchy, seed: int, grade: int | None
) -> None:
    rng = np.random.default_rng(seed)
    some = int(rng.integers(hierarchy.forest.n_roots, hierarchy.graph.n + 1))
    cut = hierarchy.cut(some, rng.random(hierarchy.graph.n), grade=grade)
    parts = rng.permutation(cut.n_parts)[: rng.integers(0, cut.n_parts + 1)]
    new, same, pairs = cut.refine(parts)
    assert new.grade == grade
    single = np.bincount(cut.labels)[parts] == 1
    assert (same[parts] >= 0).tolist() == single.tolist()  # cells stay, all others change
    assert sorted(set(pairs[:, 0].tolist())) == np.flatnonzero(same < 0).tolist()
    for old in range(cut.n_parts):
        numbers = [same[old]] if same[old] >= 0 else pairs[pairs[:, 0] == old, 1]
        np.testing.assert_array_equal(np.isin(new.labels, numbers), cut.labels == old)
    if grade is None:
        back = new.coarsen(np.unique(pairs[:, 1]))
        np.testing.assert_array_equal(back.cut.labels, cut.labels)
        mask = np.zeros(new.n_parts, bool)
        mask[pairs[:, 1]] = True
        np.testing.assert_array_equal(new.coarsen(mask).cut.labels, cut.labels)
        assert {tuple(pair) for pair in back.pairs.tolist()} == {(b, a) for a, b in pairs.tolist()}
    else:  # what was split several times to please a neighbour takes several steps back
        for _ in range(len(hierarchy.levels) + 1):
            fine = [new.labels[cut.labels == old] for old in range(cut.n_parts)]
            new = new.coarsen(np.concatenate([own for own in fine if (own != own[0]).any()] or [[]])).cut
        np.testing.assert_array_equal(new.labels, cut.labels)


def test_parts_join_only_where_all_of_a_coarser_one_are_given() -> None:
    hierarchy = hierarchy_of(samples.strip(8).graph, np.arange(8) // 2, np.arange(8) // 4)
    cut = hierarchy.cut_at(0)
    assert cut.coarsen([0, 1, 2]).cut.labels.tolist() == [0, 0, 0, 0, 1, 1, 2, 2]
    assert cut.coarsen([0, 2]).cut.labels.tolist() == cut.labels.tolist()
    mixed = cut.refine([0]).cut
    assert mixed.coarsen(range(mixed.n_parts)).cut.labels.tolist() == [0, 0, 1, 1, 2, 2, 2, 2]
    top = hierarchy.cut_at(1)
    assert top.coarsen([0, 1]).cut.labels.tolist() == top.labels.tolist()
    cells = hierarchy.cut_at(-1)
    assert cells.refine(np.ones(8, bool)).cut.labels.tolist() == list(range(8))
    assert cells.levels.tolist() == [-1] * 8


# --- transfer ----------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(hierarchies(), st.integers(0, 10**6))
def test_transfers_between_nested_cuts_compose_and_undo_each_other(hierarchy: Hierarchy, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = hierarchy.cut_at(len(hierarchy.levels) - 1)
    b, c = a, a
    for _ in range(3):
        b = b.refine(rng.random(b.n_parts) < 0.5).cut
    c = b.refine(rng.random(b.n_parts) < 0.5).cut
    P, R = a.prolongation(c), c.restriction(a)
    assert P.shape == (c.n_parts, a.n_parts)
    np.testing.assert_array_equal(P.toarray(), (b.prolongation(c) @ a.prolongation(b)).toarray())
    np.testing.assert_allclose((R @ P).toarray(), np.eye(a.n_parts), atol=1e-14)
    np.testing.assert_allclose(R.toarray(), (b.restriction(a) @ c.restriction(b)).toarray(), rtol=1e-13)
    np.testing.assert_array_equal((P @ np.arange(a.n_parts))[c.labels], a.labels)
    values = rng.random(c.n_parts)
    assert a.measures @ (R @ values) == pytest.approx(c.measures @ values)
    np.testing.assert_allclose(a.projection(c).toarray(), P.toarray(), rtol=1e-14)
    means = np.bincount(a.labels, (hierarchy.graph.measures * values[c.labels])) / a.measures
    np.testing.assert_allclose(R @ values, means)


def test_transfer_between_cuts_that_are_finer_here_and_coarser_there() -> None:
    hierarchy = hierarchy_of(samples.strip(8).graph, np.arange(8) // 4)
    one, other = (hierarchy.cut_at(0).refine([part]).cut for part in (0, 1))
    with pytest.raises(OptionError, match="is not a refinement of"):
        one.prolongation(other)
    with pytest.raises(OptionError, match="is not a refinement of"):
        one.restriction(other)
    values = one.projection(other) @ [1.0, 2.0, 3.0, 6.0, 5.0]
    np.testing.assert_allclose(values, [3.0, 5.0, 5.0, 5.0, 5.0])
    with pytest.raises(OptionError, match="different hierarchies"):
        one.projection(hierarchy_of(samples.strip(8).graph, np.arange(8) // 2).cut_at(0))


# --- hierarchies -------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(hierarchies())
def test_the_forest_has_every_part_once(hierarchy: Hierarchy) -> None:
    forest = hierarchy.forest
    assert sorted(forest.cells.tolist()) == list(range(hierarchy.graph.n))
    own = [forest.cells[a:b].tolist() for a, b in zip(forest.start, forest.stop, strict=True)]
    levels = [np.arange(hierarchy.graph.n), *hierarchy.levels]
    wanted: dict[frozenset[int], list[int]] = {}
    for level, labels in enumerate(levels, start=-1):
        for part in range(int(labels.max()) + 1):
            wanted.setdefault(frozenset(np.flatnonzero(labels == part).tolist()), []).append(level)
    found = {frozenset(cells): node for node, cells in enumerate(own)}
    assert len(found) == len(own) == len(wanted)
    for cells, at in wanted.items():
        node = found[cells]
        assert (forest.finest[node], forest.coarsest[node]) == (min(at), max(at))
        children = range(forest.first_child[node], forest.first_child[node] + forest.n_children[node])
        assert sorted(itertools.chain(*(own[child] for child in children))) == (
            sorted(cells) if len(cells) > 1 else []
        )
        assert all(forest.parent[child] == node for child in children)
    values = np.random.default_rng(0).random(hierarchy.graph.n)
    np.testing.assert_allclose(forest.sums(values), [values[cells].sum() for cells in own])
    for level, labels in enumerate(levels, start=-1):
        np.testing.assert_array_equal(hierarchy.cut_at(level).labels, by_first_cell(labels))
    assert forest.n_roots == levels[-1].max() + 1


@pytest.mark.parametrize("mesh", [samples.voronoi(300, seed=4), samples.disconnected(12), samples.boxes(5)])
def test_cuts_of_agglomerated_meshes(mesh: object) -> None:
    hierarchy = agglomerate(mesh, bisector="coordinate", cells_per_part=(4, 16), seed=0)
    cut = hierarchy.cut(n_parts=40, grade=1)
    assert hierarchy.parts[-1] <= cut.n_parts <= 40
    np.testing.assert_allclose(cut.mesh.cell_measures, cut.measures)
    above = hierarchy.above(cut)
    assert above.fine is cut.mesh
    wanted = []  # of each fine cell: its part where that is as coarse as the level, else the level's
    for level, labels in enumerate(hierarchy.levels):
        stays = cut.levels >= level
        if not stays.all():
            own = np.where(stays[cut.labels], -1 - cut.labels, labels)
            wanted.append(by_first_cell(np.unique(own, return_inverse=True)[1]))
    np.testing.assert_array_equal([labels[cut.labels] for labels in above.levels], wanted)
    assert Forest.of(above.levels, cut.n_parts).n_roots == hierarchy.parts[-1]
    assert list(hierarchy.above(hierarchy.cut_at(1)).levels) == []  # nothing is coarser
    bare = Hierarchy(None, hierarchy.graph, hierarchy.levels, hierarchy.targets, True)
    alike = bare.above(bare.cut(n_parts=40, grade=1))
    assert alike.fine is None
    np.testing.assert_allclose(alike.graph.measures, cut.measures)
    np.testing.assert_array_equal(alike.levels, above.levels)
    with pytest.raises(OptionError, match="belongs to another hierarchy"):
        Hierarchy(None, hierarchy.graph, hierarchy.levels[:1], hierarchy.targets[:1], True).above(cut)


def test_what_cannot_be_cut_says_why() -> None:
    mesh = samples.squares(4)
    x, y = np.round(mesh.cell_centroids.T * 4 - 0.5).astype(int)
    columns, rows = by_first_cell(x), by_first_cell(y)
    for nested in (False, True):  # also one that only claims to be nested
        with pytest.raises(OptionError, match="not nested"):
            hierarchy_of(mesh.graph, columns, rows, nested=nested).cut(n_parts=9)
    hierarchy = hierarchy_of(mesh.graph, columns)
    for match, arguments in [
        ("no cut has 3 parts: the coarsest level, the smallest cut, has 4", {"n_parts": 3}),
        ("n_parts must be a whole number; given 9.5", {"n_parts": 9.5}),
        ("objective must be one of largest, squares; given 'total'", {"n_parts": 9, "objective": "total"}),
        (r"shape \(3,\), expected \(16,\)", {"indicator": np.ones(3), "n_parts": 9}),
        ("cell 0 has -1", {"indicator": -np.ones(16), "n_parts": 9}),
        ("cell 0 has nan", {"indicator": np.full(16, np.nan), "n_parts": 9}),
        ("indicator must be numbers", {"indicator": "speed", "n_parts": 9}),
        ("grade must be None or a whole number", {"n_parts": 9, "grade": 0}),
        ("grade requires objective='largest'", {"n_parts": 9, "grade": 1, "objective": "squares"}),
    ]:
        with pytest.raises(OptionError, match=match):
            hierarchy.cut(**arguments)
    with pytest.raises(IndexError, match=r"level 1 is out of range: the hierarchy has levels 0\.\.0"):
        hierarchy.cut_at(1)
    cut = hierarchy.cut_at(0)
    for parts in ([4], [-1], [0.5], [[0]], np.ones(3, bool)):
        with pytest.raises(OptionError, match="parts must"):
            cut.refine(parts)
    with pytest.raises(MeshError, match="belongs to a graph"):
        _ = cut.mesh
    assert repr(hierarchy.cut_at(-1).coarsen(range(4)).cut) == "Cut(16 cells -> 16 parts of levels -1..-1)"
