"""METIS: direct calls as the oracle, small blocks, weights, blocks of a level, errors."""

from __future__ import annotations

import ctypes
import random
from dataclasses import replace

import numpy as np
import pymetis
import pytest

import agglo_core as agglo
from agglo_core.graph import Graph
from agglo_core.protocols import Target
from agglo_metis import metis
from agglo_metis.metis import Metis

UNWEIGHTED = {"vertex_weights": False, "edge_weights": False}


def path(n, weights=None):
    """Path graph along x."""
    rows = [[j for j in (i - 1, i + 1) if 0 <= j < n] for i in range(n)]
    indptr = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
    return Graph.from_arrays(indptr, np.concatenate(rows), np.c_[np.arange(n), np.zeros(n)], weights=weights)


def level_of(mesh):
    """One half of the mesh as a block, the other cut into blocks of one to three cells."""
    half = agglo.agglomerate(mesh, bisector="inertial", n_parts=2).levels[0]
    small = agglo.agglomerate(mesh, bisector="inertial", cells_per_part=2).levels[0]
    labels = np.unique(np.where(half == 0, 0, 1 + small), return_inverse=True)[1]
    return mesh.graph.split(mesh.graph.components(labels))[0]


def seeds_for(level, root=0):
    return np.arange(root, root + level.n_blocks, dtype=np.uint64)


def test_bisection_is_the_library_s_own():
    graph = agglo.samples.random_triangles(60, seed=1).graph
    direct = pymetis.part_graph(
        2,
        pymetis.CSRAdjacency(graph.indptr, graph.indices.astype(np.int64)),
        recursive=True,
        options=pymetis.Options(seed=5, niter=10, ncuts=1),
    )
    sides = Metis(**UNWEIGHTED).bisect_level(graph, np.array([5], np.uint64))
    assert sides.tolist() == list(direct.vertex_part)


@pytest.mark.parametrize("algorithm", ["kway", "recursive"])
def test_partition_is_the_library_s_own(algorithm):
    graph = agglo.samples.squares(12).graph
    options = pymetis.Options(seed=3, niter=10, ncuts=2, ufactor=40)
    if algorithm == "kway":
        options.contig = 1
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices.astype(np.int64))
    direct = pymetis.part_graph(9, adjacency, recursive=algorithm == "recursive", options=options)
    component = Metis(algorithm, ufactor=40, ncuts=2, **UNWEIGHTED)
    assert component.partition(graph, Target(parts=9), 3).tolist() == list(direct.vertex_part)


@pytest.mark.parametrize("options", [{}, UNWEIGHTED])
@pytest.mark.parametrize("n", range(1, 9))
def test_small_paths_are_cut_once(n, options):
    graph = path(n)
    for seed in range(10):
        sides = Metis(**options).bisect_level(graph, np.array([seed], np.uint64))
        assert (np.diff(sides) != 0).sum() == min(n - 1, 1)
        if n > 1:
            assert abs(2 * sides.sum() - n) <= 1 + n % 2


@pytest.mark.parametrize("heavy", range(3))
def test_a_node_that_outweighs_the_rest_is_parted_from_it(heavy):
    weights = np.full(4, 1e-9)
    weights[heavy] = 1.0
    for seed in range(10):
        sides = Metis().bisect_level(path(4, weights), np.array([seed], np.uint64))
        assert set(sides.tolist()) == {0, 1}


def test_vertex_weights_balance_measure_and_edge_weights_avoid_long_interfaces():
    weights = np.array([1.0, 1, 1, 1, 1, 1, 3, 3])
    sides = Metis(edge_weights=False).bisect_level(path(8, weights), np.zeros(1, np.uint64))
    assert np.bincount(sides, weights).tolist() == [6, 6]
    graph = path(8)
    interface = np.where(
        np.minimum(graph.indices, np.repeat(np.arange(8), np.diff(graph.indptr))) == 4, 0.1, 9
    )
    weak = Graph.from_arrays(graph.indptr, graph.indices, graph.centroids, interface=interface)
    sides = Metis(ufactor=400).bisect_level(weak, np.zeros(1, np.uint64))
    assert sides[4] != sides[5]
    assert (np.diff(sides) != 0).sum() == 1


