"""The k-way polish against a slow, obvious twin; what it never does; what it does to known partitions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
import networkx as nx
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from agglo_core import Graph, Mesh, OptionError, agglomerate, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.cli.arguments import agglomeration_options
from agglo_core.components.compactness import CompactnessRefiner, _directions
from agglo_core.graph.moves import SHORTNESS
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target

SEEDS = st.integers(0, 10**6)
FLOORS = st.sampled_from([0.0, 0.4711, 0.8813])


def shaken(graph: Graph, seed: int = 0) -> Graph:
    """The graph with its centroids moved a little: symmetry leaves ties that rounding decides."""
    noise = np.random.default_rng(seed).normal(scale=0.02, size=graph.centroids.shape)
    return replace(graph, centroids=frozen_float(graph.centroids + noise))


GRAPHS = [samples.voronoi(45, seed=3).graph, shaken(samples.tetrahedra(2).graph)]


class SlowPolish:
    """Everything is computed anew for each move of a cell."""

    def __init__(
        self, graph: Graph, labels: np.ndarray, block: np.ndarray, floor: float, limit: float
    ) -> None:
        self.graph, self.labels, self.block, self.limit = graph, labels.copy(), block, limit
        self.rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        self.network = nx.Graph(zip(self.rows.tolist(), graph.indices.tolist(), strict=True))
        self.floors = floor * np.bincount(labels, graph.measures)
        self.free = [self.extent(np.flatnonzero(labels == p)) > limit for p in range(len(block))]
        self.alone = np.bincount(labels) == 1
        self.axes = np.array([self.axis(b) for b in range(block.max() + 1)])

    def beside(self, i: int) -> np.ndarray:
        return self.graph.indices[self.graph.indptr[i] : self.graph.indptr[i + 1]]

    def axis(self, b: int) -> np.ndarray:
        cells = np.flatnonzero(self.block[self.labels] == b)
        weights, x = self.graph.weights[cells, None], self.graph.centroids[cells]
        x = x - (weights * x).sum(axis=0) / weights.sum()
        return (weights * (x**2).sum(axis=1)[:, None] * x).sum(axis=0)

    def inertia(self, labels: np.ndarray, b: int) -> float:
        values = OBJECTIVES["compactness"].of_parts(self.graph, frozen_int(labels))
        return float(values[self.block == b].sum())

    def interface(self, labels: np.ndarray, b: int) -> float:
        p, q = labels[self.rows], labels[self.graph.indices]
        return 0.5 * float(self.graph.interface[(p != q) & (self.block[p] == b) & (self.block[q] == b)].sum())

    def corners(self, cells: np.ndarray) -> np.ndarray:
        """Points of the vertices of some cells."""
        rows = [slice(*self.graph.vertex_offsets[i : i + 2]) for i in cells]
        return self.graph.points[np.concatenate([self.graph.vertices[row] for row in rows])]

    def extent(self, cells: np.ndarray) -> float:
        """Largest extent along one of the directions that the kernel looks along."""
        return float(np.ptp(self.corners(cells) @ _directions(self.graph.dim)[0].T, axis=0).max())

    def fits(self, i: int, target: int) -> bool:
        """No vertex of cell i is too far from the part's, unless that is known to be too wide."""
        if self.free[target]:
            return not self.alone[target]
        cells = np.flatnonzero(self.labels == target)
        if self.alone[target]:
            cells = np.append(cells, i)
        ends = self.corners(cells)[:, None] - self.corners(cells if self.alone[target] else [i])
        return bool(np.sqrt((ends**2).sum(axis=2)).max() <= self.limit)

    def best(self, i: int) -> int:
        home = self.labels[i]
        b, best, target = self.block[home], 0.0, -1
        inertia, interface = self.inertia(self.labels, b), self.interface(self.labels, b)
        for p in np.unique(self.labels[self.beside(i)]):
            if p == home or self.block[p] != b or (self.labels == home).sum() == 1:
                continue
            moved = self.labels.copy()
            moved[i] = p
            change = interface * (self.inertia(moved, b) - inertia)
            change += SHORTNESS * inertia * (self.interface(moved, b) - interface)
            if change < best - 1e-12 * interface * inertia:
                best, target = change, p
        return target

    def may_move(self, i: int, target: int) -> bool:
        home = self.labels[i]
        rest = set(np.flatnonzero(self.labels == home)) - {i}
        if not rest or self.graph.measures[list(rest)].sum() < self.floors[home]:
            return False
        beside = [int(j) for j in self.beside(i) if self.labels[j] == home]
        part = self.network.subgraph(rest)
        if any(not nx.has_path(part, beside[0], j) for j in beside):
            return False
        return self.fits(i, target)

    def run(self) -> np.ndarray:
        candidates = set(range(self.graph.n))
        for _ in range(12):
            paying = [i for i in sorted(candidates) if self.best(i) >= 0]
            key = {i: self.axes[self.block[self.labels[i]]] @ self.graph.centroids[i] for i in paying}
            candidates = set()
            for i in sorted(paying, key=key.__getitem__):
                target = self.best(i)
                if target >= 0 and self.may_move(i, target):
                    self.labels[i] = target
                    own = self.block[self.labels] == self.block[target]
                    candidates |= {i, *(int(j) for j in self.beside(i) if own[j])}
        return self.labels


