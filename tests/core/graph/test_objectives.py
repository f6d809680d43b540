"""Objectives of a partition: by hand, block by block, and what a move changes."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import Mesh, agglomerate, samples
from agglo_core.arrays import frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.functionals import cut, normalised_cut
from agglo_core.graph.moves import boundary_moves, links
from agglo_core.graph.objectives import OBJECTIVES, numbered_parts

INCREMENTAL = [name for name, each in OBJECTIVES.items() if each.changes is not None]


def scattered(graph: Graph, k: int, seed: int = 0) -> np.ndarray:
    labels = np.random.default_rng(seed).integers(k, size=graph.n)
    labels[:k] = np.arange(k)
    return frozen_int(labels)


def test_two_halves_of_a_row_of_squares() -> None:
    graph = samples.squares(4).graph
    rows = frozen_int(np.arange(16) // 8)
    values = {name: each.value(graph, rows) for name, each in OBJECTIVES.items()}
    assert values["interface"] == pytest.approx(1.0)
    assert values["cut"] == 4
    assert values["balance"] == pytest.approx(2 * 0.5**2)
    assert values["diameter"] == pytest.approx(1.25**0.5)
    # of the centroids of 4 x 2 cells: squares of 1/8, 3/8 along, 1/8 across, each times the cell's area
    assert values["compactness"] == pytest.approx(16 / 16 * ((1 + 9) / 2 / 64 + 1 / 64))
    assert values["normalised_cut"] == normalised_cut(graph, rows) == pytest.approx(2 * 4 / 24)
    assert OBJECTIVES["cut"](graph, rows) == cut(graph, rows)


def test_labels_may_start_anew_in_each_block() -> None:
    graph = samples.squares(4).graph
    level, order = graph.split(np.arange(16) // 8)
    local = np.arange(16)[order] % 2
    through = numbered_parts(level, local)
    assert sorted(set(through.tolist())) == [0, 1, 2, 3]
    assert (through[:8] < 2).all()
    for each in OBJECTIVES.values():
        assert each.value(level, local) == each.value(level, through)


@pytest.mark.parametrize("name", INCREMENTAL)
@pytest.mark.parametrize("mesh", [samples.voronoi(60, seed=1), samples.boxes(3)], ids=["2-D", "3-D"])
def test_changes_are_differences_of_values(name: str, mesh: Mesh) -> None:
    graph, objective = mesh.graph, OBJECTIVES[name]
    labels = scattered(graph, 5)
    cells, parts = boundary_moves(graph, labels)
    assert objective.changes is not None
    changes = objective.changes(graph, labels, cells, parts)
    before = objective.value(graph, labels)
    for cell, part, change in zip(cells, parts, changes, strict=True):
        moved = labels.copy()
        moved[cell] = part
        assert objective.value(graph, moved) - before == pytest.approx(change, abs=1e-12 * abs(before))


def test_boundary_moves_are_the_neighbouring_parts_of_each_cell_once() -> None:
    graph = samples.squares(3).graph
    cells, parts = boundary_moves(graph, frozen_int([0, 0, 0, 0, 1, 2, 3, 1, 2]))
    found = list(zip(cells.tolist(), parts.tolist(), strict=True))
    assert found == sorted({(1, 1), (2, 2), (3, 1), (3, 3), (4, 0), (4, 2), (5, 0), (5, 1)}
                           | {(6, 0), (6, 1), (7, 2), (7, 3), (8, 1)})  # fmt: skip
    shared = links(graph, frozen_int([0, 0, 0, 0, 1, 2, 3, 1, 2]), frozen_int([4]), frozen_int([0]))
    assert (shared.total[0], shared.own[0], shared.there[0]) == (4, 1, 2)


def test_a_partition_without_neighbours_has_no_moves() -> None:
    graph = samples.squares(2).graph
    cells, parts = boundary_moves(graph, frozen_int(np.zeros(4)))
    assert len(cells) == len(parts) == 0
    for name in INCREMENTAL:
        changes = OBJECTIVES[name].changes
        assert changes is not None
        assert changes(graph, frozen_int(np.zeros(4)), cells, parts).shape == (0,)


def test_a_hierarchy_has_objectives_of_every_level() -> None:
    mesh = samples.squares(8)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(16, 4))
    assert [OBJECTIVES["interface"].value(mesh.graph, each) for each in hierarchy.levels] == [6.0, 2.0]
