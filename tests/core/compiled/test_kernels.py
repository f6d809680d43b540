"""Compiled kernels against slow, obvious references; what is compiled, when, and where it is kept.

Moments, dual graphs, diameters and loops meet their oracles in the tests of Mesh and Graph, circles and
shapes in those of the metrics.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import shapely
from forked import run_in_fork
from hypothesis import assume, given, settings, strategies as st
from numba import njit
from numba.core.event import trigger_event
from scipy.spatial.distance import pdist

from agglo_core import Graph, Mesh, samples
from agglo_core.agglomeration.halves import broken_halves
from agglo_core.arrays import frozen_float, frozen_index, frozen_int, splitmix
from agglo_core.compiled import helper, kernel
from agglo_core.compiled.first_run import compilation_time
from agglo_core.compiled.geometry import block_diameters, compare_diameters
from agglo_core.compiled.graphs import broken_blocks, child_order, components, take_rows
from agglo_core.compiled.prefetching import prefetch
from agglo_core.mesh.geometry.loops import faces_of_cells
from agglo_core.mesh.kernels.face_sums import add_faces
from agglo_core.mesh.kernels.faces import match_half_edges
from agglo_core.mesh.kernels.polygon_faults import check_polygons
from agglo_core.refine.interface_kernels import relax_interface
from agglo_core.refine.repair import absorb
from agglo_kmeans.kernel import two_means

SEEDS = st.integers(0, 10**6)


def compact(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1]


# --- rounding -------------------------------------------------------------------------------------------


@helper(reorder_sums=True)
def reordered_sums(n: int, x: Any, shares: Any) -> tuple[float, float]:
    first, second = 0.0, 0.0
    for i in range(n):
        first += shares[i] * x[i]
        second += shares[i] * x[i] * x[i]
    return first, second


@kernel
def sums_of_all(n: int, x: Any, shares: Any) -> Any:
    return reordered_sums(n, x, shares)


@kernel
def sums_of_seventeen(x: Any, shares: Any) -> Any:
    # Inlined, these calls would be optimised for their constant length.
    shifted = 0.0
    for k in range(3):
        shifted += reordered_sums(17, x[k:], shares[k:])[0]
    return reordered_sums(17, x, shares), shifted


@kernel
def sums_by_another_kernel(n: int, x: Any, shares: Any) -> Any:
    return sums_of_all(n, x, shares), reordered_sums(n, x, shares)


def test_all_kernels_round_reordered_sums_alike() -> None:
    # Else two kernels would break the same tie differently.
    random = np.random.default_rng(5)
    for x, shares in random.random((500, 2, 20)):
        sums = sums_of_all(17, x, shares)
        assert sums_of_seventeen(x, shares)[0] == sums
        assert sums_by_another_kernel(17, x, shares) == (sums, sums)


# --- faces ----------------------------------------------------------------------------------------------


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=8, unique=True))
def test_a_loop_is_faulty_where_shapely_says_so(ring: list[tuple[int, int]]) -> None:
    """On a lattice, where vertices meet edges and edges overlap exactly."""
    points = frozen_float(ring)
    loop = frozen_int(np.arange(len(ring)))
    area, fault = check_polygons(points, frozen_int([0, len(ring)]), loop, False)
    polygon = shapely.Polygon(ring)
    assert (fault[0] == 0) == (polygon.is_valid and polygon.area > 0)
    assert area[0] == (polygon.area if polygon.exterior.is_ccw else -polygon.area) or not polygon.is_valid


@settings(max_examples=200, deadline=None)
@given(st.integers(4, 20), SEEDS, st.booleans())
def test_star_polygons_are_valid(n: int, seed: int, convex: bool) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.permutation(3 * n)[:n]) * (2 * np.pi / (3 * n))
    radius = np.ones(n) if convex else rng.uniform(0.2, 1, n)
    points = frozen_float(np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=1))
    area, fault = check_polygons(points, frozen_int([0, n]), frozen_int(np.arange(n)), False)
    assert fault.tolist() == [0 if shapely.Polygon(points).is_valid else 3]
    assert abs(area[0]) == pytest.approx(shapely.area(shapely.Polygon(points))) or fault[0]


def slow_match(cells: list[list[int]]) -> tuple[list, list, list, bool]:
    """Faces (vertices, cells) in order of first sight, doubles, and whether a third cell came."""
    faces: dict[frozenset[int], list[tuple[int, int, int]]] = defaultdict(list)
    for c, cell in enumerate(cells):
        for a, b in zip(cell, [*cell[1:], cell[0]], strict=True):
            faces[frozenset((a, b))].append((a, b, c))
    vertices, sides, doubles = [], [], []
    for walks in faces.values():
        if len(walks) > 2:
            return [], [], [], True
        (a, b, c), *others = walks
        partner = [e for x, y, e in others if (x, y) == (b, a)]
        if c in partner:
            continue  # a bridge
        vertices.append([a, b])
        sides.append([c, partner[0] if partner else -1])
        for x, y, e in others:
            if (x, y) == (a, b):
                doubles.append([c, e])
                vertices.append([x, y])
                sides.append([e, -1])
    return sorted(vertices), sorted(sides), sorted(doubles), False


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.permutations(range(7)).flatmap(lambda p: st.integers(3, 5).map(lambda k: p[:k])), max_size=4)
)
def test_half_edges_are_paired_as_a_dictionary_would(cells: list[list[int]]) -> None:
    offsets = frozen_int(np.cumsum([0, *map(len, cells)]))
    flat = frozen_int([v for cell in cells for v in cell])
    vertices, sides, doubles, fault = match_half_edges(offsets, flat, 7)
    wanted = slow_match(cells)
    assert (fault[0] >= 0) == wanted[3]
    if wanted[3]:
        a, b, *owners = fault
        assert len(set(owners)) == 3
        for c in owners:
            walked = {frozenset(e) for e in zip(cells[c], [*cells[c][1:], cells[c][0]], strict=True)}
            assert frozenset((a, b)) in walked
    else:
        assert (sorted(vertices.tolist()), sorted(sides.tolist()), sorted(doubles.tolist())) == wanted[:3]


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 6), st.integers(0, 12), SEEDS)
def test_faces_of_cells(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sides = rng.integers(0, n, (m, 2))
    sides[rng.random(m) < 0.4, 1] = -1
    offsets, faces = faces_of_cells(frozen_int(sides), n)
    for c in range(n):
        wanted = [f for f, pair in enumerate(sides.tolist()) for side in pair if side == c]
        assert faces[offsets[c] : offsets[c + 1]].tolist() == wanted


# --- graphs ---------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 30), st.integers(1, 8), SEEDS)
def test_sums_over_the_faces_of_cells(n_faces: int, n_cells: int, seed: int) -> None:
    """Against numpy, for faces between random points and cells; integers make the sums exact."""
    rng = np.random.default_rng(seed)
    points = frozen_float(rng.integers(-9, 10, (20, 2)))
    vertices = frozen_int(rng.integers(0, len(points), 2 * n_faces))
    cells = frozen_int(np.stack((rng.integers(0, n_cells, n_faces), rng.integers(-1, n_cells, n_faces)), 1))
    gap, area = np.zeros(n_cells, np.uint64), np.zeros((n_cells, 2))
    box = add_faces(points, vertices, cells, gap, area)
    ends = (points - points[vertices[0]])[vertices.reshape(-1, 2)]
    terms = ends[:, 0] * ends[:, 1, ::-1]
    number = splitmix(vertices.astype(np.uint64)).reshape(-1, 2)
    for c in range(n_cells):
        owned, other = cells[:, 0] == c, cells[:, 1] == c
        assert area[c, 0] == (terms[owned] @ [1, -1]).sum() - (terms[other] @ [1, -1]).sum()
        assert area[c, 1] == np.abs(terms[owned]).sum() + np.abs(terms[other]).sum()
        heads, tails = (np.append(number[owned, k], number[other, 1 - k]) for k in (1, 0))
        assert gap[c] == np.append(heads, ~tails + np.uint64(1)).sum()  # modulo 2^64
    assert box == (*ends.reshape(-1, 2).min(axis=0), *ends.reshape(-1, 2).max(axis=0))


@pytest.mark.parametrize("name", ["squares:5", "voronoi:60", "ring:12"])
def test_closed_cells_have_no_gap_and_twice_their_area(name: str) -> None:
    mesh = samples.from_spec(name)
    gap, area = np.zeros(mesh.n_cells, np.uint64), np.zeros((mesh.n_cells, 2))
    add_faces(mesh.points, mesh.face_vertices, mesh.face_cells, gap, area)
    assert not gap.any()
    assert area[:, 0] == pytest.approx(2 * mesh.cell_measures, rel=1e-12)
    torn = mesh.face_vertices.copy()
    torn[0] = torn[3]  # face 0 starts elsewhere
    gap[:] = 0
    add_faces(mesh.points, frozen_int(torn), mesh.face_cells, gap, area)
    assert np.flatnonzero(gap).tolist() == sorted(set(mesh.face_cells[0].tolist()) - {-1})


def random_graph(seed: int, n: int = 30) -> Graph:
    rng = np.random.default_rng(seed)
    matrix = np.triu(rng.random((n, n)) * (rng.random((n, n)) < 0.12), 1)
    matrix += matrix.T
    rows, columns = np.nonzero(matrix)
    indptr = np.concatenate(([0], np.cumsum(np.bincount(rows, minlength=n))))
    return Graph.from_arrays(
        indptr, columns, rng.random((n, 2)), interface=matrix[rows, columns], measures=rng.uniform(0.5, 2, n)
    )


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.integers(1, 30))
def test_permuted_rows(seed: int, kept: int) -> None:
    graph = random_graph(seed)
    rng = np.random.default_rng(seed)
    order, cut = rng.permutation(30)[:kept], int(rng.integers(0, kept + 1))
    part = graph.subgraph(order, [0, cut, kept])
    found = np.zeros((kept, kept))
    found[np.repeat(np.arange(kept), np.diff(part.indptr)), part.indices] = part.interface
    block = np.arange(kept) < cut
    dense = graph.to_scipy().toarray()[np.ix_(order, order)] * (block[:, None] == block)
    np.testing.assert_array_equal(found, dense)
    offsets, values = take_rows(graph.indptr, graph.indices, frozen_int(order))
    for row, node in enumerate(order):
        wanted = graph.indices[graph.indptr[node] : graph.indptr[node + 1]]
        np.testing.assert_array_equal(values[offsets[row] : offsets[row + 1]], wanted)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 5), max_size=6), SEEDS)
def test_children_keep_the_order_of_their_parent(sizes: list[int], seed: int) -> None:
    offsets = np.cumsum([0, *sizes])
    sides = np.random.default_rng(seed).integers(0, 2, offsets[-1])
    order, children = child_order(frozen_int(offsets), frozen_int(sides))
    blocks = np.repeat(np.arange(len(sizes)), sizes)
    np.testing.assert_array_equal(order, np.lexsort((np.arange(len(sides)), sides, blocks)))
    wanted = np.cumsum([0, *np.bincount(2 * blocks + sides, minlength=2 * len(sizes))])
    np.testing.assert_array_equal(children, wanted)


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_nodes_by_component(seed: int) -> None:
    graph = random_graph(seed)
    labels = np.random.default_rng(seed).integers(0, 2, 30)
    nodes, offsets = components(graph.indptr, graph.indices, frozen_int(labels))
    net = nx.from_scipy_sparse_array(graph.to_scipy())
    net.remove_edges_from([(i, j) for i, j in net.edges if labels[i] != labels[j]])
    wanted = sorted(map(sorted, nx.connected_components(net)))
    assert [sorted(nodes[i:j]) for i, j in pairwise(offsets)] == wanted
    blocks = graph.subgraph(np.arange(30), [0, 10, 30])
    found = broken_blocks(blocks.offsets, blocks.indptr, blocks.indices, frozen_int(labels))
    component = blocks.components(labels)
    pieces = [len(set(component[i:j])) - len(set(labels[i:j])) for i, j in pairwise(blocks.offsets)]
    assert found.tolist() == [spare > 0 for spare in pieces]
    component = graph.components(labels)
    assert [np.flatnonzero(component == c).tolist() for c in range(len(wanted))] == wanted


@settings(max_examples=50, deadline=None)
@given(SEEDS, st.booleans())
def test_halves_are_searched_along_the_cut(seed: int, scattered: bool) -> None:
    rng, graph = np.random.default_rng(seed), samples.voronoi(60, seed=seed % 10).graph
    labels = graph.components(graph.centroids[:, 0] > 0.5)
    blocks, _ = graph.split(labels)
    score = rng.random(60) if scattered else blocks.centroids @ rng.standard_normal(2)
    sides = frozen_int(score > np.median(score))
    found = broken_halves(blocks.offsets, blocks.indptr, blocks.indices, sides)
    wanted = broken_blocks(blocks.offsets, blocks.indptr, blocks.indices, sides)
    np.testing.assert_array_equal(found, wanted)


# --- diameters --------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.booleans(), st.lists(st.floats(1e-3, 3.0), min_size=1, max_size=4))
def test_compared_diameters(seed: int, solid: bool, limits: list[float]) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((60, 3 if solid else 2)) * rng.choice([1.0, 0.2], 3 if solid else 2)
    corners, cells = rng.integers(0, 60, 120), frozen_int(np.arange(40))
    offsets = frozen_int(np.unique(np.concatenate(([0, 40], rng.integers(1, 40, 12)))))
    mesh = frozen_int(np.arange(0, 121, 3)), frozen_index(corners), frozen_float(points)
    exact = block_diameters(offsets, cells, *mesh)
    wanted = [
        max(
            np.linalg.norm(points[p] - points[q])
            for p in corners[3 * i : 3 * j]
            for q in corners[3 * i : 3 * j]
        )
        for i, j in pairwise(offsets)
    ]
    assert exact == pytest.approx(wanted)
    sharp = [*limits, float(exact[0])]  # one block lies on a limit
    found = compare_diameters(offsets, cells, *mesh, frozen_float(np.sort(sharp)))
    for limit in sharp:
        assert ((found <= limit) == (exact <= limit)).all()
    finite = np.isfinite(found)
    assert (found[finite] <= exact[finite] * (1 + 1e-12)).all()
    assert found[finite] == pytest.approx(exact[finite], rel=0.5 if solid else 0.08)


@pytest.mark.parametrize("shape", ["regular", "odd", "random", "noisy", "sphere"])
def test_diameters_of_round_cells(shape: str) -> None:
    rng = np.random.default_rng(5)
    n = 301 if shape == "odd" else 300
    angle = 2 * np.pi * (rng.random(n) if shape == "random" else np.arange(n) / n)
    points = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    if shape == "sphere":
        points = rng.standard_normal((n, 3))
        points /= np.linalg.norm(points, axis=1)[:, None]
    if shape == "noisy":
        points *= 1 + 0.02 * rng.standard_normal((n, 1))
    one = frozen_int(np.array([0, 1]))
    cell = frozen_int(np.array([0, n])), frozen_index(rng.permutation(n)), frozen_float(points)
    assert block_diameters(one, frozen_int(np.zeros(1)), *cell)[0] == pytest.approx(pdist(points).max())


# --- connectivity repair ----------------------------------------------------------------------------------


def slow_absorb(graph: Graph, kept: np.ndarray, loose: list[list[int]]) -> np.ndarray:
    parts, waiting = kept.copy(), list(loose)
    while waiting:
        choices = []
        for nodes in waiting:
            shared: dict[int, float] = defaultdict(float)
            for i in nodes:
                for h in range(graph.indptr[i], graph.indptr[i + 1]):
                    if parts[graph.indices[h]] >= 0:
                        shared[parts[graph.indices[h]]] += graph.interface[h]
            choices.append(max(shared, key=lambda p: shared[p]) if shared else -1)
        if max(choices) < 0:
            break
        for nodes, choice in zip(waiting, choices, strict=True):
            parts[nodes] = choice
        waiting = [nodes for nodes, choice in zip(waiting, choices, strict=True) if choice < 0]
    return parts


@settings(max_examples=80, deadline=None)
@given(SEEDS, st.integers(1, 4))
def test_loose_components_join_the_neighbour_they_touch_most(seed: int, n_parts: int) -> None:
    graph = random_graph(seed)
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, n_parts, 30)
    nodes, offsets = components(graph.indptr, graph.indices, frozen_int(labels))
    component = graph.components(labels)
    loose = np.flatnonzero(rng.random(len(offsets) - 1) < 0.6)
    kept = np.where(np.isin(component, loose), -1, labels)
    keeper, places = np.arange(n_parts), frozen_float(rng.random((n_parts, 1)))
    found = absorb(
        graph.indptr, graph.indices, graph.interface, frozen_int(kept), frozen_int(nodes),
        frozen_int(offsets), frozen_int(loose), frozen_int(keeper), places,
    )  # fmt: skip
    np.testing.assert_array_equal(
        found, slow_absorb(graph, kept, [np.flatnonzero(component == c) for c in loose])
    )


# --- interface relaxation ---------------------------------------------------------------------------------


class SlowRelaxation:
    """The sweeps of one block, with dictionaries and networkx."""

    def __init__(self, block: Graph, labels: np.ndarray, floor: float) -> None:
        self.net = nx.from_scipy_sparse_array(block.to_scipy())
        self.parts, self.measures = labels.copy(), block.measures
        present = np.unique(labels)
        measure = {p: block.measures[labels == p].sum() for p in present}
        small = min(measure, key=lambda p: measure[p])
        middle = {p: np.average(block.centroids[labels == p], axis=0, weights=block.measures[labels == p])
                  for p in present}  # fmt: skip
        axis = middle[small] - np.average(block.centroids, axis=0, weights=block.measures)
        self.keys = block.centroids @ axis
        two = labels.max() == 1
        self.floors = {p: floor * (measure[small] if two else measure[p]) for p in present}

    def shares(self, i: int) -> dict[int, float]:
        shares: dict[int, float] = defaultdict(float)
        for j, edge in self.net[i].items():
            shares[self.parts[j]] += edge["weight"]
        return shares

    def best_move(self, i: int, pairs: bool) -> tuple[int, int] | None:
        """Part to move to and the partner to take along (−1: none)."""
        shares = self.shares(i)
        own = shares.pop(self.parts[i], 0.0)
        if not shares:
            return None
        target = max(shares, key=lambda p: shares[p])
        least = 1e-9 * (own + sum(shares.values()))
        if shares[target] - own > least:
            return target, -1
        best = None
        for j, edge in self.net[i].items() if pairs else ():
            if self.parts[j] == self.parts[i]:
                theirs = self.shares(j)
                gain = shares[target] - own + 2 * edge["weight"] + theirs[target] - theirs[self.parts[i]]
                if gain > least:
                    least, best = gain, (target, j)
        return best

    def leave(self, i: int, target: int) -> bool:
        rest = [j for j in np.flatnonzero(self.parts == self.parts[i]) if j != i]
        if not rest or self.measures[rest].sum() < self.floors[self.parts[i]] * (1 - 1e-12):
            return False
        reached = {j for j in self.net[i] if self.parts[j] == self.parts[i]}
        if sum(bool(reached & c) for c in nx.connected_components(self.net.subgraph(rest))) > 1:
            return False
        self.parts[i] = target
        return True

    def run(self) -> np.ndarray:
        ever = {i for i in self.net if self.shares(i).keys() - {self.parts[i]}}
        candidates, pairs, paired = set(ever), False, False
        for _ in range(10):
            movers = [i for i in candidates if self.best_move(i, pairs)]
            candidates = set()
            for i in sorted(movers, key=lambda i: self.keys[i]):
                move, own = self.best_move(i, pairs), self.parts[i]
                if not move or not self.leave(i, move[0]):
                    continue
                if move[1] >= 0 and not self.leave(move[1], move[0]):
                    self.parts[i] = own
                    continue
                for node in move[1:] if move[1] >= 0 else ():
                    candidates |= set(self.net[node])
                candidates |= set(self.net[i])
                ever |= candidates
            if pairs:
                pairs = False
            elif not candidates and not paired:
                pairs, paired, candidates = True, True, set(ever)
            if not candidates:
                break
        return self.parts


@settings(max_examples=60, deadline=None)
@given(st.integers(8, 60), st.integers(2, 4), SEEDS, st.sampled_from([0.0, 0.5, 0.85]), st.booleans())
def test_interfaces_are_relaxed_as_the_slow_sweeps_do(
    n: int, parts: int, seed: int, floor: float, ragged: bool
) -> None:
    graph = samples.voronoi(n, seed=seed % 50).graph
    rng = np.random.default_rng(seed)
    near = np.argmin(
        ((graph.centroids[:, None] - rng.uniform(-0.5, 0.5, (parts, 2))) ** 2).sum(axis=2), axis=1
    )
    astray = rng.random(n) < (0.3 if ragged else 0.0)
    labels = compact(np.where(astray, rng.integers(0, parts, n), near))
    blocks = compact(graph.components(compact(graph.centroids[:, 0] > 0.1)))
    level, order = graph.split(blocks)
    given_labels = frozen_int(labels[order])
    found = relax_interface(
        level.offsets, level.indptr, level.indices, level.interface, level.centroids, level.measures,
        given_labels, floor,
    )  # fmt: skip
    for b in range(level.n_blocks):
        nodes = slice(level.offsets[b], level.offsets[b + 1])
        wanted = SlowRelaxation(level[b], given_labels[nodes], floor).run()
        np.testing.assert_array_equal(found[nodes], wanted)


@pytest.mark.parametrize("seed", range(6))
def test_a_cell_of_many_neighbours_is_relaxed_as_any(seed: int) -> None:
    n, rng = 24, np.random.default_rng(seed)
    spokes = np.stack((np.cos(np.arange(n) * 2 * np.pi / n), np.sin(np.arange(n) * 2 * np.pi / n)), axis=1)
    points = np.concatenate((spokes * rng.uniform(0.9, 1.1, (n, 1)), 2 * spokes, 3 * spokes))
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    rings = [np.stack((k + i, k + n + i, k + n + j, k + j), axis=1) for k in (0, n)]
    graph = Mesh.from_polygons(points, [range(n), *np.concatenate(rings)]).graph
    labels = compact(np.concatenate(([0], np.tile(i // rng.integers(2, 9), 2))))
    csr = graph.indptr, graph.indices, graph.interface
    shapes = graph.centroids, graph.measures, frozen_int(labels)
    found = relax_interface(graph.offsets, *csr, *shapes, 0.5)
    np.testing.assert_array_equal(found, SlowRelaxation(graph, labels, 0.5).run())
    assert (found != labels).any()


# --- 2-means ------------------------------------------------------------------------------------------------


def axes_to_try(x: np.ndarray, weights: np.ndarray) -> list[np.ndarray]:
    """The principal axis, or eight where none stands out; in space three principal and four diagonal ones."""
    moments, frame = np.linalg.eigh(x.T @ (weights[:, None] * x))
    if x.shape[1] == 3:
        one, two, three = frame.T[::-1]
        diagonals = [one + a * two + b * three for a in (1, -1) for b in (1, -1)]
        return [one, two, three, *diagonals]
    if moments[0] <= 0.8 * moments[1]:
        return [frame[:, 1]]
    z = x[:, 0] + 1j * x[:, 1]
    angle = np.angle((weights * z**4).sum()) / 4
    return [np.array([np.cos(a), np.sin(a)]) for a in angle + np.arange(8) * np.pi / 8]


def lloyd(x: np.ndarray, weights: np.ndarray, sides: np.ndarray, steps: int) -> tuple[float, np.ndarray]:
    """Energy of the last sides that were tried, and the sides that follow from them."""
    energy = np.inf
    for _ in range(steps):
        if sides.min() == sides.max():
            return np.inf, sides
        means = [np.average(x[sides == s], axis=0, weights=weights[sides == s]) for s in (0, 1)]
        distance = np.array([((x - mean) ** 2).sum(axis=1) for mean in means])
        energy = (weights * np.where(sides, distance[1], distance[0])).sum()
        before, sides = sides, (distance[1] < distance[0]).astype(int)
        if (sides == before).all():
            break
    return energy, sides


def slow_two_means(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Two of Lloyd's steps from each axis; the one of least energy goes on."""
    x = points - np.average(points, axis=0, weights=weights)
    size = np.sqrt((weights @ x**2).sum() / weights.sum())
    tried = [lloyd(x, weights, (x @ a > 1e-7 * size).astype(int), 2) for a in axes_to_try(x, weights)]
    energy = min(each[0] for each in tried)
    rivals = [each for each in tried if each[0] > energy * (1 - 1e-6) and each[0] < energy * (1 + 1e-4)]
    assume(len({tuple(each[1] ^ each[1][0]) for each in rivals}) == 1)  # a draw: either will do
    return lloyd(x, weights, rivals[0][1], 100)[1]


