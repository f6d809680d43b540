"""Annealing: its kernels against slow, obvious twins, and what its parts are cut into and dissolved to."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.distance import pdist, squareform

from agglo_core import Graph, Mesh, agglomerate, quality, samples
from agglo_core.anneal.annealed_parts import Annealing, Shapes, Weights, too_wide
from agglo_core.anneal.circle_annealing import anneal_circles
from agglo_core.anneal.circles import CENTRED, RADIUS, circle_state
from agglo_core.anneal.moment_annealing import anneal
from agglo_core.anneal.rounds import Ramps, take_turns
from agglo_core.anneal.state import COUNT, DIAMETER, MEASURE, SURFACE, Shares
from agglo_core.anneal.widths import part_state
from agglo_core.arrays import frozen_int, splitmix
from agglo_core.progress import TimeLimit
from agglo_core.threads import using_threads

SEEDS = st.integers(0, 2**63)
MESHES = {
    "triangles": samples.random_triangles(40, seed=4),
    "voronoi": samples.voronoi(50, seed=2),
    "hexagons": samples.hexagons(7),
    "tetrahedra": samples.tetrahedra(2),
}
FLAT = [name for name, mesh in MESHES.items() if mesh.dim == 2]


def started(name: str, k: int = 5) -> tuple[Annealing, np.ndarray]:
    """Annealing on a mesh, and connected labels in its order."""
    mesh = MESHES[name]
    tool = Annealing(mesh.graph)
    return tool, tool.inward(agglomerate(mesh, n_parts=k, polish=False).levels[0])


def width(graph: Graph, cells: np.ndarray) -> float:
    """Largest distance of two vertices of some cells."""
    rows = [graph.vertices[slice(*graph.vertex_offsets[i : i + 2])] for i in cells]
    return float(pdist(graph.points[np.unique(np.concatenate(rows))]).max())


def surface(graph: Graph, inside: np.ndarray) -> float:
    """Measure of the faces around the cells of a mask."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    out = inside[rows] & ~inside[graph.indices]
    return float(graph.boundary[inside].sum() + graph.interface[out].sum())


def network(graph: Graph) -> nx.Graph:
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    return nx.Graph(zip(rows.tolist(), graph.indices.tolist(), strict=True))


class SlowAnnealing:
    """The same draws, everything computed anew for each."""

    def __init__(self, graph: Graph, labels: np.ndarray, size: float, seed: int) -> None:
        self.graph, self.labels, self.size, self.state = graph, labels.copy(), size, seed
        self.network = network(graph)

    def bits(self) -> int:
        word = 2**64 - 1
        self.state = (self.state + 0x9E3779B97F4A7C15) & word
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & word
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & word
        return z ^ (z >> 31)

    def score(self, labels: np.ndarray, part: int, penalty: float) -> float:
        inside, d = labels == part, self.graph.dim
        wide = width(self.graph, np.flatnonzero(inside))
        ratio = 1.9 * d * self.graph.measures[inside].sum() / (surface(self.graph, inside) * wide)
        return min(wide / self.size, 1) + 1.3 * min(ratio, 1.0) - penalty * max(wide / self.size - 1.0, 0.0)

    def run(self, ramps: Ramps, draws: float) -> np.ndarray:
        for heat, penalty, count in ramps.rounds(draws).T:
            for _ in range(int(count * self.graph.n)):
                self.step(heat, penalty)
        return self.labels

    def step(self, heat: float, penalty: float) -> None:
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
        before = sum(self.score(self.labels, part, penalty) for part in (p, q))
        if sum(self.score(moved, part, penalty) for part in (p, q)) >= before + loss:
            self.labels = moved


def whole(n: int, k: int) -> Shares:
    """All cells and parts in one share."""
    return Shares(np.arange(n, dtype=np.int32), np.array([0, n]), np.zeros(k, np.int32))


def first_seed(seed: int) -> int:
    """Where the random numbers of the first share begin."""
    return int(splitmix(np.array([seed], np.uint64))[0]) ^ 0x9E3779B97F4A7C15


@pytest.mark.parametrize("name", MESHES)
def test_the_kernel_moves_what_its_slow_twin_moves(name: str) -> None:
    tool, labels = started(name)
    size, ramps = 0.9 * width(tool.graph, np.flatnonzero(labels == 0)), Ramps(0.3, 0.01, 5.0, 40.0)
    for seed in (1, 2**63 + 5):
        after, _ = tool.annealed(labels, size, ramps, 20.5, seed, Weights())
        slow = SlowAnnealing(tool.graph, labels, size, first_seed(seed)).run(ramps, 20.5)
        np.testing.assert_array_equal(after, slow)
        assert (after != labels).any() or name == "tetrahedra"


