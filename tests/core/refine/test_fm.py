"""The refiner fm: chains of moves by Fiduccia and Mattheyses."""

from __future__ import annotations

from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from ragged_parts import grown

import agglo_core as agglo
from agglo_core import Graph, samples
from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import Target
from agglo_core.refine.fm import FMRefiner
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.refine.prefix_searches import search_all

NO_SEEDS = np.zeros(1, np.uint64)
KINDS = {
    "triangles": lambda seed: samples.random_triangles(60, seed=seed).graph,
    "voronoi": lambda seed: samples.voronoi(110, seed=seed).graph,
    "tetrahedra": lambda seed: samples.tetrahedra(3).graph,
}


def refined(graph: Graph, labels: Int, **options: Any) -> Int:
    parts = int(labels.max()) + 1
    return FMRefiner(**options).refine(graph, labels, NO_SEEDS, Target(parts=parts))


def gain(csr: Any, parts: list[int], sizes: list[float], i: int, bounds: Any) -> tuple[int, float]:
    """The best part for cell i, or −1, and the length that saves."""
    indptr, indices, lengths = csr
    least, most = bounds
    shared: dict[int, float] = {}
    for h in range(indptr[i], indptr[i + 1]):
        p = parts[indices[h]]
        shared[p] = shared.get(p, 0.0) + lengths[h]
    home = parts[i]
    able = {p: s for p, s in shared.items() if p != home and s > 0.0 and sizes[p] + 1 <= most[p]}
    if not able or sizes[home] - 1 < least[home]:
        return -1, 0.0
    best = max(able, key=lambda p: able[p])
    return best, able[best] - shared.get(home, 0.0)


def slow_search_all(
    graph: Graph, lengths: Float, labels: Int, least: Float, most: Float, rounds: int, patience: int
) -> Int:
    """What the kernel does, one block, cells of size 1; a part is connected by networkx."""
    csr, whole = (graph.indptr, graph.indices, lengths), agglo_network(graph)
    parts, due = labels.tolist(), set(range(graph.n))
    sizes = np.bincount(labels).astype(float).tolist()
    bounds = least, most
    for _ in range(rounds):
        found = False
        for seed in range(graph.n):
            if seed not in due:
                continue
            due.discard(seed)
            done = slow_search(csr, whole, parts, sizes, bounds, seed, patience)
            found |= bool(done)
            for i in done:
                due |= {i, *whole[i]}
        if not found:
            break
    return np.array(parts)


def slow_search(
    csr: Any, whole: nx.Graph, parts: list[int], sizes: list[float], bounds: Any, seed: int, patience: int
) -> list[int]:
    """The cells that one search has moved in the end."""
    known: dict[int, float] = {}
    target, value = gain(csr, parts, sizes, seed, bounds)
    if target >= 0:
        known[seed] = value
    done: list[tuple[int, int]] = []
    total = best = 0.0
    kept = 0
    while known and len(done) - kept < patience:
        i = max(known, key=lambda cell: known[cell])
        del known[i]
        target, value = gain(csr, parts, sizes, i, bounds)
        home = parts[i]
        if target < 0 or parts.count(home) < 2:
            continue
        if known and value < max(known.values()):
            known[i] = value
            continue
        rest = [j for j, p in enumerate(parts) if p == home and j != i]
        if not nx.is_connected(whole.subgraph(rest)):
            continue
        done.append((i, home))
        move(parts, sizes, i, target)
        total += value
        if total > best + 1e-12:
            best, kept = total, len(done)
        for j in csr[1][csr[0][i] : csr[0][i + 1]]:
            if int(j) not in [cell for cell, _ in done]:
                to, more = gain(csr, parts, sizes, int(j), bounds)
                if to >= 0:
                    known[int(j)] = more
    for i, home in reversed(done[kept:]):
        move(parts, sizes, i, home)
    return [i for i, _ in done[:kept]]


def move(parts: list[int], sizes: list[float], i: int, target: int) -> None:
    sizes[parts[i]] -= 1
    sizes[target] += 1
    parts[i] = target


def agglo_network(graph: Graph) -> nx.Graph:
    owner = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    network = nx.Graph()
    network.add_nodes_from(range(graph.n))
    network.add_edges_from(zip(owner.tolist(), graph.indices.tolist(), strict=True))
    return network


