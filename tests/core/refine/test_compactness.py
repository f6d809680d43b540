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
from hypothesis import given, settings, strategies as st

from agglo_core import Graph, Mesh, OptionError, agglomerate, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.cli.options.agglomeration import agglomeration_options
from agglo_core.graph.moves import SHORTNESS
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.compactness import strips as part_strips
from agglo_core.refine.compactness.polish import _ROUNDS, directions
from agglo_core.refine.compactness.refiner import CompactnessRefiner
from agglo_core.refine.compactness.state import _FEW, _SHIFT, SWEEPS
from agglo_core.refine.compactness.strips import slices
from agglo_core.threads import using_threads

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
        change, measures = _SHIFT / np.bincount(labels), np.bincount(labels, graph.measures)
        self.floors, self.ceilings = np.maximum(floor, 1.0 - change) * measures, (1.0 + change) * measures
        self.axes = np.array([self.axis(b) for b in range(block.max() + 1)])

    def beside(self, i: int) -> np.ndarray:
        return self.graph.indices[self.graph.indptr[i] : self.graph.indptr[i + 1]]

    def centres(self) -> np.ndarray:
        weights = self.graph.weights[:, None] * (self.labels[:, None] == np.arange(len(self.block)))
        return weights.T @ self.graph.centroids / weights.sum(axis=0)[:, None]

    def axis(self, b: int) -> np.ndarray:
        """Third moment of the centres of the parts."""
        weights = np.bincount(self.labels, self.graph.weights)[self.block == b, None]
        x = self.centres()[self.block == b]
        x = x - (weights * x).sum(axis=0) / weights.sum()
        moment = (weights * (x**2).sum(axis=1)[:, None] * x).sum(axis=0)
        return moment if len(x) > 1 else 1 / (1 + np.sqrt(2) * np.arange(x.shape[1]))

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

    def fits(self, i: int, target: int) -> bool:
        """No vertex of cell i is too far from the part's or its own; nor are two of a single cell."""
        cells = np.flatnonzero(self.labels == target)
        ends = np.append(cells, i) if len(cells) == 1 else [i]
        apart = self.corners(np.append(cells, i))[:, None] - self.corners(ends)
        return bool(np.sqrt((apart**2).sum(axis=2)).max() <= self.limit)

    def best(self, i: int, slopes: np.ndarray, among: range) -> int:
        home = self.labels[i]
        b, best, target = self.block[home], 0.0, -1
        inertia, interface = slopes[b]
        before = self.inertia(self.labels, b), self.interface(self.labels, b)
        for p in np.unique(self.labels[self.beside(i)]):
            if p == home or self.rank[p] not in among or (self.labels == home).sum() == 1:
                continue
            moved = self.labels.copy()
            moved[i] = p
            change = interface * (self.inertia(moved, b) - before[0])
            change += self.alpha * inertia * (self.interface(moved, b) - before[1])
            if change < best - 1e-12 * interface * inertia:
                best, target = change, p
        return target

    def may_move(self, i: int, target: int) -> bool:
        home = self.labels[i]
        rest = set(np.flatnonzero(self.labels == home)) - {i}
        if not rest or self.graph.measures[list(rest)].sum() < self.floors[home]:
            return False
        if self.graph.measures[self.labels == target].sum() + self.graph.measures[i] > self.ceilings[target]:
            return False
        beside = [int(j) for j in self.beside(i) if self.labels[j] == home]
        part = self.network.subgraph(rest)
        if any(not nx.has_path(part, beside[0], j) for j in beside):
            return False
        return self.fits(i, target)

    def run(self) -> np.ndarray:
        place = (self.axes[self.block[self.labels]] * self.graph.centroids).sum(axis=1)
        order = np.lexsort(((self.axes[self.block] * self.centres()).sum(axis=1), self.block))
        self.rank = np.argsort(order)
        starts = frozen_int(np.searchsorted(self.block[order], np.arange(self.block.max() + 2)))
        entry, blocks = self.labels.copy(), range(len(starts) - 1)
        objective = self.objective(len(blocks))
        for r, factor in enumerate(_ROUNDS[self.graph.dim]):
            self.alpha = SHORTNESS * factor
            due, going = self.boundary_cells(), set(blocks)
            at_first = self.counted(due)
            for sweep in range(r * SWEEPS, (r + 1) * SWEEPS):
                going &= {b for b, count in enumerate(self.counted(due)) if count > _FEW * at_first[b]}
                if not due or not going:
                    break
                slopes = self.slopes(len(blocks))
                listed = [
                    sorted((i for i in due if self.labels[i] == p), key=place.__getitem__) for p in order
                ]
                due = set()
                for lo, hi, *_, b in slices(starts, sweep % 2, self.graph.dim):
                    pending = [i for own in listed[lo:hi] for i in own if b in going]
                    while pending:
                        due |= self.looked_at(pending.pop(0), pending, slopes, range(lo, hi), b)
                inertia, interface = slopes.T
                change = self.slopes(len(blocks)) - slopes
                gains = -change[:, 0] * interface - self.alpha * inertia * change[:, 1]
                going &= set(np.flatnonzero(gains > 5e-4 * inertia * interface))
        worse = self.objective(len(blocks)) > objective
        return np.where(worse[self.block[self.labels]], entry, self.labels)

    def boundary_cells(self) -> set[int]:
        """Cells adjacent to another part of their block."""
        p, q = self.labels[self.rows], self.labels[self.graph.indices]
        return set(self.rows[(p != q) & (self.block[p] == self.block[q])].tolist())

    def counted(self, cells: set[int]) -> np.ndarray:
        """Number of these cells in each block."""
        return np.bincount(self.block[self.labels[sorted(cells)]], minlength=self.block.max() + 1)

    def objective(self, blocks: int) -> np.ndarray:
        inertia, interface = self.slopes(blocks).T
        return inertia * interface**SHORTNESS

    def slopes(self, blocks: int) -> np.ndarray:
        """Inertia and interface of each block."""
        return np.array(
            [(self.inertia(self.labels, b), self.interface(self.labels, b)) for b in range(blocks)]
        )

    def looked_at(self, i: int, pending: list[int], slopes: np.ndarray, among: range, b: int) -> set[int]:
        """Move cell i if that pays; which cells are to be looked at in the next sweep."""
        beside = [int(j) for j in self.beside(i) if self.block[self.labels[j]] == b]
        beyond = any(self.rank[self.labels[j]] not in among for j in beside)
        target = self.best(i, slopes, among)
        if target < 0 or not self.may_move(i, target):
            return {i} if beyond else set()
        self.labels[i] = target
        return {j for j in beside if j not in pending} | ({i} if beyond else set())


