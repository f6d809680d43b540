"""Moves that spoil a part are undone, whatever a post-refiner moved."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from agglo_core import agglomerate, samples
from agglo_core.agglomeration.levels.polishing import _without_bad_moves


def test_a_part_emptied_by_undoing_another_move_gets_its_cells_back() -> None:
    """Part 1 moved along by a cell; as part 2 becomes too wide the cell that part 1 took goes back."""
    strip = samples.strip(8).graph
    before = np.array([0, 1, 2, 2, 2, 3, 3, 3])
    after = np.array([0, 0, 1, 2, 2, 2, 2, 3])
    limit = 1.000001 * strip.part_diameters(before).max()
    kept, broken, wide = _without_bad_moves(strip, before, after, limit, tested=True)
    np.testing.assert_array_equal(kept, before)
    assert not (broken | wide).any()


def test_a_part_broken_from_the_start_is_reported() -> None:
    strip = samples.strip(8).graph
    before = np.array([0, 1, 0, 2, 2, 3, 3, 3])
    after = np.array([0, 1, 0, 2, 2, 3, 2, 3])
    kept, broken, _ = _without_bad_moves(strip, before, after, np.inf, tested=False)
    np.testing.assert_array_equal(kept, before)
    assert broken.tolist() == [True, False, False, False]


class Scatters:
    """Gives one far cell of each other part to the first part, and says nothing of it."""

    def refine(self, graph, labels, target):
        return labels

    def refine_parts(self, graph, labels, block, target):
        from_first = np.linalg.norm(graph.centroids - graph.centroids[labels == 0].mean(axis=0), axis=1)
        moved = np.array(labels)
        moved[np.argmax(from_first)] = 0
        return moved


def test_a_refiner_of_finished_levels_is_not_believed() -> None:
    mesh = samples.voronoi(400, seed=1)
    polished = agglomerate(mesh, n_parts=20, post_refiners=(Scatters(),)).levels[0]
    assert mesh.graph.components(polished).max() == 19
    np.testing.assert_array_equal(polished, agglomerate(mesh, n_parts=20, polish=False).levels[0])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_parts_stay_whole_connected_and_small(seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = samples.squares(6).graph
    rank = rng.permutation(36)[:5]
    x = graph.centroids
    before = ((x[:, None] - x[rank][None]) ** 2).sum(axis=2).argmin(axis=1)
    after = np.where(rng.random(36) < 0.3, rng.integers(5, size=36), before)
    after[rng.permutation(36)[:5]] = np.arange(5)  # as refiners must, it empties none
    pieces = graph.components(before).max() + 1
    if pieces > 5:  # the parts to begin with are in pieces
        return
    limit = float(graph.part_diameters(before).max())
    result, broken, wide = _without_bad_moves(graph, before, after, limit, tested=bool(seed % 2))
    assert not (broken | wide).any()
    assert set(result) == set(range(5))
    assert graph.components(result).max() + 1 == 5
    assert graph.part_diameters(result).max() <= limit
