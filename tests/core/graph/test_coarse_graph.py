"""Quotient graphs are, to the last bit, the products of sparse matrices that define them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from agglo_core import Graph, Mesh, samples
from agglo_core.graph.quotient import quotient


def by_products(labels: np.ndarray, fine: Graph) -> dict[str, Any]:
    """The quotient by matrix products and a sort of all vertices."""
    n, k, n_points = fine.n, int(labels.max()) + 1, len(fine.points)
    G = sparse.csr_array((np.ones(n), (labels, np.arange(n))), shape=(k, n))
    product = sparse.coo_array(G @ fine.to_scipy() @ G.T)
    outer = product.row != product.col
    A = sparse.csr_array((product.data[outer], (product.row[outer], product.col[outer])), shape=(k, k))
    mass = fine.measures if (G @ fine.measures > 0).all() else np.ones(n)
    corners = np.unique(np.repeat(labels, np.diff(fine.vertex_offsets)) * n_points + fine.vertices)
    return {
        "indptr": A.indptr,
        "indices": A.indices,
        "interface": A.data,
        "centroids": (G @ (fine.centroids * mass[:, None])) / (G @ mass)[:, None],
        "measures": G @ fine.measures,
        "boundary": G @ fine.boundary,
        "weights": G @ fine.weights,
        "vertex_offsets": np.searchsorted(corners, np.arange(k + 1) * n_points),
        "vertices": corners % n_points,
    }


def same(labels: np.ndarray, fine: Graph) -> None:
    found = quotient(labels, fine)._asdict()
    for name, wanted in by_products(labels, fine).items():
        np.testing.assert_array_equal(found[name], wanted, err_msg=name)


@pytest.mark.parametrize("parts", [1, 2, 7, 60, 400])
@pytest.mark.parametrize(
    "mesh",
    [samples.voronoi(400, seed=3), samples.random_triangles(220, seed=4), samples.tetrahedra(5)],
    ids=lambda mesh: mesh.name,
)
def test_a_quotient_is_the_product_of_matrices(mesh: Mesh, parts: int) -> None:
    """For parts that are cells in space, and for parts that lie all over the place."""
    rng = np.random.default_rng(parts)
    near = np.linalg.norm(mesh.cell_centroids[:, None] - rng.random((parts, mesh.dim)), axis=2).argmin(axis=1)
    for labels in (near, rng.integers(0, parts, mesh.n_cells)):
        same(np.unique(labels, return_inverse=True)[1], mesh.graph)


def test_a_quotient_of_a_quotient_and_of_a_hub() -> None:
    fine = samples.voronoi(300, seed=1).graph
    labels = np.where(fine.centroids[:, 0] < 0, 0, np.arange(fine.n))
    labels = np.unique(labels, return_inverse=True)[1]
    hub = fine.coarsen(labels)
    assert np.diff(hub.indptr).max() > 15
    same(np.arange(hub.n) // 3, hub)
    same(np.arange(hub.n), hub)


def test_edges_of_no_measure_stay_and_cells_of_no_measure_count_once() -> None:
    graph = Graph.from_arrays(
        [0, 1, 3, 5, 6],
        [1, 0, 2, 1, 3, 2],
        [[0, 0], [1, 0], [2, 0], [3, 0]],
        interface=[1, 1, 0, 0, 1, 1],
        measures=[0, 0, 1, 2],
    )
    labels = np.array([0, 0, 1, 1])
    coarse = graph.coarsen(labels)
    assert coarse.indices.tolist() == [1, 0]
    assert coarse.interface.tolist() == [0, 0]
    assert (coarse.centroids + coarse.origin)[:, 0].tolist() == [0.5, 2.5]


def test_weights_that_are_measures_stay_so() -> None:
    fine = samples.squares(4).graph
    coarse = fine.coarsen(np.arange(16) // 4)
    assert coarse.weights is coarse.measures
