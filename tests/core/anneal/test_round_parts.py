"""Round parts: the option effort of kmeans, and the refiner anneal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from toy_constraints import Regions

from agglo_core import Graph, OptionError, agglomerate, quality, samples
from agglo_core.anneal.refiner import AnnealRefiner
from agglo_core.arrays import frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.compactness.refiner import CompactnessRefiner
from agglo_kmeans.kmeans import KMeans

SEEDS = st.integers(0, 10**6)
H = 2**0.5 / 4
MESHES = {
    "triangles": samples.random_triangles(60, seed=1),
    "voronoi": samples.voronoi(120, seed=2),
    "apart": samples.disconnected(6),
    "ring": samples.ring(30),
    "tetrahedra": samples.tetrahedra(2),
}


def kway(mesh, effort: str = "fast", **options):
    return agglomerate(
        mesh, bisector=("kmeans", {"effort": effort, "objective": "roundness"}), method="kway", **options
    )


def connected(graph: Graph, labels: np.ndarray) -> bool:
    return len(np.unique(graph.components(frozen_int(labels)))) == labels.max() + 1


def score(mesh, labels: np.ndarray) -> float:
    return sum(float(values.mean()) for values in quality(mesh, labels, metrics=("UF", "CR")).values())


# --- the option effort --------------------------------------------------------------------------------


@pytest.mark.parametrize("effort", ["quick", "fast", "good"])
@pytest.mark.parametrize("kind", ["squares", "triangles"])
def test_structured_grids_get_the_sixteen_squares_of_the_recursion(kind: str, effort: str) -> None:
    mesh = samples.paper(kind)
    labels = kway(mesh, effort, h_star=H, seed=3).levels[0]
    values = quality(mesh, labels, metrics=("UF", "CR"))
    assert labels.max() + 1 == 16
    np.testing.assert_allclose(values["UF"], 1.0)
    np.testing.assert_allclose(values["CR"], 0.5**0.5, rtol=1e-6)


def test_a_cube_of_cubes_becomes_sixty_four_cubes() -> None:
    mesh = samples.boxes(8)
    labels = kway(mesh, h_star=3**0.5 / 4).levels[0]
    assert np.bincount(labels).tolist() == [8] * 64
    np.testing.assert_allclose(mesh.graph.part_diameters(labels), 3**0.5 / 4)


@pytest.mark.parametrize(
    "make", [samples.voronoi, lambda n, seed: samples.random_triangles(n // 2, seed=seed)]
)
def test_parts_are_rounder_and_more_even_than_those_of_bisections(make) -> None:
    mesh = make(256, seed=21)
    fast, good = (kway(mesh, effort, h_star=H, seed=21).levels[0] for effort in ("fast", "good"))
    halved = agglomerate(mesh, h_star=H).levels[0]
    means = agglomerate(mesh, method="kway", h_star=H).levels[0]
    assert score(mesh, good) > score(mesh, fast) - 0.05
    assert score(mesh, fast) > score(mesh, halved) + 0.02
    assert score(mesh, fast) > score(mesh, means) + 0.01
    assert fast.max() < halved.max()


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), st.floats(0.15, 1.2), SEEDS)
def test_sizes_are_met_by_connected_parts(name: str, h_star: float, seed: int) -> None:
    mesh = MESHES[name]
    labels = kway(mesh, h_star=h_star, seed=seed).levels[0]
    widths, cells = mesh.graph.part_diameters(labels), np.bincount(labels)
    assert connected(mesh.graph, labels)
    assert ((widths <= h_star * (1 + 1e-9)) | (cells == 1)).all()
    np.testing.assert_array_equal(labels, kway(mesh, h_star=h_star, seed=seed).levels[0])


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), st.integers(1, 40), SEEDS)
def test_counts_are_met_by_connected_parts(name: str, parts: int, seed: int) -> None:
    mesh = MESHES[name]
    count = max(parts, 2)  # one of the meshes has two components
    labels = kway(mesh, n_parts=count, seed=seed).levels[0]
    assert labels.max() + 1 == count
    assert connected(mesh.graph, labels)


def test_other_seeds_find_other_parts() -> None:
    mesh = MESHES["voronoi"]
    found = {tuple(kway(mesh, h_star=H, seed=seed).levels[0].tolist()) for seed in range(4)}
    assert len(found) == 4


def test_many_cells_in_a_part_are_found_on_a_graph_of_pieces() -> None:
    mesh = samples.voronoi(3000, seed=7)
    labels = kway(mesh, h_star=0.5, seed=1).levels[0]
    halved = agglomerate(mesh, h_star=0.5).levels[0]
    assert mesh.graph.part_diameters(labels).max() <= 0.5 * (1 + 1e-9)
    assert connected(mesh.graph, labels)
    assert score(mesh, labels) > score(mesh, halved) - 0.03
    counted = kway(mesh, n_parts=9, seed=1).levels[0]
    assert counted.max() + 1 == 9
    assert connected(mesh.graph, counted)


def test_cells_wider_than_the_size_stay_alone() -> None:
    mesh = samples.random_triangles(60, seed=1)
    cells = mesh.graph.part_diameters(np.arange(mesh.n_cells))
    h_star = float(np.quantile(cells, 0.9))
    result = kway(mesh, h_star=h_star)
    widths, counts = mesh.graph.part_diameters(result.levels[0]), np.bincount(result.levels[0])
    alone = widths > h_star * (1 + 1e-9)
    assert (counts[alone] == 1).all()
    assert alone.sum() == (cells > h_star * (1 + 1e-9)).sum() == result.statistics["oversized_cells"]


def test_a_component_that_fits_is_one_part_and_large_ones_are_not_forgotten() -> None:
    mesh = samples.disconnected(6)
    assert kway(mesh, h_star=1.5).parts == [2]
    assert kway(mesh, h_star=1.3).parts[0] > 2


def test_levels_nest_and_constraints_hold() -> None:
    mesh = MESHES["voronoi"]
    result = kway(mesh, h_star=(0.3, 0.5, 0.9), seed=2)
    for level, h_star in enumerate((0.3, 0.5, 0.9)):
        assert mesh.graph.part_diameters(result.levels[level]).max() <= h_star * (1 + 1e-9)
    for level in range(2):
        np.testing.assert_array_equal(result.parents(level)[result.levels[level]], result.levels[level + 1])
    regions = (mesh.cell_centroids[:, 0] > 0.4).astype(int)
    labels = kway(mesh, h_star=H, constraints=[Regions(regions)]).levels[0]
    assert all(len(np.unique(regions[labels == p])) == 1 for p in range(labels.max() + 1))


@pytest.mark.parametrize("measures", [np.zeros(12), np.ones(12)])
def test_graphs_without_geometry_are_served(measures: np.ndarray) -> None:
    rows = [[j for j in (i - 1, i + 1) if 0 <= j < 12] for i in range(12)]
    indptr = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
    places = np.stack((np.arange(12.0), np.zeros(12)), axis=1)
    path = Graph.from_arrays(indptr, np.concatenate(rows), places, measures=measures)
    assert path.part_diameters(kway(path, h_star=2.0).levels[0]).max() <= 2.0
    assert kway(path, n_parts=5).parts == [5]
    one_place = Graph.from_arrays(indptr, np.concatenate(rows), np.zeros((12, 2)), measures=measures)
    annealed = KMeans(effort="fast", objective="roundness")
    for target, parts in ((Target(parts=5), 5), (Target(h_star=1.0), 1)):
        assert len(np.unique(annealed.partition(one_place, target, 0))) == parts


@pytest.mark.parametrize("effort", ["", "most", True, 1, ["quick"]])
def test_other_efforts_are_refused(effort: object) -> None:
    with pytest.raises(OptionError, match="kmeans: effort must be quick, fast, good or best, given"):
        KMeans(effort=effort)


def test_without_effort_and_in_recursions_nothing_changes() -> None:
    mesh = MESHES["voronoi"]
    plain, annealed = (KMeans(effort=effort) for effort in (None, "fast"))
    labels = [agglomerate(mesh, bisector=each, h_star=H).levels[0] for each in (plain, annealed)]
    np.testing.assert_array_equal(*labels)
    target = Target(parts=12)
    assert (plain.partition(mesh.graph, target, 1) == plain.partition(mesh.graph, target, 2)).all()


@pytest.mark.parametrize("effort", ["quick", "fast"])
def test_the_command_line_takes_the_effort(agglo, effort: str) -> None:
    done = agglo("run", "voronoi:100,seed=2", "--bisector", f"kmeans:effort={effort},objective=roundness",
                 "--method", "kway", "--h-star", "0.4", "--json")  # fmt: skip
    assert done.code == 0, done.err
    assert agglo("run", "voronoi:100", "--bisector", "kmeans:effort=most", "--method", "kway").code != 0


class Final:
    """Quarters of a mesh of squares, not to be touched; notes what it is asked."""

    final_parts = True

    def __init__(self) -> None:
        self.requests: list[Target] = []

    def partition(self, graph, target, seed):
        self.requests.append(target)
        return (graph.centroids[:, 0] > 0) * 2 + (graph.centroids[:, 1] > 0)


class Never:
    """A refiner nobody should call."""

    objective = "interface"

    def refine(self, graph, labels, seeds, target):
        raise AssertionError("called")


def test_final_parts_are_neither_refined_nor_polished_and_learn_the_size() -> None:
    mesh, final = samples.squares(8), Final()
    result = agglomerate(
        mesh, bisector=final, method="kway", h_star=0.75, refiners=[Never()], post_refiners=[Never()]
    )
    assert result.parts == [4]
    assert [each.h_star for each in final.requests] == [0.75]
    assert agglomerate(mesh, bisector=final, method="kway", n_parts=4).parts == [4]
    assert final.requests[-1] == Target(parts=4)


# --- the objective and the refiner --------------------------------------------------------------------


def test_roundness_of_squares_by_hand() -> None:
    graph = samples.squares(4).graph
    quarters = frozen_int(np.arange(16) // 8 * 2 + np.arange(16) % 4 // 2)
    ratio = 3.8 * 0.25 / (2.0 * 0.5**0.5)
    assert OBJECTIVES["roundness"].value(graph, quarters) == pytest.approx(4 * (1 - ratio))
    uneven = np.where(quarters == 3, 2, quarters)  # a half, and two quarters
    half = 3.8 * 0.5 / (3.0 * 1.25**0.5)
    narrow = 1 - 0.5**0.5 / 1.25**0.5
    expected = 2 * (1 - ratio + narrow) + 1 - half
    assert OBJECTIVES["roundness"].value(graph, uneven) == pytest.approx(expected)


def test_a_dent_is_filled() -> None:
    graph = samples.squares(4).graph  # 4 x 4 cells in columns, from below
    dented = frozen_int([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1])
    after = AnnealRefiner(objective="roundness").refine(
        graph, dented, np.zeros(1, np.uint64), Target(parts=2)
    )
    assert OBJECTIVES["interface"].value(graph, after) == 1.0
    assert np.bincount(after).tolist() == [8, 8]


@settings(max_examples=20)
@given(st.sampled_from(sorted(MESHES)), st.integers(2, 12), SEEDS, st.booleans())
def test_the_refiner_keeps_parts_connection_and_size_and_never_worsens(name, parts, seed, sized) -> None:
    graph = MESHES[name].graph
    labels = agglomerate(graph, n_parts=parts, polish=False).levels[0]
    level, order = graph.split(graph.components())
    given_labels = frozen_int(labels[order])
    widest = graph.part_diameters(labels).max()
    target = Target(h_star=1.1 * widest) if sized else Target(parts=parts)
    seeds = np.arange(level.n_blocks, dtype=np.uint64) + np.uint64(seed)
    after = AnnealRefiner(100, "roundness").refine(level, given_labels, seeds, target)
    assert set(after.tolist()) == set(labels.tolist())
    moved = np.empty(graph.n, np.int64)
    moved[order] = after
    assert connected(graph, moved)
    objective = OBJECTIVES["roundness"]
    assert objective.value(level, after) <= objective.value(level, given_labels) + 1e-12
    if sized:
        assert graph.part_diameters(moved).max() <= 1.1 * widest * (1 + 1e-9)
    np.testing.assert_array_equal(
        after, AnnealRefiner(100, "roundness").refine(level, given_labels, seeds, target)
    )


def test_the_refiner_betters_the_polish_and_follows_the_seed() -> None:
    mesh = samples.voronoi(256, seed=4)
    results = [
        agglomerate(mesh, n_parts=20, post_refiners=[("anneal", {"objective": "roundness"})], seed=s).levels[
            0
        ]
        for s in (1, 2)
    ]
    assert (results[0] != results[1]).any()
    plain = agglomerate(mesh, n_parts=20).levels[0]
    for labels in results:
        value = OBJECTIVES["roundness"].value
        assert value(mesh.graph, labels) < value(mesh.graph, plain)
    assert type(CompactnessRefiner()) is not AnnealRefiner


def test_weights_say_what_is_pursued() -> None:
    mesh = samples.voronoi(256, seed=5)
    labels = agglomerate(mesh, n_parts=20, polish=False).levels[0]

    def after(**options: float) -> np.ndarray:
        return AnnealRefiner(objective="roundness", **options).refine(
            mesh.graph, labels, np.ones(1, np.uint64), Target(parts=20)
        )

    even, discs = (
        quality(mesh, after(**o), metrics=("UF", "CR")) for o in ({"roundness": 0.2}, {"evenness": 0.2})
    )
    assert even["UF"].mean() > discs["UF"].mean()
    assert even["CR"].mean() < discs["CR"].mean()


@pytest.mark.parametrize(
    "options",
    [{"moves": 0}, {"moves": 1.5}, {"moves": True}, {"roundness": -1.0}, {"evenness": np.nan},
     {"evenness": "1"}, {"roundness": np.inf}, {"roundness": 0.0, "evenness": 0.0}],
)  # fmt: skip
def test_bad_options_of_the_refiner_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=r"moves|roundness|evenness"):
        AnnealRefiner(objective="roundness", **options)
