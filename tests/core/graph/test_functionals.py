"""Cut, volume, normalised cut: networkx as oracle; expectations against every possible partition."""

from __future__ import annotations

from itertools import product

import networkx as nx
import numpy as np
import pytest

from agglo_core import functionals, samples
from agglo_core.errors import OptionError
from agglo_core.graph import Graph


@pytest.fixture(scope="module")
def graph() -> Graph:
    return samples.voronoi(60, seed=1).graph


def _networkx(graph: Graph) -> nx.Graph:
    return nx.from_scipy_sparse_array(graph.to_scipy())


@pytest.mark.parametrize("weight", [None, "weight"])
def test_values_agree_with_networkx(graph: Graph, weight: str | None) -> None:
    labels = np.random.default_rng(0).integers(0, 4, graph.n)
    edge_weights = graph.interface if weight else None
    peer = _networkx(graph)
    parts = [np.flatnonzero(labels == k).tolist() for k in range(4)]
    cuts = [nx.cut_size(peer, part, weight=weight) for part in parts]
    volumes = [nx.volume(peer, part, weight=weight) for part in parts]
    np.testing.assert_allclose(functionals.part_cuts(graph, labels, edge_weights=edge_weights), cuts)
    np.testing.assert_allclose(functionals.part_volumes(graph, labels, edge_weights=edge_weights), volumes)
    assert functionals.cut(graph, labels, edge_weights=edge_weights) == pytest.approx(sum(cuts) / 2)
    assert functionals.normalised_cut(graph, labels, edge_weights=edge_weights) == pytest.approx(
        sum(c / v for c, v in zip(cuts, volumes, strict=True))
    )


def test_two_parts_agree_with_networkx(graph: Graph) -> None:
    sides = (graph.centroids[:, 0] > 0).astype(int)
    first, second = (np.flatnonzero(sides == k).tolist() for k in range(2))
    ours = functionals.normalised_cut(graph, sides)
    assert ours == pytest.approx(nx.normalized_cut_size(_networkx(graph), first, second))


def test_lengths_and_areas_serve_as_weights() -> None:
    graph = samples.squares(4).graph
    halves = (graph.centroids[:, 0] > 0).astype(int)
    assert functionals.cut(graph, halves) == 4
    assert functionals.cut(graph, halves, edge_weights=graph.interface) == pytest.approx(1.0)
    areas = functionals.part_volumes(graph, halves, node_weights=graph.measures)
    np.testing.assert_allclose(areas, [0.5, 0.5])
    both = {"edge_weights": graph.interface, "node_weights": graph.measures}
    assert functionals.normalised_cut(graph, halves, **both) == pytest.approx(4.0)
    certain = np.eye(2)[halves]
    assert functionals.expected_normalised_cut(graph, certain, **both) == pytest.approx(4.0)


@pytest.mark.parametrize("weighted", [False, True])
def test_expectations_are_those_of_independent_draws(weighted: bool) -> None:
    graph = samples.squares(2).graph
    rng = np.random.default_rng(2)
    edge_weights = None
    if weighted:
        upper = np.triu(rng.random((4, 4)), 1)
        rows = np.repeat(np.arange(4), np.diff(graph.indptr))
        edge_weights = (upper + upper.T)[rows, graph.indices]
    Y = rng.dirichlet(np.ones(3), size=4)
    cuts, volumes = np.zeros(3), np.zeros(3)
    for labels in product(range(3), repeat=4):
        chance = np.prod(Y[np.arange(4), labels])
        padded = np.zeros((2, 3))
        found = max(labels) + 1
        padded[0, :found] = functionals.part_cuts(graph, labels, edge_weights=edge_weights)
        padded[1, :found] = functionals.part_volumes(graph, labels, edge_weights=edge_weights)
        cuts += chance * padded[0]
        volumes += chance * padded[1]
    np.testing.assert_allclose(functionals.expected_cuts(graph, Y, edge_weights=edge_weights), cuts)
    np.testing.assert_allclose(functionals.expected_volumes(graph, Y, edge_weights=edge_weights), volumes)
    total = functionals.expected_normalised_cut(graph, Y, edge_weights=edge_weights)
    assert total == pytest.approx((cuts / volumes).sum())


def test_expected_normalised_cut_is_the_formula_of_the_paper(graph: Graph) -> None:
    Y = np.random.default_rng(3).dirichlet(np.ones(2), size=graph.n)
    A = (graph.to_scipy().toarray() > 0).astype(float)
    gamma = Y.T @ A.sum(axis=1)
    expected = (((Y / gamma) @ (1 - Y).T) * A).sum()
    assert functionals.expected_normalised_cut(graph, Y) == pytest.approx(expected)


def test_certain_probabilities_give_the_plain_values(graph: Graph) -> None:
    labels = np.random.default_rng(4).integers(0, 3, graph.n)
    Y = np.eye(3)[labels]
    np.testing.assert_allclose(functionals.expected_cuts(graph, Y), functionals.part_cuts(graph, labels))
    np.testing.assert_allclose(
        functionals.expected_volumes(graph, Y), functionals.part_volumes(graph, labels)
    )


def test_a_node_without_neighbours_adds_nothing() -> None:
    graph = samples.squares(1).graph
    assert functionals.normalised_cut(graph, [0]) == 0.0
    assert functionals.expected_normalised_cut(graph, [[0.5, 0.5]]) == 0.0


def test_wrong_shapes_are_refused(graph: Graph) -> None:
    with pytest.raises(OptionError, match="labels must be"):
        functionals.cut(graph, [0, 1])
    with pytest.raises(OptionError, match="labels must be"):
        functionals.cut(graph, np.full(graph.n, -1))
    with pytest.raises(OptionError, match="Y must have shape"):
        functionals.expected_cuts(graph, np.ones(graph.n))
    for wrong in (-0.1, 1.1, np.nan):
        for expectation in (
            functionals.expected_cuts,
            functionals.expected_volumes,
            functionals.expected_normalised_cut,
        ):
            with pytest.raises(OptionError, match=r"probabilities in \[0, 1\]"):
                expectation(graph, np.full((graph.n, 2), wrong))
    with pytest.raises(OptionError, match="edge_weights must have shape"):
        functionals.cut(graph, np.zeros(graph.n, int), edge_weights=np.ones(3))
