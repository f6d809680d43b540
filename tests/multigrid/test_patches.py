"""Vertex patches against sets of parts found the obvious way; patches known by hand; order and cover."""

from __future__ import annotations

import numpy as np
import pytest

from agglo_core import samples
from agglo_core.errors import MeshError, OptionError
from agglo_core.mesh import Mesh
from agglo_core.multigrid import joined_patches, vertex_patches
from agglo_core.problems import Patches

Array = np.ndarray
FRESH = 20261122


def as_lists(patches: Patches) -> list[list[int]]:
    return [part.tolist() for part in np.split(patches.parts, patches.offsets[1:-1])]


def slow_patches(mesh: Mesh, labels: Array) -> list[list[int]]:
    """Sets of parts at each vertex, those inside others left out, uncovered parts added; sorted."""
    at: dict[int, set[int]] = {}
    for face, cells in enumerate(mesh.face_cells):
        for vertex in mesh.face_vertices[mesh.face_offsets[face] : mesh.face_offsets[face + 1]]:
            at.setdefault(int(vertex), set()).update(int(labels[c]) for c in cells if c >= 0)
    sets = {frozenset(parts) for parts in at.values() if len(parts) > 1}
    largest = [parts for parts in sets if not any(parts < other for other in sets)]
    covered = set().union(*largest) if largest else set()
    alone = [{part} for part in set(labels.tolist()) - covered]
    return sorted(sorted(parts) for parts in [*largest, *alone])


@pytest.mark.parametrize("name", ["voronoi", "random_triangles", "tetrahedra"])
def test_agglomerates_have_the_patches_of_the_slow_search(name: str) -> None:
    mesh = {
        "voronoi": lambda: samples.voronoi(200, seed=FRESH),
        "random_triangles": lambda: samples.random_triangles(100, seed=FRESH),
        "tetrahedra": lambda: samples.tetrahedra(2),
    }[name]()
    n = mesh.n_cells
    scattered = np.random.default_rng(FRESH).integers(0, n // 8, n)  # with holes, in pieces
    for labels in (np.arange(n), np.arange(n) // 5, np.unique(scattered, return_inverse=True)[1]):
        found = as_lists(vertex_patches(mesh, labels, most=n))
        assert found == slow_patches(mesh, labels), f"seed {FRESH}"


def test_a_hanging_node_and_a_hole() -> None:
    grid = samples.squares(5)
    ring = np.zeros(25, int)
    ring[12] = 1  # the cell in the middle is inside the agglomerate of all others
    assert as_lists(vertex_patches(grid, ring)) == [[0, 1]]
    left = np.array([0, 0, 1, 1, 1] * 3 + [0, 0, 2, 2, 2] * 2)  # the border of 1 and 2 ends at 0
    assert as_lists(vertex_patches(grid, left)) == [[0, 1, 2]]


def test_one_part_and_parts_that_do_not_touch() -> None:
    assert as_lists(vertex_patches(samples.squares(3), np.zeros(9, int))) == [[0]]
    apart = samples.disconnected(2)
    assert as_lists(vertex_patches(apart, np.arange(8) // 4)) == [[0], [1]]


def test_a_vertex_of_too_many_cells_has_no_patch() -> None:
    angles = np.arange(100) * 2 * np.pi / 100
    points = np.vstack(([0.0, 0.0], np.stack((np.cos(angles), np.sin(angles)), axis=1)))
    fan = Mesh.from_polygons(points, [(0, 1 + k, 1 + (k + 1) % 100) for k in range(100)])
    labels = np.arange(100)
    assert as_lists(vertex_patches(fan, labels, most=100)) == [list(range(100))]
    pairs = [[0, 1], [0, 99], *([k, k + 1] for k in range(1, 99))]
    assert as_lists(vertex_patches(fan, labels)) == pairs


def test_vertices_of_a_short_edge_are_one_on_the_finest_level_only() -> None:
    n = 8
    y = np.concatenate(([0.0], np.geomspace(1e-6, 1.0, n)))
    X, Y = np.meshgrid(np.linspace(0.0, 1.0, n + 1), y)
    j, i = np.divmod(np.arange(n * n), n)
    c = j * (n + 1) + i
    cells = np.stack((c, c + 1, c + n + 2, c + n + 1), axis=1)
    layer = Mesh.from_polygons(np.stack((X.ravel(), Y.ravel()), axis=1), cells)
    assert np.diff(vertex_patches(layer).offsets).max() == 8  # three vertices of a column at a time, not all

    hexagons = Mesh.from_polygons(*_offset_rows(0.02))
    merged, apart = vertex_patches(hexagons), vertex_patches(hexagons, np.arange(hexagons.n_cells))
    assert np.diff(merged.offsets).max() == 4
    assert np.diff(apart.offsets).max() == 3
    assert len(merged) == 1 < len(apart) == 2


def _offset_rows(gap: float) -> tuple[Array, list[list[int]]]:
    """Two squares on two others, those above moved aside by ``gap``."""
    points = np.array(
        [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (gap, 0), (1, 0), (-1, 1), (gap, 1), (1, 1)], float
    )
    return points, [[0, 1, 4, 3], [1, 2, 6, 5, 4], [3, 4, 5, 8, 7], [5, 6, 9, 8]]


def test_short_edges_in_three_dimensions() -> None:
    boxes = samples.boxes(3)
    assert len(vertex_patches(boxes)) == 8
    flat = Mesh(boxes.points * [1.0, 1.0, 1e-4], boxes.face_offsets, boxes.face_vertices, boxes.face_cells)
    assert np.diff(vertex_patches(flat).offsets).tolist() == [12] * 4  # columns


def test_tensors_join_vertices_along_their_strong_direction() -> None:
    mesh = samples.squares(6)
    tensors = np.tile(np.diag([1.0, 1e-4]), (mesh.n_cells, 1, 1))
    found = vertex_patches(mesh, tensors=tensors)
    assert as_lists(found) == [[*range(6 * k, 6 * k + 12)] for k in range(5)]  # pairs of rows
    assert as_lists(vertex_patches(mesh, tensors=np.tile(np.eye(2), (36, 1, 1)))) == as_lists(
        vertex_patches(mesh)
    )


def test_labels_with_gaps_are_refused() -> None:
    with pytest.raises(MeshError, match="gaps"):
        vertex_patches(samples.squares(2), np.array([0, 0, 2, 2]))


@pytest.mark.parametrize("most", [1, 2, 5, 100])
def test_joined_patches_are_those_of_sets_united_in_turn(most: int) -> None:
    rng = np.random.default_rng(FRESH)
    pairs = rng.integers(0, 60, (80, 2))
    sets = [{part} for part in range(60)]
    for a, b in pairs.tolist():
        one, other = (next(each for each in sets if part in each) for part in (a, b))
        if one is not other and len(one) + len(other) <= most:
            sets.remove(other)
            one |= other
    found = as_lists(joined_patches(pairs, 60, most=most))
    assert found == sorted(sorted(each) for each in sets), f"seed {FRESH}"


def test_pairs_of_unknown_parts_are_refused() -> None:
    with pytest.raises(OptionError, match="0 to 3"):
        joined_patches(np.array([[0, 4]]), 4)
    assert as_lists(joined_patches(np.zeros((0, 2), int), 2)) == [[0], [1]]
