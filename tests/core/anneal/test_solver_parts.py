"""Parts for solvers: the objective, what efforts find, balance, the refiner."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core import Graph, OptionError, agglomerate, samples
from agglo_core.anneal.refiner import AnnealRefiner
from agglo_core.arrays import frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_kmeans.kmeans import KMeans

SEEDS = st.integers(0, 2**63 - 1)
EFFORTS = st.sampled_from(["quick", "fast"])
MESHES = {
    "triangles": samples.random_triangles(60, seed=1),
    "voronoi": samples.voronoi(120, seed=2),
    "apart": samples.disconnected(6),
    "ring": samples.ring(30),
    "tetrahedra": samples.tetrahedra(2),
}
value = OBJECTIVES["solver"].value


def kway(mesh, effort: str = "fast", **options):
    return agglomerate(mesh, bisector=("kmeans", {"effort": effort}), method="kway", **options)


def connected(graph: Graph, labels: np.ndarray) -> bool:
    return len(np.unique(graph.components(frozen_int(labels)))) == labels.max() + 1


# --- the objective ------------------------------------------------------------------------------------


def test_the_objective_of_squares_by_hand() -> None:
    graph = samples.squares(4).graph
    quarters = frozen_int(np.arange(16) // 8 * 2 + np.arange(16) % 4 // 2)
    inertia = 16 * (1 / 16) * 2 * (1 / 8) ** 2  # of the centres of cells
    hexagons = 4 * (5 / (18 * 3**0.5)) * (1 / 4) ** 2
    length = 4 * (2 * 3**0.5 / 4) ** 0.5  # half the outlines, which are 2 √(2 √3 area) each
    assert value(graph, quarters) == pytest.approx(inertia / hexagons + 0.2 * 2 / length)


def test_hexagons_of_many_cells_have_inertia_one() -> None:
    cells = samples.squares(400).graph
    x, y = cells.centroids.T - cells.centroids.mean(axis=0)[:, None]
    inside = (np.abs(x) < 3**0.5 / 4 * 0.9) & (np.abs(x) / 3**0.5 + np.abs(y) < 0.45)
    hexagon = cells.subgraph(frozen_int(np.flatnonzero(inside)), frozen_int([0, inside.sum()]))
    assert value(hexagon, np.zeros(hexagon.n)) == pytest.approx(1.0, rel=2e-3)


def test_units_do_not_matter_and_blocks_add_up() -> None:
    mesh = MESHES["voronoi"]
    labels = agglomerate(mesh, n_parts=9).levels[0]
    large = Graph.from_arrays(
        mesh.graph.indptr, mesh.graph.indices, 7 * mesh.graph.centroids,
        measures=49 * mesh.graph.measures, interface=7 * mesh.graph.interface,
    )  # fmt: skip
    assert value(large, labels) == pytest.approx(value(mesh.graph, labels))
    level, order = mesh.graph.split(frozen_int(labels > 4))
    assert value(level, labels[order]) == pytest.approx(
        sum(
            value(level[b], np.unique(labels[order][level.block_ids == b], return_inverse=True)[1])
            for b in (0, 1)
        )
    )


# --- the option effort --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make", [samples.voronoi, lambda n, seed: samples.random_triangles(n // 2, seed=seed)]
)
def test_parts_are_better_for_solvers_than_those_of_other_ways(make) -> None:
    for seed in (31, 32):
        mesh = make(600, seed=seed)
        fast, good = (
            value(mesh.graph, kway(mesh, e, n_parts=37, seed=seed).levels[0]) for e in ("fast", "good")
        )
        others = [agglomerate(mesh, method=m, n_parts=37).levels[0] for m in ("kway", "recursive")]
        least = min(value(mesh.graph, each) for each in others)
        assert good < fast + 0.005
        assert fast < least - 0.01


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), EFFORTS, st.integers(2, 40), SEEDS)
def test_counts_are_met_by_connected_parts_no_worse_than_bisections(name, effort, parts, seed) -> None:
    mesh = MESHES[name]
    labels = kway(mesh, effort, n_parts=parts, seed=seed).levels[0]
    assert labels.max() + 1 == parts
    assert connected(mesh.graph, labels)
    np.testing.assert_array_equal(labels, kway(mesh, effort, n_parts=parts, seed=seed).levels[0])
    if name != "apart":  # which shares its parts out among its components
        halved = agglomerate(mesh, n_parts=parts).levels[0]
        assert value(mesh.graph, labels) <= value(mesh.graph, halved) * (1 + 1e-9)


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), EFFORTS, st.floats(0.15, 1.2), SEEDS)
def test_sizes_are_met_by_connected_parts(name: str, effort: str, h_star: float, seed: int) -> None:
    mesh = MESHES[name]
    labels = kway(mesh, effort, h_star=h_star, seed=seed).levels[0]
    widths, cells = mesh.graph.part_diameters(labels), np.bincount(labels)
    assert connected(mesh.graph, labels)
    assert ((widths <= h_star * (1 + 1e-9)) | (cells == 1)).all()


def test_the_squares_of_the_paper_stay() -> None:
    labels = kway(samples.paper("squares"), "good", h_star=2**0.5 / 4).levels[0]
    assert np.bincount(labels).tolist() == [16] * 16
    np.testing.assert_allclose(samples.paper("squares").graph.part_diameters(labels), 2**0.5 / 4)


def test_graphs_without_geometry_are_served() -> None:
    rows = [[j for j in (i - 1, i + 1) if 0 <= j < 12] for i in range(12)]
    indptr = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
    for measures in (np.zeros(12), np.ones(12)):
        path = Graph.from_arrays(indptr, np.concatenate(rows), np.zeros((12, 2)), measures=measures)
        labels = KMeans(effort="fast").partition(path, Target(parts=5), 0)
        assert len(np.unique(labels)) == 5
        assert np.isfinite(value(path, np.arange(12) // 4))


# --- balance ------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.sampled_from(["triangles", "voronoi", "ring"]), st.integers(2, 20), SEEDS)
def test_numbers_of_cells_are_even_to_one(name: str, parts: int, seed: int) -> None:
    mesh = MESHES[name]
    options = {"effort": "fast", "balance": 0}
    labels = agglomerate(mesh, bisector=("kmeans", options), method="kway", n_parts=parts, seed=seed).levels[
        0
    ]
    cells = np.bincount(labels)
    assert len(cells) == parts
    assert cells.max() - cells.min() <= 1
    assert connected(mesh.graph, labels)


@pytest.mark.parametrize("size", ["cells", "measure", "weights"])
def test_sizes_are_within_the_tolerance_and_parts_better_than_those_balanced_afterwards(size: str) -> None:
    for seed in (1, 2):
        mesh = samples.voronoi(1000, seed=seed)
        options = {"effort": "good", "balance": 0.05, "size": size}
        labels = agglomerate(mesh, bisector=("kmeans", options), method="kway", n_parts=20).levels[0]
        sizes = np.bincount(labels, mesh.graph.node_sizes(size))
        assert np.abs(sizes / sizes.mean() - 1).max() <= 0.05
        plain = agglomerate(
            mesh,
            method="kway",
            n_parts=20,
            post_refiners=["compactness", ("balance", {"size": size, "tolerance": 0.05})],
        )
        assert value(mesh.graph, labels) < value(mesh.graph, plain.levels[0]) - 0.02


@pytest.mark.parametrize("bisector", ["kmeans", "metis"])
@pytest.mark.parametrize("size", ["weights", None])
def test_annealed_parts_balance_the_weights_given_to_the_run(bisector: str, size: str | None) -> None:
    mesh = samples.voronoi(600, seed=1)
    weights = np.random.default_rng(0).lognormal(0.0, 1.0, mesh.n_cells)
    options = {"effort": "fast", "balance": 0.05, "size": size}
    labels = agglomerate(
        mesh, bisector=(bisector, options), method="kway", n_parts=8, weights=weights
    ).levels[0]
    sizes = np.bincount(labels, weights)
    assert np.abs(sizes / sizes.mean() - 1).max() <= 0.05


def test_coarse_levels_balance_numbers_of_cells_of_the_mesh() -> None:
    mesh = samples.voronoi(600, seed=1)
    hierarchy = agglomerate(mesh, method="kway", n_parts=(50, 5), post_refiners=("balance",))
    cells = np.bincount(hierarchy.levels[1])
    assert cells.tolist() == [120] * 5


def test_balance_needs_an_effort_for_solvers_and_a_count() -> None:
    fast: dict[str, object] = {"effort": "fast"}
    for more in (
        {"objective": "roundness", "balance": 0.1},
        {"balance": -1.0},
        {"balance": 0.1, "size": "edges"},
    ):
        with pytest.raises(OptionError, match=r"balance|size"):
            KMeans(**fast, **more)
    with pytest.raises(OptionError, match="require an effort"):
        KMeans(balance=0.1)
    with pytest.raises(OptionError, match="balance applies to a number of parts"):
        agglomerate(
            MESHES["voronoi"],
            bisector=("kmeans", {"effort": "fast", "balance": 0.1}),
            method="kway",
            h_star=0.5,
        )


@pytest.mark.parametrize("objective", ["", "round", True, None])
def test_other_objectives_are_refused(objective: object) -> None:
    with pytest.raises(OptionError, match="objective"):
        KMeans(effort="fast", objective=objective)
    with pytest.raises(OptionError, match="objective"):
        AnnealRefiner(objective=objective)


# --- the refiner --------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), st.integers(2, 12), SEEDS, st.booleans())
def test_the_refiner_keeps_parts_connection_and_size_and_never_worsens(name, parts, seed, sized) -> None:
    graph = MESHES[name].graph
    labels = agglomerate(graph, n_parts=parts, polish=False).levels[0]
    level, order = graph.split(graph.components())
    widest = graph.part_diameters(labels).max()
    target = Target(h_star=1.1 * widest) if sized else Target(parts=parts)
    seeds = np.arange(level.n_blocks, dtype=np.uint64) + np.uint64(seed)
    before = frozen_int(labels[order])
    after = AnnealRefiner(moves=100).refine(level, before, seeds, target)
    assert set(after.tolist()) == set(labels.tolist())
    moved = np.empty(graph.n, np.int64)
    moved[order] = after
    assert connected(graph, moved)
    assert value(level, after) <= value(level, before) + 1e-12
    if sized:
        assert graph.part_diameters(moved).max() <= 1.1 * widest * (1 + 1e-9)


def test_the_refiner_betters_the_polish() -> None:
    mesh = samples.voronoi(400, seed=4)
    plain, annealed = (
        agglomerate(mesh, n_parts=25, post_refiners=[r]).levels[0] for r in ("compactness", "anneal")
    )
    assert value(mesh.graph, annealed) < value(mesh.graph, plain) - 0.02