@settings(max_examples=25)
@given(st.sampled_from(sorted(MESHES)), SEEDS, st.floats(0.01, 2.0), st.integers(1, 3000))
def test_the_sums_of_the_parts_stay_those_of_their_cells(name, seed, heat, moves) -> None:
    tool, labels = started(name)
    parts, work = part_state(tool.cells, labels, 5)
    rounds = Ramps(heat, 1e-3, 4.0, 40.0).rounds(moves / tool.graph.n)
    rest = (0.4, 1.0, 1.0, 3.8), rounds, np.uint64(seed), 0
    moved = anneal(tool.cells, parts, work, whole(tool.graph.n, 5), 0, 1, *rest)
    assert 0 <= moved <= moves
    linked = network(tool.graph)
    for p in range(5):
        inside = parts.labels == p
        cells = np.flatnonzero(inside)
        assert parts.tally[p, COUNT] == len(cells) > 0
        assert nx.is_connected(linked.subgraph(cells.tolist()))
        assert parts.tally[p, MEASURE] == pytest.approx(tool.graph.measures[inside].sum(), rel=1e-9)
        assert parts.tally[p, SURFACE] == pytest.approx(surface(tool.graph, inside), rel=1e-9)
        assert parts.tally[p, DIAMETER] == pytest.approx(width(tool.graph, cells), rel=1e-12)
        ends = tool.cells.points[parts.ends[p]]
        assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(parts.tally[p, DIAMETER], rel=1e-12)
        listed, i = [], parts.first[p]
        while i >= 0:
            listed.append(int(i))
            i = parts.after[i]
        assert sorted(listed) == cells.tolist()


@settings(max_examples=15)
@given(st.sampled_from(FLAT), SEEDS, st.integers(1, 2000))
def test_circles_follow_the_parts(name: str, seed: int, moves: int) -> None:
    tool, labels = started(name)
    parts, work = part_state(tool.cells, labels, 5)
    circles = circle_state(tool.cells, tool.edges, parts)
    rounds = Ramps(0.1, 1e-3, 4.0, 40.0).rounds(moves / tool.graph.n)
    rest = work, whole(tool.graph.n, 5), 0, 1, (0.4, 1.0, 1.0, 0.3), rounds, np.uint64(seed), 0
    anneal_circles(tool.cells, tool.edges, parts, circles, *rest)
    values = quality(MESHES[name], tool.outward(parts.labels), metrics=("CR", "CRc"))
    widths = parts.tally[:, DIAMETER]
    np.testing.assert_allclose(2 * circles.rings[:, CENTRED] / widths, values["CRc"], atol=1e-9)
    found = 2 * circles.rings[:, RADIUS] / widths
    assert (found <= values["CR"] + 1e-9).all()
    fresh = 2 * circle_state(tool.cells, tool.edges, parts).rings[:, RADIUS] / widths
    assert (fresh <= values["CR"] + 1e-9).all()
    assert (fresh >= 0.85 * values["CR"]).all()


@pytest.mark.parametrize("name", FLAT)
def test_the_edges_of_a_cell_are_its_outline(name: str) -> None:
    tool, graph = Annealing(MESHES[name].graph), Annealing(MESHES[name].graph).graph
    edges = tool.edges
    lengths = np.hypot(edges.lines[:, 2], edges.lines[:, 3])
    rows = np.repeat(np.arange(graph.n), np.diff(edges.offsets))
    np.testing.assert_allclose(np.bincount(rows, lengths), tool.cells.surfaces, rtol=1e-12)
    outer = edges.beside < 0
    np.testing.assert_allclose(np.bincount(rows[outer], lengths[outer], graph.n), graph.boundary, atol=1e-12)


def test_without_outlines_there_are_no_circles() -> None:
    triangle = Graph.from_arrays([0, 2, 4, 6], [1, 2, 0, 2, 0, 1], [[0.0, 0], [1, 0], [0, 1]])
    tool = Annealing(triangle)
    assert tool.edges is None
    after, shapes = tool.polished(frozen_int([0, 0, 1]), 1.0, Ramps(0.1, 0.01, 1, 1), 17, 3, Weights())
    assert len(np.unique(after)) == 2
    np.testing.assert_array_equal(shapes.ratios, shapes.central)


