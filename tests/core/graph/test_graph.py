"""The dual graph: slow reference implementations, networkx and scipy as oracles, blocks, quotients."""

from __future__ import annotations

import dataclasses
import pickle
from collections import defaultdict
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from scipy.spatial import Delaunay
from scipy.spatial.distance import pdist

from agglo_core import AggloError, Graph, Mesh, MeshError, OptionError, agglomerate, samples
from agglo_core.arrays import index_cast
from agglo_core.authoring import InertialBisection, System

ARRAYS = ("indptr", "indices", "interface", "centroids", "measures", "boundary", "weights", "vertex_offsets")


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


@st.composite
def meshes(draw: st.DrawFn) -> Mesh:
    """Small meshes in the plane and in space, fine or coarsened (parallel faces, holes, loose cells)."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    kind = draw(st.sampled_from(["squares", "delaunay", "voronoi", "boxes", "tetrahedra"]))
    if kind == "delaunay":
        points = rng.random((draw(st.integers(4, 20)), 2))
        mesh = Mesh.from_polygons(points, Delaunay(points).simplices)
    elif kind == "voronoi":
        mesh = samples.voronoi(draw(st.integers(2, 12)), seed=int(rng.integers(100)))
    else:
        mesh = getattr(samples, kind)(draw(st.integers(1, 3)))
    tags = {"material": rng.integers(0, 3, mesh.n_cells)}
    mesh = Mesh(mesh.points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, tags)
    if draw(st.booleans()):
        mesh = mesh.coarsen(compact(rng.integers(0, 5, mesh.n_cells)))
    return mesh


@st.composite
def labelled(draw: st.DrawFn) -> tuple[Mesh, np.ndarray]:
    mesh = draw(meshes())
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    return mesh, compact(rng.integers(0, draw(st.integers(1, 5)), mesh.n_cells))


def rows(graph: Graph) -> list[dict[int, float]]:
    """Neighbours of each node with the interface."""
    return [
        dict(zip(graph.indices[i:j].tolist(), graph.interface[i:j].tolist(), strict=True))
        for i, j in zip(graph.indptr[:-1], graph.indptr[1:], strict=True)
    ]


def slow_rows(mesh: Mesh) -> tuple[list[dict[int, float]], np.ndarray]:
    found: list[dict[int, float]] = [defaultdict(float) for _ in range(mesh.n_cells)]
    boundary = np.zeros(mesh.n_cells)
    for (a, b), length in zip(mesh.face_cells.tolist(), mesh.face_measures.tolist(), strict=True):
        if b < 0:
            boundary[a] += length
        else:
            found[a][b] += length
            found[b][a] += length
    return found, boundary


def corners(graph: Graph, node: int) -> np.ndarray:
    return np.unique(graph.vertices[graph.vertex_offsets[node] : graph.vertex_offsets[node + 1]])


def same(a: Graph, b: Graph) -> None:
    for name in (*ARRAYS, "offsets", "origin"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12, err_msg=name)
    for node in range(a.n):
        np.testing.assert_array_equal(a.points[corners(a, node)], b.points[corners(b, node)])
    assert a.data.keys() == b.data.keys()
    for name, values in a.data.items():
        np.testing.assert_array_equal(values, b.data[name])


# --- from a mesh ----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(meshes())
def test_the_dual_graph_is_what_a_loop_over_the_faces_gives(mesh: Mesh) -> None:
    graph = mesh.graph
    wanted, boundary = slow_rows(mesh)
    for row, expected in zip(rows(graph), wanted, strict=True):
        assert row == pytest.approx(dict(expected))
    np.testing.assert_allclose(graph.boundary, boundary, atol=1e-14)
    np.testing.assert_allclose(graph.centroids + graph.origin, mesh.cell_centroids, atol=1e-13)
    np.testing.assert_array_equal(graph.measures, mesh.cell_measures)
    assert graph.weights is graph.measures
    assert (graph.n, graph.dim, graph.n_blocks) == (mesh.n_cells, mesh.dim, 1)
    for name, values in mesh.cell_tags.items():
        np.testing.assert_array_equal(graph.data[name], values)
    graph.check()


def test_a_path_of_three_squares() -> None:
    graph = samples.strip(3).graph
    assert rows(graph)[1].keys() == {0, 2}
    assert repr(graph) == "Graph(2-D, 3 nodes, 2 edges)"
    assert graph.indptr.dtype == graph.offsets.dtype == np.int64
    assert graph.indices.dtype == graph.vertices.dtype == np.int32
    assert not any(getattr(graph, name).flags.writeable for name in ARRAYS)


def test_several_faces_with_one_neighbour_are_one_edge() -> None:
    mesh = samples.squares(4)
    x = np.round(mesh.cell_centroids[:, 0] * 4 - 0.5).astype(int)
    graph = mesh.coarsen((x > 1).astype(int)).graph
    assert graph.indices.tolist() == [1, 0]
    np.testing.assert_allclose(graph.interface, [1, 1])


# --- components ----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_components_are_those_of_networkx(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    graph = mesh.graph
    net = nx.from_scipy_sparse_array(graph.to_scipy())
    for parts in (np.zeros(graph.n, int), labels):
        cut = [(i, j) for i, j in net.edges if parts[i] != parts[j]]
        whole = net.copy()
        whole.remove_edges_from(cut)
        wanted = sorted(sorted(nodes) for nodes in nx.connected_components(whole))
        found = graph.components(parts)
        assert [np.flatnonzero(found == c).tolist() for c in range(found.max() + 1)] == wanted
    np.testing.assert_array_equal(graph.components(), graph.components(np.zeros(graph.n, int)))


@pytest.mark.parametrize("labels", [[0, 0, -1, 0], [0, 0, 0]])
def test_components_of_labels_that_do_not_fit(labels: list[int]) -> None:
    with pytest.raises(MeshError, match=r"labels must be \(4,\) non-negative integers"):
        samples.squares(2).graph.components(labels)


# --- diameters -----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_diameters_are_exact(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    graph = mesh.graph
    wanted = [
        pdist(graph.points[np.concatenate([corners(graph, c) for c in np.flatnonzero(labels == p)])]).max()
        for p in range(labels.max() + 1)
    ]
    np.testing.assert_allclose(graph.part_diameters(labels), wanted, rtol=1e-12)
    np.testing.assert_allclose(graph.split(labels)[0].diameters(), wanted, rtol=1e-12)
    np.testing.assert_allclose(graph.diameters()[0], pdist(graph.points[np.unique(graph.vertices)]).max())


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("shape", ["cloud", "sphere", "simplex", "line", "lattice", "pair"])
def test_diameters_of_point_clouds(d: int, shape: str) -> None:
    """Clouds larger than the part that is compared pair by pair, many of their points far out."""
    rng = np.random.default_rng(d)
    cloud = rng.normal(size=(400, d))
    if shape == "sphere":
        cloud /= np.linalg.norm(cloud, axis=1)[:, None]
    elif shape == "simplex":
        cloud = rng.dirichlet(np.full(d + 1, 0.3), 400) @ np.vstack((np.eye(d), np.zeros(d)))
    elif shape == "line":
        cloud = rng.random(400)[:, None] * np.arange(1, d + 1)
    elif shape == "lattice":
        cloud = rng.integers(0, 4, (400, d)).astype(float)
    elif shape == "pair":
        cloud = np.repeat(cloud[:2], 200, axis=0)
    graph = Graph.from_arrays(np.zeros(401, int), [], cloud)
    assert graph.diameters()[0] == pytest.approx(pdist(cloud).max(), rel=1e-13)


# --- blocks --------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_splitting_gives_the_parts_as_blocks(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    graph = mesh.graph
    level, order = graph.split(labels)
    np.testing.assert_array_equal(labels[order], level.block_ids)
    np.testing.assert_array_equal(level.offsets, np.cumsum([0, *np.bincount(labels)]))
    matrix = graph.to_scipy().toarray()
    for b in range(level.n_blocks):
        nodes = np.flatnonzero(labels == b)
        block = level[b]
        np.testing.assert_array_equal(order[level.offsets[b] : level.offsets[b + 1]], nodes)
        np.testing.assert_array_equal(block.to_scipy().toarray(), matrix[np.ix_(nodes, nodes)])
        np.testing.assert_array_equal(block.centroids, graph.centroids[nodes])
        np.testing.assert_array_equal(block.measures, graph.measures[nodes])
        np.testing.assert_array_equal(block.boundary, graph.boundary[nodes])
        for k, node in enumerate(nodes):
            np.testing.assert_array_equal(corners(block, k), corners(graph, node))
        for name, values in graph.data.items():
            np.testing.assert_array_equal(block.data[name], values[nodes])


@settings(max_examples=25, deadline=None)
@given(labelled(), st.randoms(use_true_random=False))
def test_taking_blocks_is_taking_them_one_by_one(case: tuple[Mesh, np.ndarray], random: object) -> None:
    mesh, labels = case
    level = mesh.graph.split(labels)[0]
    blocks = np.arange(level.n_blocks)
    random.shuffle(blocks)  # type: ignore[attr-defined]
    chosen = blocks[: max(1, len(blocks) // 2)]
    taken = level.take(chosen)
    assert taken.n_blocks == len(chosen)
    for k, b in enumerate(chosen):
        same(taken[k], level[b])
        same(level.take([b]), level[b])
    same(level.take(np.arange(level.n_blocks)), level)


def test_blocks_by_number() -> None:
    level = samples.squares(2).graph.split([0, 1, 1, 0])[0]
    same(level[-1], level[1])
    for block in (2, -3):
        with pytest.raises(IndexError, match="the graph has 2 blocks"):
            level[block]


def test_a_part_of_a_part_has_the_boundary_and_vertices_of_its_cells() -> None:
    graph = samples.voronoi(40, seed=2).graph
    rng = np.random.default_rng(1)
    first, second = rng.permutation(40)[:30], rng.permutation(30)[:12]
    part = graph.subgraph(first, [0, 30]).subgraph(second, [0, 12])
    copy = pickle.loads(pickle.dumps(graph.subgraph(first, [0, 30]).subgraph(second, [0, 12])))
    assert "_whole" not in vars(copy)
    for each in (part, copy):
        np.testing.assert_array_equal(each.boundary, graph.boundary[first[second]])
        for k, cell in enumerate(first[second]):
            own = each.vertices[each.vertex_offsets[k] : each.vertex_offsets[k + 1]]
            wanted = graph.vertices[graph.vertex_offsets[cell] : graph.vertex_offsets[cell + 1]]
            np.testing.assert_array_equal(own, wanted)
    with pytest.raises(AttributeError, match="volume"):
        _ = part.volume


def test_a_permuted_graph() -> None:
    graph = samples.voronoi(50, seed=2).graph
    order = np.random.default_rng(0).permutation(50)
    permuted = graph.subgraph(order, [0, 50])
    wanted = graph.to_scipy().toarray()[np.ix_(order, order)]
    np.testing.assert_array_equal(permuted.to_scipy().toarray(), wanted)
    same(permuted.subgraph(np.argsort(order), [0, 50]), graph)


# --- quotients -----------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_the_graph_of_the_coarse_mesh_is_the_coarse_graph(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    coarse, quotient = mesh.coarsen(labels).graph, mesh.graph.coarsen(labels)
    assert [row.keys() for row in rows(quotient)] == [row.keys() for row in rows(coarse)]
    for row, expected in zip(rows(quotient), rows(coarse), strict=True):
        assert row == pytest.approx(expected)
    for name in ("measures", "weights", "boundary", "centroids"):
        np.testing.assert_allclose(getattr(quotient, name), getattr(coarse, name), rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(quotient.diameters(), coarse.diameters(), rtol=1e-12)
    np.testing.assert_allclose(
        quotient.part_diameters(np.arange(quotient.n)), mesh.graph.part_diameters(labels)
    )
    quotient.check()


@settings(max_examples=30, deadline=None)
@given(labelled())
def test_the_quotient_is_that_of_networkx(case: tuple[Mesh, np.ndarray]) -> None:
    mesh, labels = case
    net = nx.from_scipy_sparse_array(mesh.graph.to_scipy())
    partition = [set(np.flatnonzero(labels == p).tolist()) for p in range(labels.max() + 1)]
    quotient = nx.quotient_graph(net, partition, relabel=True)
    wanted = nx.to_numpy_array(quotient, nodelist=range(len(partition)))
    np.testing.assert_allclose(mesh.graph.coarsen(labels).to_scipy().toarray(), wanted, atol=1e-12)


def test_weights_of_their_own_add_up_too() -> None:
    graph = Graph.from_arrays([0, 1, 3, 4], [1, 0, 2, 1], [[0, 0], [1, 0], [2, 0]], weights=[1, 2, 5])
    coarse = graph.coarsen([0, 0, 1])
    assert coarse.weights.tolist() == [3, 5]
    assert coarse.measures.tolist() == [2, 1]
    assert (coarse.centroids + coarse.origin).tolist() == [[0.5, 0], [2, 0]]


# --- from arrays ---------------------------------------------------------------------------------------


def test_a_graph_from_a_matrix_and_centroids() -> None:
    matrix = sparse.csr_array(nx.to_scipy_sparse_array(nx.karate_club_graph(), dtype=float))
    rng = np.random.default_rng(0)
    at = rng.random((34, 2)) + 100
    graph = Graph.from_arrays(
        matrix.indptr, matrix.indices, at, interface=matrix.data, data={"id": np.arange(34)}
    )
    assert (graph.to_scipy() != matrix).nnz == 0
    np.testing.assert_allclose(graph.centroids + graph.origin, at)
    assert graph.diameters()[0] == pytest.approx(pdist(at).max())
    assert graph.measures.tolist() == [1.0] * 34
    assert graph.split(np.arange(34) % 2)[0].data["id"][:3].tolist() == [0, 2, 4]


# --- from sparse matrices --------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 9),
    st.integers(0, 10**6),
    st.sampled_from(["bsr", "coo", "csc", "csr", "dia", "dok", "lil"]),
    st.sampled_from([sparse.csr_array, sparse.csr_matrix]),
)
def test_a_graph_from_any_sparse_matrix(n: int, seed: int, form: str, container: type) -> None:
    rng = np.random.default_rng(seed)
    dense = rng.integers(-2, 3, (n, n)).astype(float)
    A = container(dense).tobsr((1, 1)) if form == "bsr" else container(dense).asformat(form)
    graph, points = Graph.from_scipy(A), rng.random((n, 3))
    wanted = (abs(dense) + abs(dense.T)) / 2 * (1 - np.eye(n))
    np.testing.assert_array_equal(graph.to_scipy().toarray(), wanted)
    assert len(graph.indices) == np.count_nonzero(wanted)
    assert graph.measures.tolist() == graph.weights.tolist() == [1.0] * n
    assert graph.boundary.tolist() == [0.0] * n
    np.testing.assert_array_equal(A.toarray(), dense)
    placed = Graph.from_scipy(A, points)
    np.testing.assert_array_equal(placed.to_scipy().toarray(), wanted)
    np.testing.assert_allclose(placed.centroids + placed.origin, points)


def test_stored_zeros_are_no_edges_and_duplicates_add_up() -> None:
    entries = [1.0, 2.0, 0.0, 5.0], ([0, 0, 1, 2], [1, 1, 2, 2])
    graph = Graph.from_scipy(sparse.coo_array(entries, shape=(3, 3)))
    assert (graph.indptr.tolist(), graph.indices.tolist()) == ([0, 1, 2, 2], [1, 0])
    assert graph.interface.tolist() == [1.5, 1.5]
    assert graph.components().tolist() == [0, 0, 1]


def test_the_nodes_of_a_block_matrix_are_its_blocks() -> None:
    rng = np.random.default_rng(5)
    A = sparse.bsr_array(rng.normal(size=(12, 12)) * (rng.random((12, 12)) < 0.3), blocksize=(3, 3))
    points = rng.random((4, 2))
    graph = Graph.from_scipy(A, points)
    sums = abs(A.toarray()).reshape(4, 3, 4, 3).sum(axis=(1, 3))
    expected = (sums + sums.T) / 2 * (1 - np.eye(4))
    np.testing.assert_allclose(graph.to_scipy().toarray(), expected, rtol=1e-14)
    np.testing.assert_array_equal(graph.centroids + graph.origin, points)
    assert Graph.from_scipy(A.tocsr()).n == 12
    assert Graph.from_scipy(sparse.bsr_array(A, blocksize=(3, 2))).n == 12  # blocks that are not square
    with pytest.raises(
        MeshError, match=r"\(4, 2\) or \(4, 3\), one point for each block of A, not \(12, 2\)"
    ):
        Graph.from_scipy(A, rng.random((12, 2)))


def test_unknowns_without_points_are_cut_by_their_couplings() -> None:
    strong = sparse.block_diag([np.ones((4, 4))] * 3, format="lil")  # three strongly coupled groups
    strong[3, 4] = strong[7, 8] = -0.01
    order = np.random.default_rng(0).permutation(12)
    graph = Graph.from_scipy(strong.tocsr()[order][:, order])
    labels = agglomerate(graph, bisector="spectral", n_parts=3).levels[0]
    assert len(np.unique(np.column_stack((labels, order // 4)), axis=0)) == 3
    assert agglomerate(graph, bisector="metis").parts == [2]  # by default 8 nodes per part


@pytest.mark.parametrize(
    "bisector",
    ["kmeans", "kmeans_sklearn", "coordinate", "inertial", "sweep", "gnn", InertialBisection()],
)
def test_bisectors_by_coordinates_are_refused_without_points(bisector: Any) -> None:
    A = sparse.diags_array([1.0, 2.0, 1.0], offsets=[-1, 0, 1], shape=(9, 9))
    message = r"coordinates, but all points .* give points, or .* such as 'metis' or 'spectral'$"
    with pytest.raises(OptionError, match=message):
        agglomerate(Graph.from_scipy(A), bisector=bisector, n_parts=3)
    some = np.repeat([[0.0, 0.0], [1.0, 0.0]], [4, 5], axis=0)
    assert agglomerate(Graph.from_scipy(A, some), bisector=bisector, n_parts=2).parts == [2]
    alone = Graph.from_scipy(sparse.csr_array([[1.0]]))
    assert agglomerate(alone, bisector=bisector, n_parts=1).parts == [1]


def test_a_partition_by_coordinates_is_refused_without_points() -> None:
    graph = Graph.from_scipy(sparse.csr_array(np.ones((9, 9))))
    with pytest.raises(OptionError, match=r"'kmeans' .* splits by coordinates"):
        agglomerate(graph, bisector="kmeans", method="kway", n_parts=3)
    assert agglomerate(graph, bisector="metis", method="kway", n_parts=3).parts == [3]


@pytest.mark.parametrize("name", ["h_star", "h_factor"])
def test_sizes_are_refused_without_points(name: str) -> None:
    graph = Graph.from_scipy(sparse.csr_array(np.ones((4, 4))))
    message = (
        f"^{name} needs points, but all points of the graph coincide, .* give points, or n_parts or cells"
    )
    with pytest.raises(OptionError, match=message):
        agglomerate(graph, bisector="spectral", **{name: 2.0})


@pytest.mark.parametrize(
    ("A", "points", "message"),
    [
        (np.eye(3), None, r"needs a sparse matrix of scipy, given ndarray: .*csr_array\(A\)"),
        (sparse.csr_array((2, 3)), None, r"A must be a square matrix, given shape \(2, 3\)"),
        (sparse.csr_array([[1, np.nan], [1, 1]]), None, r"A\[0, 1\] is nan: it must be finite"),
        (sparse.csr_array([[1, 1], [-np.inf, 1]]), None, r"A\[1, 0\] is -inf: it must be finite"),
        (sparse.csr_array([[1j]]), None, "A holds complex128; expected real numbers"),
        (sparse.csr_array((0, 0)), None, "the graph is empty"),
        (sparse.eye_array(3), [[0, 0]], r"points must have shape \(3, 2\) or \(3, 3\), .* not \(1, 2\)"),
        (sparse.eye_array(2), [[0, 0], [np.nan, 0]], r"centroids\[1, 0\] is nan: it must be finite"),
    ],
)
def test_bad_matrices_and_points_are_named(A: Any, points: Any, message: str) -> None:
    with pytest.raises(AggloError, match=message):
        Graph.from_scipy(A, points)


def test_scipy_gets_arrays_of_its_own() -> None:
    graph = samples.hexagons(5).graph
    adjacency = graph.to_scipy()
    assert (adjacency - adjacency.T).count_nonzero() == 0  # scipy sorts in place on the way
    adjacency.data[:] = 0.0
    assert graph.interface.min() > 0


def test_sparse_matrices_have_indices_in_32_bits_where_they_fit() -> None:
    """PyAMG and scikit-learn take no others."""
    mesh = samples.squares(6)
    hierarchy = agglomerate(mesh, n_parts=(9, 3))
    coarse = hierarchy.cut_at(1)
    fine = coarse.refine([0]).cut
    wide = sparse.csr_array((np.ones(36), np.arange(36), np.arange(37)), shape=(36, 36))
    assert wide.indices.dtype == np.int64
    matrices = [mesh.graph.to_scipy(), hierarchy.prolongation(0), hierarchy.prolongation(1)]
    matrices += [hierarchy.overlap(0), coarse.prolongation(fine), fine.restriction(coarse)]
    matrices += [System(wide, np.ones(36)).to_scipy()[0]]
    for matrix in matrices:
        assert (matrix.indices.dtype, matrix.indptr.dtype) == (np.int32, np.int32)
    np.testing.assert_array_equal(matrices[1].toarray(), np.eye(9)[hierarchy.levels[0]])
    np.testing.assert_array_equal(matrices[-1].toarray(), np.eye(36))
    assert index_cast(np.arange(2), 2**31).dtype == np.int64


def test_a_graph_does_not_share_arrays_that_can_be_written_to() -> None:
    graph = samples.squares(2).graph
    fields = {field.name: getattr(graph, field.name) for field in dataclasses.fields(Graph)}
    weights, rock = np.arange(1.0, 5.0), np.arange(4)
    made = Graph(**fields | {"weights": weights, "data": {"rock": rock}})
    weights *= 2
    rock += 7
    assert made.weights.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert made.data["rock"].tolist() == [0, 1, 2, 3]
    same = Graph(**fields | {"measures": weights, "weights": weights})
    assert same.weights is same.measures


def test_equal_graphs_have_equal_pickles_whatever_was_computed() -> None:
    graph, used = (samples.squares(4).graph for _ in range(2))
    part = used.subgraph([0, 1, 2, 3], [0, 4])
    assert (used.sizes.tolist(), used.block_ids.tolist()) == ([16], [0] * 16)
    assert pickle.dumps(used) == pickle.dumps(graph)
    copy = pickle.loads(pickle.dumps(part))
    assert copy.vertices.tolist() == part.vertices.tolist()
    assert not copy.indices.flags.writeable
    assert copy.weights is copy.measures
    mass = pickle.loads(pickle.dumps(graph.with_mass(np.arange(16.0)))).mass
    assert mass.tolist() == list(range(16))
