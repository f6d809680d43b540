"""A refiner that worsens the objective it names is refused in a run, and that costs next to nothing."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import PluginError, agglomerate, samples
from agglo_core.graph.objectives import OBJECTIVES

MESH = samples.squares(8)


class Scatters:
    """Swaps the labels of the first cell of each side."""

    def __init__(self, objective: str) -> None:
        self.objective = objective

    def refine(self, graph, labels, seeds, target):
        moved = labels.copy()
        for b in range(graph.n_blocks):
            cells = np.arange(*graph.offsets[b : b + 2])
            one, other = (cells[labels[cells] == part][0] for part in (0, 1))
            moved[one], moved[other] = 1, 0
        return moved


@pytest.mark.parametrize("objective", ["interface", "cut", "compactness", "diameter", "normalised_cut"])
@pytest.mark.parametrize("place", ["refiners", "post_refiners"])
def test_what_worsens_its_objective_is_refused(objective: str, place: str) -> None:
    others = {"refiners": (), "bisector": "inertial", "n_parts": 2}
    with pytest.raises(
        PluginError, match=rf"refiner Scatters worsened its own objective: {objective} increased"
    ):
        agglomerate(MESH, **others | {place: [Scatters(objective)]})


def test_an_objective_that_needs_a_mesh_is_not_checked() -> None:
    hierarchy = agglomerate(MESH, bisector="inertial", n_parts=2, refiners=[Scatters("UF")])
    assert hierarchy.parts == [2]


@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_difference_is_that_of_the_values(name: str) -> None:
    graph = samples.voronoi(60, seed=1).graph
    level = graph.split(np.arange(60) % 3)[0]
    rng = np.random.default_rng(0)
    objective = OBJECTIVES[name]
    for _ in range(20):
        before = np.concatenate([rng.permutation(20) % 4 for _ in range(3)])
        after = np.where(rng.random(60) < 0.3, np.roll(before, 1), before)
        expected = objective.value(level, after) - objective.value(level, before)
        assert objective.worse_by(level, before, after) == pytest.approx(max(expected, 0.0), abs=1e-9)
        assert objective.worse_by(level, before, before) == 0.0