def scattered(graph: Graph, k: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Labels of ``k`` parts around random cells, the left half of which are one block, and the blocks."""
    rng = np.random.default_rng(seed)
    x = graph.centroids
    chosen = rng.permutation(graph.n)[:k]
    labels = ((x[:, None] - x[chosen]) ** 2 * (0.2 + rng.random(x.shape[1]))).sum(axis=2).argmin(axis=1)
    block = (x[chosen, 0] > 0).astype(np.int64)
    return frozen_int(labels), frozen_int(np.unique(block, return_inverse=True)[1])


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(GRAPHS), st.integers(2, 7), SEEDS, FLOORS, st.booleans())
def test_the_kernel_does_what_its_twin_does(
    graph: Graph, k: int, seed: int, floor: float, sized: bool
) -> None:
    labels, block = scattered(graph, k, seed)
    limit = 0.95 * float(graph.part_diameters(labels).max()) if sized else np.inf
    target = Target(h_star=limit) if sized else Target(parts=k)
    found = CompactnessRefiner(floor).refine_parts(graph, labels, block, target)
    np.testing.assert_array_equal(found, SlowPolish(graph, labels, block, floor, limit).run())


def test_parts_of_several_blocks_are_polished_as_blocks_are() -> None:
    graph = samples.voronoi(400, seed=5).graph
    labels, block = scattered(graph, 30, seed=2)
    level, cells = graph.split(block[labels])
    local = np.empty(30, np.int64)
    for b in range(2):
        local[block == b] = np.arange((block == b).sum())
    alone = CompactnessRefiner().refine(
        level, frozen_int(local[labels][cells]), np.zeros(2, np.uint64), Target(parts=30)
    )
    together = CompactnessRefiner().refine_parts(graph, labels, block, Target(parts=30))
    np.testing.assert_array_equal(alone, local[together][cells])
    assert (together != labels).any()
    np.testing.assert_array_equal(block[together], block[labels])


@pytest.mark.parametrize("dim", [2, 3])
def test_some_direction_is_as_near_as_claimed(dim: int) -> None:
    directions, cosine = _directions(dim)
    any_way = np.random.default_rng(0).normal(size=(20_000, dim))
    any_way /= np.linalg.norm(any_way, axis=1)[:, None]
    nearest = np.abs(any_way @ directions.T).max(axis=1).min()
    assert cosine <= nearest < 1.02 * cosine


def test_random_parts_get_compact_and_their_interfaces_short() -> None:
    for mesh in (
        samples.voronoi(2000, seed=8),
        samples.random_triangles(1000, seed=8),
        samples.tetrahedra(6),
    ):
        graph = mesh.graph
        before = agglomerate(graph, cells_per_part=16, post_refiners=()).levels[0]
        after = agglomerate(graph, cells_per_part=16, post_refiners=("compactness",)).levels[0]
        ratio = {
            name: OBJECTIVES[name](graph, after) / OBJECTIVES[name](graph, before) for name in OBJECTIVES
        }
        assert ratio["compactness"] < 0.97
        assert ratio["interface"] < 1.02
        assert ratio["shape"] < 0.97
        assert graph.components(after).max() == after.max() == before.max()


def test_squares_stay_squares() -> None:
    graph = samples.squares(32).graph
    for parts in (16, 64, 256):
        labels = agglomerate(graph, n_parts=parts, post_refiners=()).levels[0]
        polished = agglomerate(graph, n_parts=parts, post_refiners=("compactness",)).levels[0]
        np.testing.assert_array_equal(polished, labels)


def test_cells_without_measure_or_weight_are_no_harm() -> None:
    plain = samples.voronoi(200, seed=1).graph
    some = np.arange(200) % 3 > 0
    for weights in (np.zeros(200), some.astype(float)):
        graph = Graph.from_arrays(
            plain.indptr,
            plain.indices,
            plain.centroids,
            interface=plain.interface,
            measures=weights,
            weights=weights,
        )
        labels = agglomerate(graph, n_parts=9, post_refiners=("compactness",)).levels[0]
        assert graph.components(labels).max() + 1 == 9


@pytest.mark.parametrize("floor", [-0.1, 1.5, "half", True])
def test_floor_is_a_share(floor: object) -> None:
    with pytest.raises(OptionError, match="floor must be a number in"):
        CompactnessRefiner(floor)  # type: ignore[arg-type]


def test_levels_are_polished_unless_told_otherwise(tmp_path: Path) -> None:
    mesh = samples.voronoi(300, seed=4)
    how = {"n_parts": (40, 10)}
    plain = agglomerate(mesh, **how, post_refiners=()).levels
    polished = agglomerate(mesh, **how).levels
    assert all((one != other).any() for one, other in zip(plain, polished, strict=True))
    file = tmp_path / "run.toml"
    file.write_text("polish = false\nn_parts = [40, 10]\n")
    for levels in (agglomerate(mesh, **how, polish=False).levels, agglomerate(mesh, config=file).levels):
        np.testing.assert_array_equal(levels, plain)
    np.testing.assert_array_equal(agglomerate(mesh, config=file, polish=True).levels, polished)
    with pytest.raises(OptionError, match="polish must be true or false, given 'no'"):
        agglomerate(mesh, polish="no")  # type: ignore[arg-type]


def test_the_command_line_may_leave_the_polish_out() -> None:
    given = []

    @click.command()
    @agglomeration_options(bisector="one")
    def command(agglomeration: dict[str, object]) -> None:
        given.append(agglomeration)

    for arguments in (["--no-polish"], ["--polish"], []):
        assert CliRunner().invoke(command, arguments).exit_code == 0
    assert given == [{"polish": False}, {"polish": True}, {}]


@pytest.mark.parametrize("make", [samples.voronoi, samples.random_triangles])
def test_no_polished_part_is_wider_than_its_size(make: Callable[..., Mesh]) -> None:
    mesh = make(600, seed=12)
    for merge in (False, True):
        hierarchy = agglomerate(mesh, h_factor=(2, 4), merge=merge)
        widest = [mesh.graph.part_diameters(level) for level in hierarchy.levels]
        single = [np.bincount(level) == 1 for level in hierarchy.levels]
        for factor, widths, alone in zip((2, 4), widest, single, strict=True):
            assert widths[~alone].max() <= factor * mesh.h * (1 + 1e-9)
