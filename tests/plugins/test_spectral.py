"""Spectral bisection: straight cuts of grids, dense oracles, invariance, a level is its blocks."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse.linalg
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core.graph import Graph
from agglo_spectral.modes import laplacian_modes
from agglo_spectral.spectral import Spectral, _normalised_cut, _sweep

SPLITS = ("ncut", "median")


def sides_of(graph, **options):
    return Spectral(**options).bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))


def same_split(a, b):
    return np.array_equal(a, b) or np.array_equal(a, 1 - b)


def rectangle(nx, ny, turn=0.0, shift=0.0):
    """nx × ny unit squares, turned and shifted."""
    x, y = np.meshgrid(np.arange(nx + 1.0), np.arange(ny + 1.0), indexing="ij")
    first = (np.arange(nx)[:, None] * (ny + 1) + np.arange(ny)).ravel()
    cells = first[:, None] + [0, ny + 1, ny + 2, 1]
    frame = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return agglo.Mesh.from_polygons(np.c_[x.ravel(), y.ravel()] @ frame + shift, cells)


def obvious_pencil(graph, weighted):
    """Dense Laplacian and masses, entry by entry."""
    laplacian, masses = np.zeros((graph.n, graph.n)), np.ones(graph.n)
    for i in range(graph.n):
        for h in range(graph.indptr[i], graph.indptr[i + 1]):
            j = graph.indices[h]
            distance = np.linalg.norm(graph.centroids[i] - graph.centroids[j])
            w = graph.interface[h] / distance if weighted else 1.0
            laplacian[i, i] += w
            laplacian[i, j] -= w
    masses = graph.weights if weighted else masses
    return laplacian, np.diag(masses / masses.sum())


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("dense_limit", [16, 1000])
@pytest.mark.parametrize("sample", ["random_triangles:n=100,seed=3", "voronoi:n=120,seed=1", "ring:n=40"])
def test_modes_against_a_dense_pencil(sample, dense_limit, weighted):
    graph = agglo.samples.from_spec(sample).graph
    laplacian, masses = obvious_pencil(graph, weighted)
    expected = scipy.linalg.eigh(laplacian, masses, eigvals_only=True)[1:4]
    values, modes = laplacian_modes(graph, 3, weighted, dense_limit)
    assert np.allclose(values[0], expected, rtol=1e-6)
    assert np.allclose(modes.T @ masses @ modes, np.eye(3), atol=1e-6)
    assert np.allclose(laplacian @ modes, masses @ modes * values, atol=1e-5 * abs(laplacian).max())


def test_a_large_graph_against_arpack():
    graph = agglo.samples.voronoi(3000, seed=2).graph
    values, modes = laplacian_modes(graph, 2, True, 64)
    owners = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    distances = np.linalg.norm(graph.centroids[owners] - graph.centroids[graph.indices], axis=1)
    adjacency = graph.to_scipy()
    adjacency.data = graph.interface / distances
    laplacian = scipy.sparse.csc_array(scipy.sparse.diags_array(adjacency.sum(axis=1)) - adjacency)
    masses = scipy.sparse.diags_array(graph.weights / graph.weights.sum(), format="csc")
    v0 = np.linspace(0, 1, graph.n)
    expected, vectors = scipy.sparse.linalg.eigsh(laplacian, 3, masses, sigma=-0.1, v0=v0)
    assert np.allclose(values[0], expected[1:], rtol=1e-6)
    overlap = vectors[:, 1:].T @ masses @ modes
    assert np.allclose(np.abs(np.linalg.det(overlap)), 1.0, atol=1e-6)


def test_few_nodes_have_few_modes():
    graph = rectangle(2, 1).graph
    values, modes = laplacian_modes(graph, 2, True, 64)
    assert values[0, 0] > 0
    assert np.isinf(values[0, 1])
    assert (modes[:, 1] == 0).all()


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("size", [(2, 2), (4, 4), (8, 8), (6, 3), (12, 12), (3, 10)])
@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_grids_of_squares_are_halved_straight(split, size, turn):
    graph = rectangle(*size, turn, 1e5).graph
    sides = sides_of(graph, split=split)
    i, j = np.divmod(np.arange(graph.n), size[1])
    halves = [i >= size[0] / 2] if size[0] > size[1] else [j >= size[1] / 2]
    if size[0] == size[1]:
        halves = [i >= size[0] / 2, j >= size[1] / 2]
    assert any(same_split(sides, half.astype(int)) for half in halves)


@pytest.mark.parametrize("name", ["squares", "triangles"])
def test_the_paper_s_regular_grids_give_sixteen_squares(name):
    mesh = agglo.samples.paper(name)
    labels = agglo.agglomerate(mesh, bisector="spectral", h_star=np.sqrt(2) / 4).levels[0]
    values = agglo.quality(mesh, labels, metrics=("UF", "CR", "CRc"))
    assert len(values["UF"]) == 16
    assert np.allclose(values["UF"], 1)
    assert np.allclose(values["CR"], np.sqrt(0.5), atol=1e-4)
    assert np.allclose(values["CRc"], np.sqrt(0.5), atol=1e-4)


def test_quality_on_random_meshes():
    means = []
    for seed in range(2):
        for mesh in (agglo.samples.random_triangles(128, seed), agglo.samples.voronoi(256, seed)):
            labels = agglo.agglomerate(mesh, bisector="spectral", h_star=np.sqrt(2) / 4).levels[0]
            means.append(agglo.quality(mesh, labels, metrics=("CR",))["CR"].mean())
    assert np.mean(means) >= 0.5


def obvious_sweep(graph, mode, balance):
    """Least normalised cut over all thresholds, one after the other."""
    dense, share = graph.to_scipy().toarray(), graph.weights / graph.weights.sum()
    best, winner = np.inf, None
    for threshold in np.sort(mode)[:-1]:
        upper = mode > threshold
        size = share[upper].sum()
        cut = dense[np.ix_(upper, ~upper)].sum() / (size * (1 - size))
        if balance <= size <= 1 - balance and cut < best * (1 - 1e-9):
            best, winner = cut, upper.astype(int)
    return best, winner


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.25, 0.4]))
def test_sweep_against_an_obvious_reference(seed, balance):
    rng = np.random.default_rng(seed)
    graph = agglo.samples.random_triangles(int(rng.integers(3, 12)), seed=seed % 1000).graph
    mode = rng.standard_normal(graph.n)
    best, winner = obvious_sweep(graph, mode, balance)
    sides, found = _sweep(graph, mode, balance)
    assert found[0] == (winner is not None)
    if winner is not None:
        assert np.array_equal(sides, winner)
        assert np.isclose(_normalised_cut(graph, sides)[0], best)


def edges_of(n, rng):
    """A random connected graph: a random tree and a few more edges."""
    parents = [int(rng.integers(0, i)) for i in range(1, n)]
    dense = np.zeros((n, n))
    dense[np.arange(1, n), parents] = 1
    dense[rng.integers(0, n, n), rng.integers(0, n, n)] = 1
    dense = np.triu(dense + dense.T, 1)
    return dense + dense.T


@settings(max_examples=40, deadline=None)
@given(
    st.integers(2, 40), st.booleans(), st.sampled_from([2, 3]), st.sampled_from(SPLITS), st.integers(0, 10**9)
)
def test_both_sides_occur_on_any_connected_graph(n, coincident, dim, split, seed):
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(edges_of(n, rng))
    indptr = np.concatenate(([0], np.cumsum(np.bincount(rows, minlength=n))))
    centroids = np.ones((n, dim)) if coincident else rng.random((n, dim))
    graph = Graph.from_arrays(indptr, columns, centroids, weights=10.0 ** rng.integers(-6, 6, n))
    sides = sides_of(graph, split=split, dense_limit=16)
    assert sides.dtype == np.int64
    assert set(sides.tolist()) == {0, 1}


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("heavy", [0, 7, 15])
def test_weights_of_zero_still_leave_two_sides(split, heavy):
    grid = rectangle(4, 4).graph
    weights = (np.arange(grid.n) == heavy).astype(float)
    graph = Graph.from_arrays(grid.indptr, grid.indices, grid.centroids, weights=weights)
    assert set(sides_of(graph, split=split).tolist()) == {0, 1}


def closed(mesh, open_faces):
    """The dual graph with interfaces 1 where ``open_faces(i, j)`` for cells i < j, else 0."""
    graph = mesh.graph
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    open_ = open_faces(np.minimum(rows, graph.indices), np.maximum(rows, graph.indices))
    return Graph.from_arrays(
        graph.indptr, graph.indices, mesh.cell_centroids, interface=np.asarray(open_, dtype=float)
    )


OPEN_FACES = {
    "lines": lambda i, j: (401 * i + j) % 2,
    "half": lambda i, j: (7919 * i + 104729 * j) % 97 < 48,
    "few": lambda i, j: (7919 * i + 104729 * j) % 97 < 8,
    "none": lambda i, j: np.zeros(len(i)),
    "tiny elsewhere": lambda i, j: np.where((401 * i + j) % 2, 1.0, 1e-20),
}


@pytest.mark.parametrize("weights", sorted(OPEN_FACES))
@pytest.mark.parametrize("split", ["ncut", "median"])
def test_interfaces_may_be_zero(weights, split):
    graph = closed(agglo.samples.squares(20), OPEN_FACES[weights])
    hierarchy = agglo.agglomerate(graph, bisector=("spectral", {"split": split}), n_parts=8)
    assert hierarchy.parts == [8]
    assert len(np.unique(graph.components(hierarchy.levels[0]))) == 8


@pytest.mark.parametrize("mesh", [agglo.samples.squares(20), agglo.samples.tetrahedra(4)])
def test_a_closed_wall_is_the_cut(mesh):
    """Interfaces that are zero along a wall cost nothing."""
    left = mesh.cell_centroids[:, 0] < 0.4
    graph = closed(mesh, lambda i, j: left[i] == left[j])
    sides = Spectral().bisect_level(graph, np.zeros(1, np.uint64))
    assert len(np.unique(sides[left])) == len(np.unique(sides[~left])) == 1
    assert sides[left][0] != sides[~left][0]


def test_modes_of_weakly_coupled_pieces_converge():
    graph = closed(agglo.samples.squares(16), OPEN_FACES["half"])
    values, modes = laplacian_modes(graph, 2, True, 64)
    exact, exact_modes = laplacian_modes(graph, 2, True, 256)
    np.testing.assert_allclose(values, exact, rtol=1e-6)
    np.testing.assert_allclose(
        modes @ modes.T, exact_modes @ exact_modes.T, atol=1e-4 * np.abs(modes).max() ** 2
    )


def test_one_node_is_side_zero():
    assert sides_of(rectangle(1, 1).graph).tolist() == [0]


def moved(mesh, order, turn, scale, shift):
    """The mesh with cells renumbered and points turned, scaled and shifted."""
    loops = mesh.boundary_loops
    cells = [
        loops.vertices[a:b] for a, b in zip(loops.loop_offsets[:-1], loops.loop_offsets[1:], strict=True)
    ]
    frame = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return agglo.Mesh.from_polygons(mesh.points @ frame * scale + shift, [cells[c] for c in order])


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("dense_limit", [16, 1000])
@pytest.mark.parametrize("seed", range(2))
def test_the_cut_follows_the_mesh(split, dense_limit, seed):
    rng = np.random.default_rng(seed)
    mesh = agglo.samples.voronoi(90, seed) if seed % 2 else agglo.samples.random_triangles(50, seed)
    sides = sides_of(mesh.graph, split=split, dense_limit=dense_limit)
    for scale, shift in ((1.0, 0.0), (1e-4, 0.0), (1.0, 1e6)):
        order = rng.permutation(mesh.n_cells)
        again = sides_of(
            moved(mesh, order, rng.uniform(0, 6), scale, shift).graph, split=split, dense_limit=dense_limit
        )
        assert same_split(again, sides[order])


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("sample", ["random_triangles:n=150,seed=2", "squares:n=12", "boxes:n=5"])
def test_a_level_is_its_blocks(sample, split):
    mesh = agglo.samples.from_spec(sample)
    half = agglo.agglomerate(mesh, bisector="inertial", n_parts=2).levels[0]
    small = agglo.agglomerate(mesh, bisector="inertial", cells_per_part=3).levels[0]
    labels = np.unique(np.where(half == 0, 0, 1 + small), return_inverse=True)[1]
    level = mesh.graph.split(mesh.graph.components(labels))[0]
    together = sides_of(level, split=split, dense_limit=40)
    apart = [sides_of(level[b], split=split, dense_limit=40) for b in range(level.n_blocks)]
    assert np.array_equal(together, np.concatenate(apart))


def test_a_cube_is_halved_straight():
    graph = agglo.samples.boxes(4).graph
    sides = sides_of(graph)
    straight = [(x > 0).astype(int) for x in graph.centroids.T]
    assert any(same_split(sides, half) for half in straight)


def test_ncut_beats_the_median_at_a_waist():
    """Two squares joined by one cell: the cut goes through the joint, not through the larger square."""
    keep = [(i, j) for i in range(11) for j in range(5) if i < 6 or i > 6 or j == 2]
    mesh = rectangle(11, 5)
    loops = mesh.boundary_loops.vertices.reshape(-1, 4)
    dumbbell = agglo.Mesh.from_polygons(mesh.points, loops[[i * 5 + j for i, j in keep]])
    sides = sides_of(dumbbell.graph)
    assert (
        _normalised_cut(dumbbell.graph, sides)[0]
        < _normalised_cut(dumbbell.graph, sides_of(dumbbell.graph, split="median"))[0]
    )
    columns = np.array([i for i, _ in keep])
    assert len(set(sides[columns < 6].tolist())) == len(set(sides[columns > 6].tolist())) == 1


def test_global_random_state_is_left_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    sides_of(agglo.samples.voronoi(200, seed=0).graph)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize(
    "options", [{"split": "mean"}, {"balance": 0.6}, {"degeneracy": -1.0}, {"dense_limit": 3}]
)
def test_options_outside_their_range_are_refused(options):
    with pytest.raises(agglo.errors.OptionError, match=next(iter(options))):
        Spectral(**options)


@pytest.mark.parametrize("split", SPLITS)
def test_a_level_may_end_with_single_cells(split):
    graph = agglo.samples.strip(6).graph
    level, _ = graph.split(np.array([0, 0, 0, 0, 1, 2]))
    assert same_split(sides_of(level, split=split)[:4], np.array([0, 0, 1, 1]))