@pytest.mark.parametrize("sample", ["random_triangles:n=150,seed=2", "boxes:n=5"])
def test_a_level_is_its_blocks(sample):
    level = level_of(agglo.samples.from_spec(sample))
    assert np.diff(level.offsets).max() > 50
    assert np.diff(level.offsets).min() <= 2
    seeds = seeds_for(level, 7)
    together = Metis().bisect_level(level, seeds)
    apart = [Metis().bisect_level(level[b], seeds[b : b + 1]) for b in range(level.n_blocks)]
    assert np.array_equal(together, np.concatenate(apart))
    big = np.diff(level.offsets) > 1
    ones = np.add.reduceat(together, level.offsets[:-1])
    assert ((ones > 0) & (ones < np.diff(level.offsets)))[big].all()


def test_seeds_decide_and_nothing_else():
    graph = agglo.samples.voronoi(200, seed=0).graph
    states = np.random.get_state()[1].copy(), random.getstate()  # noqa: NPY002
    runs = [Metis().bisect_level(graph, np.array([2**63 + 5], np.uint64)) for _ in range(2)]
    parts = [Metis().partition(graph, Target(parts=12), 2**40) for _ in range(2)]
    assert np.array_equal(*runs)
    assert np.array_equal(*parts)
    assert np.array_equal(np.random.get_state()[1], states[0])  # noqa: NPY002
    assert random.getstate() == states[1]


def test_kway_parts_are_connected_by_default():
    graph = agglo.samples.random_triangles(400, seed=4).graph
    labels = Metis().partition(graph, Target(parts=50), 0)
    assert len(np.unique(graph.components(labels))) == len(np.unique(labels))


@pytest.mark.parametrize(("parts", "expected"), [(1, 1), (6, 6), (100, 6)])
def test_no_more_parts_than_nodes(parts, expected):
    labels = Metis().partition(path(6), Target(parts=parts), 0)
    assert np.unique(labels).tolist() == list(range(expected))


@pytest.mark.parametrize(
    "options",
    [
        {"algorithm": "multilevel"},
        {"ufactor": 0},
        {"niter": 1.5},
        {"ncuts": True},
        {"ufactor": -3},
        {"ufactor": 1001},
        {"ufactor": 201, "algorithm": "recursive"},
        {"niter": 10**4 + 1},
        {"ncuts": 2**40},
        {"contig": 1},
        {"edge_weights": "no"},
        {"vertex_weights": None},
    ],
)
def test_options_outside_their_range_are_refused(options):
    with pytest.raises(agglo.errors.OptionError, match=next(iter(options))):
        Metis(**options)


def test_a_size_target_is_refused():
    with pytest.raises(agglo.errors.OptionError, match="number of parts"):
        Metis().partition(path(4), Target(h_star=1.0), 0)


@pytest.mark.parametrize("method", ["recursive", "kway"])
@pytest.mark.parametrize("sample", ["squares:n=12", "boxes:n=5", "disconnected:n=5"])
def test_through_the_pipeline_counts_are_exact_and_parts_connected(method, sample):
    mesh = agglo.samples.from_spec(sample)
    labels = agglo.agglomerate(mesh, bisector="metis", n_parts=10, method=method).levels[0]
    assert np.unique(labels).tolist() == list(range(10))
    assert len(np.unique(mesh.graph.components(labels))) == 10


def printed(capfd):
    """Standard output and errors, with those that the C library of METIS still buffers."""
    ctypes.CDLL(None).fflush(None)
    return capfd.readouterr()


def test_what_metis_prints_is_seen_here(capfd, monkeypatch):
    monkeypatch.setitem(metis._MAX_UFACTOR, "kway", 10**6)
    Metis(ufactor=10**6).partition(agglo.samples.squares(10).graph, Target(parts=60), 0)
    assert "Cannot bisect a graph with 0 vertices" in printed(capfd).out