def scattered(graph: Graph, k: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Labels of ``k`` parts around random cells, the left half of which are one block, and the blocks."""
    rng = np.random.default_rng(seed)
    x = graph.centroids
    chosen = rng.permutation(graph.n)[:k]
    labels = ((x[:, None] - x[chosen]) ** 2 * (0.2 + rng.random(x.shape[1]))).sum(axis=2).argmin(axis=1)
    block = (x[chosen, 0] > 0).astype(np.int64)
    return frozen_int(labels), frozen_int(np.unique(block, return_inverse=True)[1])


@settings(max_examples=14, deadline=None)
@given(st.sampled_from(GRAPHS), st.integers(2, 7), SEEDS, FLOORS, st.booleans(), st.sampled_from([8.0, 1.0]))
def test_the_kernels_do_what_their_twin_does(
    graph: Graph, k: int, seed: int, floor: float, sized: bool, width: float
) -> None:
    labels, block = scattered(graph, k, seed)
    limit = 0.95 * float(graph.part_diameters(labels).max()) if sized else np.inf
    target = Target(h_star=limit) if sized else Target(parts=k)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_strips, "_WIDTH", width)  # 1: blocks of few parts have several slices
        found = CompactnessRefiner(floor).refine_parts(graph, labels, block, target)
        np.testing.assert_array_equal(found, SlowPolish(graph, labels, block, floor, limit).run())


@pytest.mark.parametrize("target", [Target(parts=300), Target(h_star=0.1)])
def test_threads_make_no_difference(target: Target) -> None:
    graph = samples.voronoi(4800, seed=6).graph
    how = {"n_parts": 300} if target.h_star is None else {"h_star": target.h_star}
    labels = agglomerate(graph, **how, polish=False).levels[0]
    block = frozen_int(np.zeros(labels.max() + 1))
    found = []
    for threads in (1, 2, 5):
        with using_threads(threads):
            found.append(CompactnessRefiner().refine_parts(graph, labels, block, target))
    assert len(slices(frozen_int([0, len(block)]), 0, 2)) > 1
    assert (found[0] != labels).any()
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


@pytest.mark.parametrize("dim", [2, 3])
def test_slices_hold_every_part_once_and_end_elsewhere_in_the_next_sweep(dim: int) -> None:
    starts = frozen_int([0, 40, 41, 3000, 90_000])
    rows = [slices(starts, shift, dim) for shift in range(2)]
    for each in rows:
        held = np.concatenate([np.arange(lo, hi) for lo, hi in each[:, :2]])
        np.testing.assert_array_equal(held, np.arange(90_000))
        np.testing.assert_array_equal(each[:, 2:4], np.stack((starts[:-1], starts[1:]), axis=1)[each[:, 4]])
        assert (each[:, 0] >= each[:, 2]).all()
        assert (each[:, 1] <= each[:, 3]).all()
    assert set(rows[0][:, 1]) & set(rows[1][:, 1]) == set(starts[1:])
    assert len(rows[0]) > 4


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
    chosen, cosine = directions(dim)
    any_way = np.random.default_rng(0).normal(size=(20_000, dim))
    any_way /= np.linalg.norm(any_way, axis=1)[:, None]
    nearest = np.abs(any_way @ chosen.T).max(axis=1).min()
    assert cosine <= nearest < 1.02 * cosine


def test_random_parts_get_compact_and_their_interfaces_short() -> None:
    for mesh in (
        samples.voronoi(2000, seed=8),
        samples.random_triangles(1000, seed=8),
        samples.random_tetrahedra(1500, seed=8),
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


def test_levels_are_polished_by_default(tmp_path: Path) -> None:
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