@settings(max_examples=80, deadline=None)
@given(st.lists(st.integers(2, 40), min_size=1, max_size=4), SEEDS, st.floats(0.2, 1.0), st.integers(2, 3))
def test_two_means_of_every_block(sizes: list[int], seed: int, flatness: float, dim: int) -> None:
    rng = np.random.default_rng(seed)
    offsets = np.cumsum([0, *sizes])
    points = rng.random((offsets[-1], dim)) * [1, *[flatness] * (dim - 1)] + 3
    weights = rng.uniform(0.5, 2, offsets[-1])
    found = two_means(frozen_int(offsets), frozen_float(points), frozen_float(weights))
    for i, j in pairwise(offsets):
        wanted = slow_two_means(points[i:j], weights[i:j])
        assert min((found[i:j] != wanted).sum(), (found[i:j] == wanted).sum()) == 0


# --- compilation --------------------------------------------------------------------------------------------

TYPICAL_RUN = """
import sys
import agglo_core as agglo

def run(mesh):
    for options in ({"h_factor": (2, 4)}, {"n_parts": (4, 2)}, {"n_parts": 4, "method": "kway"}):
        hierarchy = agglo.agglomerate(mesh, bisector="kmeans", **options)
    coarse = hierarchy.mesh(0)
    coarse.graph, coarse.h, mesh.graph.part_diameters(hierarchy.levels[0])
    mesh.graph.coarsen(hierarchy.levels[0]).diameters()
    if mesh.dim == 2:
        agglo.quality(mesh, hierarchy.levels[0], metrics=("UF", "CR", "CRc"))
        coarse.boundary_loops
    return hierarchy

def kernels():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith("agglo_")]
    found = {id(k): k for m in modules for k in vars(m).values() if hasattr(k, "py_func")}
    return [k for k in found.values() if not k.py_func.__name__.startswith("_")]
"""
CHECK = """
for mesh in (agglo.samples.voronoi(60, seed=1), agglo.samples.squares(8), agglo.samples.disconnected(4)):
    run(mesh)
used = {k.py_func.__name__: len(k.signatures) for k in kernels() if k.signatures}
assert len(used) >= 14, used
assert set(used.values()) == {1}, used
"""