def test_shares_are_compact_and_never_the_same_and_hold_all_cells() -> None:
    mesh = samples.squares(120)
    tool = Annealing(mesh.graph)
    labels = tool.inward(frozen_int(np.arange(14400) // 120 // 4 * 30 + np.arange(14400) % 120 // 4))
    parts, seen = part_state(tool.cells, labels, 900)[0], []

    def make(room, shares, start, stop, rounds, seed, stamp):
        seen.append((shares, start, stop, stamp, rounds))

    take_turns(make, tool.graph, parts, [None], Ramps(1.0, 0.1).rounds(24.2), 3, TimeLimit())
    assert len(seen) == 12  # two rounds each
    sharings = []
    for shares, start, stop, _, rounds in seen:
        assert (start, stop) == (0, len(shares.starts) - 1) == (0, 9)
        assert np.array_equal(np.sort(shares.cells), np.arange(14400))
        for s in range(stop):
            own = shares.cells[shares.starts[s] : shares.starts[s + 1]]
            assert (shares.of_part[labels[own]] == s).all()
            assert 1200 < len(own) < 2000
        sharings.append(shares.of_part.tobytes())
        assert rounds[2].tolist() == pytest.approx([24.2 / 24] * 2)
    assert len(set(sharings)) == 12
    assert np.diff([stamp for *_, stamp, _ in seen]).min() >= 2 * 14400


def test_cells_in_the_middle_of_a_large_mesh_move_too() -> None:
    mesh = samples.squares(96)
    tool = Annealing(mesh.graph)
    labels = tool.inward(frozen_int(np.arange(9216) // 96 // 8 * 12 + np.arange(9216) % 96 // 8))
    after, _ = tool.annealed(labels, 1.0, Ramps(5.0, 1.0, 1e-9, 1e-9), 80.0, 1, Weights())
    assert (after != labels).mean() > 0.5
    assert min(((after != labels) & (labels == p)).sum() for p in range(144)) > 0


def test_labels_do_not_depend_on_the_number_of_threads() -> None:
    mesh = samples.voronoi(5000, seed=3)
    first, found = agglomerate(mesh, n_parts=320).levels[0], []
    for threads in (1, 2, 3):
        with using_threads(threads):
            tool = Annealing(mesh.graph)
            rest = 0.1, Ramps(0.1, 1e-3, 40.0, 400.0), 40.0, 7, Weights()
            labels = tool.annealed(tool.inward(first), *rest)[0]
            found.append((labels, tool.polished(labels, *rest)[0]))
    for each in found[1:]:
        np.testing.assert_array_equal(each, found[0])
    assert (tool.outward(found[0][0]) != first).mean() > 0.2
    assert (found[0][1] != found[0][0]).any()


def test_shapes_score_even_and_round_parts() -> None:
    shapes = Shapes(np.array([1.0, 0.5]), np.array([0.6, 0.8]), np.array([0.4, 0.6]))
    assert shapes.score(Weights(1.0, 1.0, 0.0)) == pytest.approx(0.75 + 0.7)
    assert shapes.score(Weights(0.0, 0.0, 2.0)) == pytest.approx(1.0)
    labels = frozen_int([0, 0, 1])
    assert too_wide(shapes, labels, 0.4).tolist() == [True, False]  # a single cell is as wide as it is
    assert too_wide(shapes, labels, 1.0).tolist() == [False, False]


def test_squares_see_their_own_ratio() -> None:
    tool = Annealing(samples.squares(4).graph)
    quarters = tool.inward(frozen_int(np.arange(16) // 8 * 2 + np.arange(16) % 4 // 2))
    exact, seen = tool.shapes(quarters), tool.seen(quarters)
    np.testing.assert_allclose(exact.ratios, 0.5**0.5, rtol=1e-3)
    np.testing.assert_allclose(exact.central, 0.5**0.5, rtol=1e-12)
    np.testing.assert_allclose(seen.ratios, 3.8 * 0.25 / (2 * 0.5**0.5), rtol=1e-12)
    np.testing.assert_allclose(exact.widths, 0.5**0.5, rtol=1e-12)


def test_vertices_of_cells_are_found_from_either_side() -> None:
    mesh: Mesh = MESHES["voronoi"]
    cells = Annealing(mesh.graph).cells
    for v in range(0, len(cells.points), 7):
        there = {i for i in range(mesh.n_cells) if v in cells.vertices[slice(*cells.offsets[i : i + 2])]}
        assert set(cells.meeting[slice(*cells.meeting_offsets[v : v + 2])].tolist()) == there
    for i in range(0, mesh.n_cells, 5):
        corners = cells.points[cells.vertices[slice(*cells.offsets[i : i + 2])]]
        assert cells.spans[i] == pytest.approx(squareform(pdist(corners)).max())
        assert cells.radii[i] == pytest.approx(np.linalg.norm(corners - cells.centroids[i], axis=1).max())
