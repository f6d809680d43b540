"""Annealing for solvers: its kernel against a slow twin, its sums, its shares and threads."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import Graph, agglomerate, samples
from agglo_core.anneal.inertia_annealing import CENTRE, SIZE, Pursuit, anneal_inertia, solver_state
from agglo_core.anneal.rounds import Ramps
from agglo_core.anneal.solver_parts import SolverAnnealing
from agglo_core.anneal.state import COUNT, DIAMETER, MEASURE, Shares
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.graph.solver_shape import solver_factors
from agglo_core.refine.part_sizes import FREE, Balance
from agglo_core.threads import using_threads

SEEDS = st.integers(0, 2**63)
MESHES = {
    "triangles": samples.random_triangles(60, seed=1),
    "voronoi": samples.voronoi(120, seed=2),
    "ring": samples.ring(30),
    "tetrahedra": samples.tetrahedra(2),
}
WORD = 2**64 - 1
value = OBJECTIVES["solver"].value


def connected(graph: Graph, labels: np.ndarray) -> bool:
    return len(np.unique(graph.components(frozen_int(labels)))) == labels.max() + 1


class SlowAnnealing:
    """The same draws, everything computed anew for each."""

    def __init__(self, graph: Graph, labels: np.ndarray, limit: float, seed: int, tolerance=np.inf) -> None:
        self.tolerance = tolerance
        self.graph, self.labels, self.limit, self.state = graph, labels.copy(), limit, seed
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        self.network = nx.Graph(zip(rows.tolist(), graph.indices.tolist(), strict=True))

    def bits(self) -> int:
        self.state = (self.state + 0x9E3779B97F4A7C15) & WORD
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & WORD
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & WORD
        return z ^ (z >> 31)

    def step(self, heat: float) -> None:
        bits = self.bits()
        i = ((bits >> 32) * self.graph.n) >> 32
        row = self.graph.indices[slice(*self.graph.indptr[i : i + 2])]
        p, q = self.labels[i], self.labels[row[((bits & (2**32 - 1)) * len(row)) >> 32]]
        if p == q or (self.labels == p).sum() < 2:
            return
        loss = heat * np.log(((self.bits() >> 11) + 0.5) / 2**53)
        moved = self.labels.copy()
        moved[i] = q
        if not nx.is_connected(self.network.subgraph(np.flatnonzero(moved == p).tolist())):
            return
        before, after = (self.graph.part_diameters(each)[q] for each in (self.labels, moved))
        if after > max(before, self.limit):
            return
        if self.pursued(moved) - self.pursued(self.labels) <= -loss:
            self.labels = moved

    def pursued(self, labels: np.ndarray) -> float:
        """The objective, and half the squares of measures beyond their bounds, in mean cells."""
        sizes = np.bincount(labels, self.graph.measures)
        off = np.maximum(np.abs(sizes - sizes.mean()) - self.tolerance * sizes.mean(), 0.0)
        return (
            self.graph.n * value(self.graph, labels) + 0.5 * ((off / self.graph.measures.mean()) ** 2).sum()
        )


def started(name: str, limit: float = np.inf, k: int = 5, balance: Balance = FREE):
    """Annealing on a mesh, its arguments, and connected labels in its order."""
    tool = SolverAnnealing(MESHES[name].graph, limit, balance)
    labels = tool.inward(agglomerate(MESHES[name], n_parts=k, polish=False).levels[0])
    heavy, long = (tool.graph.n * float(each[0]) for each in solver_factors(tool.graph, frozen_int([k])))
    bounds = balance.bounds(tool.sizes, k)
    pursuit = Pursuit(tool.graph.weights, tool.sizes, heavy, long, float(limit), *bounds)
    shares = Shares(
        np.arange(tool.graph.n, dtype=np.int32), np.array([0, tool.graph.n]), np.zeros(k, np.int32)
    )
    return tool, labels, pursuit, shares


def rounds(heat: float, draws: int) -> np.ndarray:
    """Two rounds at a temperature, with a penalty of a half."""
    return frozen_float([[heat] * 2, [0.5] * 2, [draws - draws // 2, draws // 2]])


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("limited", [False, True])
def test_the_kernel_moves_what_its_slow_twin_moves(name: str, limited: bool) -> None:
    widths = MESHES[name].graph.part_diameters(agglomerate(MESHES[name], n_parts=5, polish=False).levels[0])
    tool, labels, pursuit, shares = started(name, 0.97 * widths.max() if limited else np.inf)
    parts, room = solver_state(tool._cells, tool.graph.weights, tool.sizes, labels, 5, limited)
    draws = 700 // tool.graph.n + 1
    moved = anneal_inertia(
        tool._cells, parts, room, shares, 0, 1, pursuit, rounds(2.0, draws), np.uint64(99), 0
    )
    slow = SlowAnnealing(tool.graph, labels, pursuit.limit, 99 ^ 0x9E3779B97F4A7C15)
    for _ in range(draws * tool.graph.n):
        slow.step(2.0)
    np.testing.assert_array_equal(parts.labels, slow.labels)
    assert moved > 0


@pytest.mark.parametrize("name", ["triangles", "voronoi"])
def test_the_kernel_keeps_sizes_in_bounds_as_its_slow_twin_does(name: str) -> None:
    tool, labels, pursuit, shares = started(name, balance=Balance(0.05, "measure"))
    parts, room = solver_state(tool._cells, tool.graph.weights, tool.sizes, labels, 5, False)
    rest = rounds(1.0, 8), np.uint64(5), 0
    assert anneal_inertia(tool._cells, parts, room, shares, 0, 1, pursuit, *rest) > 0
    slow = SlowAnnealing(tool.graph, labels, np.inf, 5 ^ 0x9E3779B97F4A7C15, 0.05)
    for _ in range(8 * tool.graph.n):
        slow.step(1.0)
    np.testing.assert_array_equal(parts.labels, slow.labels)


@settings(max_examples=25)
@given(st.sampled_from(sorted(MESHES)), SEEDS, st.floats(0.01, 5.0), st.integers(1, 20), st.booleans())
def test_the_sums_of_the_parts_stay_those_of_their_cells(name, seed, heat, draws, limited) -> None:
    tool, labels, pursuit, shares = started(name, 0.6 if limited else np.inf)
    parts, room = solver_state(tool._cells, tool.graph.weights, tool.sizes, labels, 5, limited)
    anneal_inertia(tool._cells, parts, room, shares, 0, 1, pursuit, rounds(heat, draws), np.uint64(seed), 0)
    graph, after = tool.graph, frozen_int(parts.labels)
    assert connected(graph, after)
    np.testing.assert_array_equal(parts.tally[:, COUNT], np.bincount(after))
    np.testing.assert_array_equal(parts.tally[:, SIZE], np.bincount(after))
    mass = np.bincount(after, graph.weights)
    np.testing.assert_allclose(parts.tally[:, MEASURE], mass)
    for a, x in enumerate(graph.centroids.T):
        np.testing.assert_allclose(
            parts.tally[:, CENTRE + a], np.bincount(after, graph.weights * x) / mass, atol=1e-9
        )
    if limited:
        np.testing.assert_allclose(parts.tally[:, DIAMETER], graph.part_diameters(after))


def test_shares_trade_with_no_others() -> None:
    tool, labels, pursuit, _ = started("voronoi")
    rows = np.repeat(labels, np.diff(tool.graph.indptr))
    of_part = np.ones(5, np.int32)
    of_part[[0, labels[tool.graph.indices][(rows == 0) & (labels[tool.graph.indices] > 0)][0]]] = 0
    first = of_part[labels] == 0
    cells = np.argsort(of_part[labels], kind="stable").astype(np.int32)
    shares = Shares(cells, np.array([0, first.sum(), len(cells)]), of_part)
    parts, room = solver_state(tool._cells, tool.graph.weights, tool.sizes, labels, 5, False)
    anneal_inertia(tool._cells, parts, room, shares, 0, 1, pursuit, rounds(30.0, 20), np.uint64(1), 0)
    assert (parts.labels[first] != labels[first]).any()
    np.testing.assert_array_equal(parts.labels[~first], labels[~first])
    anneal_inertia(tool._cells, parts, room, shares, 1, 2, pursuit, rounds(30.0, 20), np.uint64(1), 10**6)
    np.testing.assert_array_equal(of_part[parts.labels], of_part[labels])


def test_labels_do_not_depend_on_the_number_of_threads() -> None:
    mesh = samples.voronoi(7000, seed=3)
    first = agglomerate(mesh, n_parts=440).levels[0]
    found = []
    for threads in (1, 2, 3):
        with using_threads(threads):
            tool = SolverAnnealing(mesh.graph)
            found.append(tool.outward(tool.annealed(tool.inward(first), Ramps(2.0, 0.05), 160.0, 7)))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    assert (found[0] != first).mean() > 0.2