def test_every_kernel_has_one_signature_in_the_plane() -> None:
    subprocess.run([sys.executable, "-c", TYPICAL_RUN + CHECK], check=True)


DOUBLED = """
from agglo_core.authoring import kernel

@kernel
def doubled(x):
    return 2 * x
"""
WATCHED = """
from doubles import doubled
from agglo_core.compiled.first_run import watch_compilation

told = []
with watch_compilation(lambda: told.append("told")):
    found = [doubled(3), doubled(4)]
print(*found, *told)
"""


def test_compilation_is_announced_once_and_not_for_a_kernel_on_disk(tmp_path: Path) -> None:
    (tmp_path / "doubles.py").write_text(DOUBLED)
    for folder, printed in (("one", "6 8 told\n"), ("one", "6 8\n"), ("other", "6 8 told\n")):
        assert run_in_fork(WATCHED, tmp_path, tmp_path / folder) == (printed, "")


def test_time_of_compilation_includes_nested_ones_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(100))
    monkeypatch.setattr("time.process_time", lambda: float(next(clock)))
    with compilation_time() as spent:
        for _ in range(2):
            with trigger_event("numba:compiler_lock"):  # of numba
                with trigger_event("numba:compiler_lock"):
                    time.process_time()
                time.process_time()
    assert spent.cpu_seconds == 6.0
    with trigger_event("numba:compiler_lock"):
        assert spent.cpu_seconds == 6.0


UNWRITABLE = """
import logging
from numba.core import caching

def refuse(self):
    raise PermissionError("read-only file system")

caching._CacheLocator.ensure_cache_path = refuse
logging.basicConfig(format="%(levelname)s %(name)s %(message)s", force=True)
"""


def test_without_a_writable_folder_there_is_one_warning_and_it_works(tmp_path: Path) -> None:
    (tmp_path / "doubles.py").write_text(DOUBLED)
    out, err = run_in_fork(UNWRITABLE + WATCHED, tmp_path)
    assert out == "6 8 told\n"
    assert err.count("\n") == 1
    assert err.startswith("WARNING agglo no folder for compiled kernels is writable")


def test_prefetch_is_one_instruction() -> None:
    @njit
    def prefetch_row(array: np.ndarray, row: int) -> None:
        prefetch(array, row)

    prefetch_row(np.zeros((3, 2)), 1)
    (code,) = prefetch_row.inspect_llvm().values()
    assert "call void @llvm.prefetch" in code
