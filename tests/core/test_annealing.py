"""Annealing: its kernels against slow, obvious twins, and what its parts are cut into and dissolved to."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist, squareform

from agglo_core import Graph, Mesh, agglomerate, quality, samples
from agglo_core.arrays import frozen_int
from agglo_core.components.annealed_parts import Annealing, Ramps, Shapes, Weights, too_wide
from agglo_core.components.part_changes import cut_in_two, dissolved
from agglo_core.kernels.anneal_circles import CENTRED, RADIUS, circle_state
from agglo_core.kernels.anneal_draws import EVERY, window
from agglo_core.kernels.anneal_setup import part_state
from agglo_core.kernels.anneal_state import COUNT, DIAMETER, MEASURE, SURFACE
from agglo_core.kernels.annealing import anneal
from agglo_core.kernels.circle_annealing import anneal_circles

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

    def run(self, ramps: Ramps, moves: int) -> np.ndarray:
        heat = penalty = np.nan
        for turn in range(moves):
            if turn % 128 == 0:
                done = turn / moves
                heat = ramps.hot ** (1 - done) * ramps.cold**done
                penalty = ramps.soft ** (1 - done) * ramps.stiff**done
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


@pytest.mark.parametrize("name", MESHES)
def test_the_kernel_moves_what_its_slow_twin_moves(name: str) -> None:
    tool, labels = started(name)
    size, ramps = 0.9 * width(tool.graph, np.flatnonzero(labels == 0)), Ramps(0.3, 0.01, 5.0, 40.0)
    for seed in (1, 2**63 + 5):
        after, _ = tool.annealed(labels, size, ramps, 700, seed, Weights())
        slow = SlowAnnealing(tool.graph, labels, size, seed).run(ramps, 700)
        np.testing.assert_array_equal(after, slow)
        assert (after != labels).any()


@settings(max_examples=25)
@given(st.sampled_from(sorted(MESHES)), SEEDS, st.floats(0.01, 2.0), st.integers(1, 3000))
def test_the_sums_of_the_parts_stay_those_of_their_cells(name, seed, heat, moves) -> None:
    tool, labels = started(name)
    parts, work = part_state(tool.cells, labels, 5)
    moved = anneal(tool.cells, parts, work, (0.4, 1.0, 1.0, 3.8), (heat, 1e-3, 4.0, 40.0), moves, seed)
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
    how, ramps = (0.4, 1.0, 1.0, 0.3), (0.1, 1e-3, 4.0, 40.0)
    anneal_circles(tool.cells, tool.edges, parts, circles, work, how, ramps, moves, seed)
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
    after, shapes = tool.polished(frozen_int([0, 0, 1]), 1.0, Ramps(0.1, 0.01, 1, 1), 50, 3, Weights())
    assert len(np.unique(after)) == 2
    np.testing.assert_array_equal(shapes.ratios, shapes.central)


@pytest.mark.parametrize("n", [1537, 3600, 20_011])
def test_on_large_meshes_windows_slide_over_all_cells_alike(n: int) -> None:
    drawn, moves = np.zeros(n, np.int64), 400_000
    sizes = set()
    for turn in range(0, moves, EVERY):
        first, count = (int(x) for x in window(turn, moves, n))
        drawn[(first + np.arange(count)) % n] += 1
        sizes.add(count)
    assert max(sizes) < 2 * 768
    assert drawn.min() > 0.5 * drawn.mean()
    assert [int(x) for x in window(5 * EVERY, moves, 1536)] == [0, 1536]


def test_cells_in_the_middle_of_a_large_mesh_move_too() -> None:
    mesh = samples.squares(60)
    tool = Annealing(mesh.graph)
    labels = tool.inward(frozen_int(np.arange(3600) // 60 // 4))  # strips
    ramps = Ramps(5.0, 1.0, 1e-9, 1e-9)
    moved = [tool.annealed(labels, 1.0, ramps, 200_000, seed, Weights())[0] != labels for seed in range(4)]
    assert np.any(moved, axis=0).mean() > 0.7


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


def test_parts_are_cut_across_their_principal_axis() -> None:
    graph = samples.strip(12).graph
    x = np.argsort(np.argsort(graph.centroids[:, 0]))
    labels = frozen_int(x // 6)
    cut = cut_in_two(graph, labels, np.array([True, False]))
    groups = {tuple(sorted(x[cut == p].tolist())) for p in range(cut.max() + 1)}
    assert groups == {(0, 1, 2), (3, 4, 5), (6, 7, 8, 9, 10, 11)}


def test_what_a_cut_leaves_in_pieces_becomes_several_parts() -> None:
    mesh = samples.squares(3)  # a U: its arms are beyond the cut, and apart
    x, y = (np.round(mesh.cell_centroids * 3 - 0.5)).astype(int).T
    labels = frozen_int((x == 1) & (y > 0))
    cut = cut_in_two(mesh.graph, labels, np.array([True, False]))
    assert (mesh.graph.components(cut) == mesh.graph.components(mesh.graph.components(cut))).all()
    assert len(np.unique(mesh.graph.components(cut))) == cut.max() + 1 >= 3


def test_cells_all_in_one_place_are_cut_in_halves() -> None:
    path = Graph.from_arrays([0, 1, 3, 5, 6], [1, 0, 2, 1, 3, 2], np.zeros((4, 2)))
    assert cut_in_two(path, frozen_int(np.zeros(4)), np.array([True])).tolist() == [0, 0, 1, 1]


def test_cells_of_a_dissolved_part_join_what_they_share_most_with() -> None:
    graph = samples.squares(4).graph  # columns, from below
    columns = frozen_int(np.arange(16) // 4)
    assert dissolved(graph, columns, 0).reshape(4, 4).tolist() == [[0] * 4, [0] * 4, [1] * 4, [2] * 4]
    block = columns.copy()
    block[4:12] = 1
    after = dissolved(graph, frozen_int(np.unique(block, return_inverse=True)[1]), 1)
    assert after.reshape(4, 4).tolist() == [[0] * 4, [0] * 4, [1] * 4, [1] * 4]
    assert dissolved(graph, frozen_int(np.zeros(16)), 0).tolist() == [0] * 16


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