@pytest.mark.parametrize("kind", ["triangles", "voronoi"])
@pytest.mark.parametrize("seed", range(4))
def test_the_kernel_does_what_a_slow_search_does(kind: str, seed: int) -> None:
    graph = KINDS[kind](seed)
    labels = grown(graph, seed, 6)
    sizes = np.bincount(labels).astype(float)
    least, most = np.minimum(sizes, 12.0), np.maximum(sizes, 24.0)
    rng = np.random.default_rng(seed)  # no two chains of moves gain the same
    both = graph.interface * rng.uniform(0.9, 1.1, len(graph.interface))
    own = frozen_float(np.ones(graph.n)), frozen_int(labels), frozen_int(np.zeros(6))
    bounds = frozen_float(least), frozen_float(most)
    found = search_all(graph.indptr, graph.indices, frozen_float(both), *own, *bounds, 3, 7)
    np.testing.assert_array_equal(found, slow_search_all(graph, both, labels, least, most, 3, 7))


@given(st.sampled_from(sorted(KINDS)), st.integers(0, 10_000), st.sampled_from(("cells", "measure")))
@settings(max_examples=25, deadline=None)
def test_parts_stay_whole_balanced_and_are_cut_off_shorter(kind: str, seed: int, balance: str) -> None:
    graph = KINDS[kind](seed % 50)
    labels = grown(graph, seed, 6)
    after = refined(graph, labels, size=balance, tolerance=0.1)
    assert len(np.unique(graph.components(after))) == 6
    assert OBJECTIVES["interface"](graph, after) <= OBJECTIVES["interface"](graph, labels)
    each = np.ones(graph.n) if balance == "cells" else graph.measures
    before, now = np.bincount(labels, each), np.bincount(after, each)
    room = max(0.1 * before.mean(), each.mean()) * 1.0001
    assert (now <= np.maximum(before, before.mean() + room)).all()
    assert (now >= np.minimum(before, before.mean() - room) - 1e-12).all()


def test_a_chain_of_moves_gets_out_of_what_no_single_move_improves() -> None:
    graph = samples.squares(6).graph
    column = np.arange(36) // 6
    labels = (column >= 3).astype(np.int64)
    labels[18:21] = 0  # half of the fourth column
    labels[15:18] = 1  # for half of the third: a step in the interface, two cells high
    assert OBJECTIVES["cut"](graph, labels) == pytest.approx(8.0)
    np.testing.assert_array_equal(InterfaceRefiner().refine(graph, labels, NO_SEEDS, Target(parts=2)), labels)
    after = refined(graph, labels, objective="cut", tolerance=0.2)
    assert OBJECTIVES["cut"](graph, after) == pytest.approx(6.0)


def test_interfaces_of_metis_become_shorter_at_the_same_balance() -> None:
    import pymetis

    graph = samples.random_triangles(2500, seed=11).graph
    parts = graph.n // 16
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    found = np.array(pymetis.part_graph(parts, adjacency, recursive=True).vertex_part)
    fixed = agglo.plugins.default().build("fixer", "connectivity").fix(graph, found)
    after = refined(graph, fixed, tolerance=0.1)
    cells = [np.bincount(each, minlength=parts) for each in (fixed, after)]
    assert OBJECTIVES["interface"](graph, after) < 0.97 * OBJECTIVES["interface"](graph, found)
    assert cells[1].std() <= cells[0].std()
    assert cells[1].max() <= cells[0].max()
    assert len(np.unique(graph.components(after))) == parts


def test_it_polishes_a_run() -> None:
    graph = samples.voronoi(600, seed=2).graph
    plain = agglo.agglomerate(graph, n_parts=20, polish=False).levels[0]
    polished = agglo.agglomerate(graph, n_parts=20, post_refiners=("fm",)).levels[0]
    assert OBJECTIVES["interface"](graph, polished) < OBJECTIVES["interface"](graph, plain)
    assert polished.max() == 19


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"objective": "length"}, "objective must be one of interface, cut; given 'length'"),
        ({"size": "area"}, "size must be one of cells, measure, weights; given 'area'"),
        ({"tolerance": -0.1}, "tolerance must be a number, 0 or more, not -0.1"),
        ({"tolerance": float("nan")}, "tolerance must be a number, 0 or more, not nan"),
        ({"patience": 0}, "patience must be a whole number, 1 or more, not 0"),
        ({"rounds": True}, "rounds must be a whole number, 1 or more, not True"),
    ],
)
def test_options_are_checked(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        FMRefiner(**options)