@pytest.mark.parametrize("algorithm", ["kway", "recursive"])
@pytest.mark.parametrize("parts", [40, 65, 98, 150, 195])
def test_nothing_is_printed_about_parts_that_a_node_fills_alone(algorithm, parts, capfd):
    graph = agglo.samples.squares(14).graph
    uneven = np.geomspace(1.0, 1e6, graph.n)
    for weights in (uneven, uneven[::-1], np.ones(graph.n)):
        weighted = replace(graph, weights=weights)
        labels = Metis(algorithm).partition(weighted, Target(parts=parts), 0)
        assert labels.min() >= 0
        assert labels.max() < parts
    assert printed(capfd) == ("", "")


@pytest.mark.parametrize("options", [{"ufactor": 1000}, {"algorithm": "recursive", "ufactor": 200}])
def test_nothing_is_printed_with_the_largest_imbalance(options, capfd):
    for n in (4, 9, 15):
        graph = agglo.samples.squares(n).graph
        for parts in {2, n, n * n // 2, n * n - 4}:
            for seed in range(3):
                labels = Metis(**options).partition(graph, Target(parts=parts), seed)
                assert labels.max() < parts
    assert printed(capfd) == ("", "")


def connected(graph, labels):
    return len(np.unique(graph.components(labels))) == labels.max() + 1


@pytest.mark.parametrize("effort", ["quick", "fast"])
@pytest.mark.parametrize("objective", ["solver", pytest.param("roundness", marks=pytest.mark.slow)])
def test_an_effort_searches_from_the_parts_of_metis(objective, effort):
    mesh = agglo.samples.voronoi(600, seed=8)
    score = agglo.graph.objectives.OBJECTIVES[objective].value
    options = {"effort": effort, "objective": objective}
    plain, annealed = (
        agglo.agglomerate(mesh, bisector=("metis", o), method="kway", n_parts=37, polish=False).levels[0]
        for o in ({}, options)
    )
    assert annealed.max() == 36
    assert connected(mesh.graph, annealed)
    assert score(mesh.graph, annealed) < 0.95 * score(mesh.graph, plain)


def test_an_effort_can_be_combined_with_sizes_and_balance():
    mesh = agglo.samples.random_triangles(200, seed=8)
    for objective in ("solver", "roundness"):
        options = {"effort": "fast", "objective": objective}
        labels = agglo.agglomerate(mesh, bisector=("metis", options), method="kway", h_star=0.3).levels[0]
        assert mesh.graph.part_diameters(labels).max() <= 0.3 * (1 + 1e-9)
        assert connected(mesh.graph, labels)
    even = {"effort": "fast", "balance": 0.0}
    cells = np.bincount(
        agglo.agglomerate(mesh, bisector=("metis", even), method="kway", n_parts=20).levels[0]
    )
    assert cells.max() - cells.min() <= 1


def test_parts_of_metis_compete_with_what_annealing_finds():
    mesh = agglo.samples.voronoi(500, seed=3)
    score = agglo.graph.objectives.OBJECTIVES["solver"].value
    seen = []

    class Noted(Metis):
        def _direct(self, graph, target, seed):
            seen.append(super()._direct(graph, target, seed))
            return seen[-1]

    labels = Noted(effort="fast", seconds=1e-9).partition(mesh.graph, Target(parts=25), 1)
    assert len(seen) == 1
    assert score(mesh.graph, labels) <= score(mesh.graph, seen[0]) * (1 + 1e-9)


@pytest.mark.parametrize(
    "options", [{"effort": "most"}, {"seconds": 1.0}, {"effort": "fast", "objective": "cut"}]
)
def test_bad_options_of_an_effort_are_refused(options):
    with pytest.raises(agglo.OptionError, match=r"metis: (effort|objective)"):
        Metis(**options)
