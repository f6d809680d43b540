"""What annealed parts are cut into and dissolved to, one by one or in many places of a large mesh."""

from __future__ import annotations

import numpy as np

from agglo_core import Graph, agglomerate, samples
from agglo_core.anneal.annealed_parts import Weights, too_wide
from agglo_core.anneal.round_search import Effort, Search
from agglo_core.anneal.start_parts import cut_in_two, dissolve_part, dissolve_parts
from agglo_core.arrays import frozen_int
from agglo_core.progress import TimeLimit
from agglo_core.threads import using_threads


def test_parts_are_cut_across_their_principal_axis() -> None:
    graph = samples.strip(12).graph
    x = np.argsort(np.argsort(graph.centroids[:, 0]))
    labels = frozen_int(x // 6)
    cut = cut_in_two(graph, labels, np.array([True, False]))
    groups = {tuple(sorted(x[cut == p].tolist())) for p in range(cut.max() + 1)}
    assert groups == {(0, 1, 2), (3, 4, 5), (6, 7, 8, 9, 10, 11)}


def test_what_a_cut_leaves_in_pieces_becomes_several_parts() -> None:
    mesh = samples.squares(3)  # a U: its arms are beyond the cut, and apart
    x, y = (np.round(mesh.cell_centroids * 3 - 0.5)).astype(int).T
    labels = frozen_int((x == 1) & (y > 0))
    cut = cut_in_two(mesh.graph, labels, np.array([True, False]))
    assert (mesh.graph.components(cut) == mesh.graph.components(mesh.graph.components(cut))).all()
    assert len(np.unique(mesh.graph.components(cut))) == cut.max() + 1 >= 3


def test_cells_all_in_one_place_are_cut_in_halves() -> None:
    path = Graph.from_arrays([0, 1, 3, 5, 6], [1, 0, 2, 1, 3, 2], np.zeros((4, 2)))
    assert cut_in_two(path, frozen_int(np.zeros(4)), np.array([True])).tolist() == [0, 0, 1, 1]


def test_cells_of_a_dissolved_part_join_what_they_share_most_with() -> None:
    graph = samples.squares(4).graph  # columns, from below
    columns = frozen_int(np.arange(16) // 4)
    assert dissolve_part(graph, columns, 0).reshape(4, 4).tolist() == [[0] * 4, [0] * 4, [1] * 4, [2] * 4]
    block = columns.copy()
    block[4:12] = 1
    after = dissolve_part(graph, frozen_int(np.unique(block, return_inverse=True)[1]), 1)
    assert after.reshape(4, 4).tolist() == [[0] * 4, [0] * 4, [1] * 4, [1] * 4]
    assert dissolve_part(graph, frozen_int(np.zeros(16)), 0).tolist() == [0] * 16


def test_parts_dissolve_together_into_others_of_their_share() -> None:
    graph = samples.squares(4).graph  # columns, from below
    columns = frozen_int(np.arange(16) // 4)
    chosen, shares = np.array([True, False, False, True]), frozen_int([0, 0, 1, 1])
    after = dissolve_parts(graph, columns, chosen, shares).reshape(4, 4)
    assert after.tolist() == [[1] * 4, [1] * 4, [2] * 4, [2] * 4]
    nowhere = dissolve_parts(graph, columns, chosen, frozen_int([0, 1, 1, 1])).reshape(4, 4)
    assert nowhere.tolist() == [[0] * 4, [1] * 4, [2] * 4, [2] * 4]


def test_dissolving_together_is_dissolving_one_by_one_where_parts_are_apart() -> None:
    graph = samples.voronoi(50, seed=2).graph
    labels = agglomerate(graph, n_parts=10).levels[0]
    for part in range(10):
        after = dissolve_parts(graph, labels, np.arange(10) == part, frozen_int(np.zeros(10)))
        np.testing.assert_array_equal(
            np.unique(after, return_inverse=True)[1], dissolve_part(graph, labels, part)
        )


def test_on_large_meshes_parts_are_dissolved_in_many_places() -> None:
    mesh = samples.voronoi(3000, seed=2)
    size = (32.0 / mesh.n_cells) ** 0.5
    rest = Effort(100, 20, 2), Weights(), TimeLimit()
    search = Search(mesh.graph, size, 5, *rest)
    before, seen = search.fitted(search.tool.inward(agglomerate(mesh, method="kway", h_star=size).levels[0]))
    after, shapes = search.thinned(before, seen)
    assert after.max() < before.max()
    assert len(np.unique(search.tool.graph.components(after))) == after.max() + 1
    np.testing.assert_allclose(shapes.widths, search.tool.graph.part_diameters(after))
    assert too_wide(shapes, after, size).sum() <= too_wide(seen, before, size).sum()
    assert (
        shapes.ratios.mean() + (shapes.widths / size).mean()
        > seen.ratios.mean() + (seen.widths / size).mean()
    )


def test_parts_of_large_meshes_do_not_depend_on_the_number_of_threads() -> None:
    mesh, found = samples.random_triangles(2000, seed=2), []
    for threads in (1, 2):
        with using_threads(threads):
            options = {"effort": "fast", "objective": "roundness"}
            run = agglomerate(mesh, bisector=("kmeans", options), method="kway", h_star=0.1)
            found.append(run.levels[0])
    np.testing.assert_array_equal(found[0], found[1])
    assert mesh.graph.part_diameters(found[0]).max() <= 0.1 * (1 + 1e-9)
