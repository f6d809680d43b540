"""Largest balls inside solids: hand values, linear programs, dense sampling, invariance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, cKDTree
from solid_parts import MESHES, outer_faces, planes, prism, ragged, turned

from agglo_core import samples
from agglo_core.mesh import Mesh
from agglo_core.shapes.metrics import CentredCircleRatio, CircleRatio

CR, CRC = CircleRatio(), CentredCircleRatio()


def radii(mesh: Mesh, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius of the largest ball, and of the one about the centroid, of each part."""
    half = mesh.coarsen(labels).cell_diameters / 2
    return CR.measure(mesh, np.asarray(labels)) * half, CRC.measure(mesh, np.asarray(labels)) * half


# -- slow references ----------------------------------------------------------------------------


def _triangles(faces: list[np.ndarray]) -> np.ndarray:
    """Return the triangles ``(t, 3, 3)`` of flat, convex polygons."""
    return np.array([corners[[0, i, i + 1]] for corners in faces for i in range(1, len(corners) - 1)])


def heights(p: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return distances of points ``(n, 3)`` from a closed surface, negative outside.

    A point is inside if the triangles fill more than half of the sphere around it (solid angles by Van
    Oosterom and Strackee 1983).
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    arms = [triangles[:, i] - p[:, None] for i in range(3)]
    above, nearest = np.ones(arms[0].shape[:2], bool), np.full(arms[0].shape[:2], np.inf)
    for i in range(3):
        edge = triangles[:, (i + 1) % 3] - triangles[:, i]
        above &= np.einsum("ptx,tx->pt", arms[i], np.cross(normals, edge)) <= 0
        along = -np.einsum("ptx,tx->pt", arms[i], edge) / np.einsum("tx,tx->t", edge, edge)
        to_edge = arms[i] + np.clip(along, 0, 1)[..., None] * edge
        np.minimum(nearest, np.einsum("ptx,ptx->pt", to_edge, to_edge), out=nearest)
    flat = np.abs(np.einsum("ptx,tx->pt", arms[0], normals))
    distance = np.where(above, flat, np.sqrt(nearest)).min(axis=1)
    a, b, c = arms
    la, lb, lc = (np.sqrt(np.einsum("ptx,ptx->pt", v, v)) for v in arms)
    dots = la * lb * lc + sum(
        np.einsum("ptx,ptx->pt", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb))
    )
    winding = 2 * np.arctan2(np.einsum("ptx,ptx->pt", a, np.cross(b, c)), dots).sum(axis=1)
    return np.where(np.abs(winding) > 2 * np.pi, distance, -distance)


def sampled_radius(faces: list[np.ndarray], seed: int, starts: int = 12) -> float:
    """Return the largest height of random points, refined around the highest local maxima among them."""
    rng, triangles = np.random.default_rng(seed), _triangles(faces)
    corners = np.concatenate(faces)
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    points = low + rng.random((80 * starts, 3)) * size
    found = heights(points, triangles)
    summits = np.flatnonzero(found >= found[cKDTree(points).query(points, 9)[1]].max(axis=1))
    best = summits[np.argsort(found[summits])[-starts:]]
    points, found, reach = points[best], found[best], 0.15 * size.max()
    while reach > 1e-4 * size.max():
        around = points[:, None] + reach * rng.normal(size=(len(points), 24, 3))
        around = np.concatenate((points[:, None], around), axis=1)
        every = heights(around.reshape(-1, 3), triangles).reshape(len(points), -1)
        chosen = every.argmax(axis=1)
        moved = chosen > 0
        points, found = around[np.arange(len(points)), chosen], every.max(axis=1)
        if moved.mean() < 0.3:
            reach *= 0.6
            higher = found > found.max() - 4 * reach  # distances change by 1 per length
            points, found = points[higher], found[higher]
    return found.max()


def chebyshev_radius(faces: list[np.ndarray]) -> float:
    """Radius of the largest ball in a convex solid: a linear program."""
    half = planes(faces)
    limits = np.column_stack((half[:, :3], np.ones(len(half))))
    return linprog([0, 0, 0, -1], limits, -half[:, 3], bounds=[(None, None)] * 3 + [(0, None)]).x[3]


# -- hand values --------------------------------------------------------------------------------

_CORNER = math.sqrt(3) / (1 + math.sqrt(3))  # between three faces of a cube and a corner
_SOLIDS = {
    "cube": (2, np.zeros(8, int), 1.0, 1.0),
    "bar": (2, np.arange(8) // 2, 0.5, 0.5),
    "hollow": (3, (np.arange(27) == 13).astype(int), _CORNER, 0.0),
    "without a corner": (2, np.append(np.zeros(7, int), 1), _CORNER, None),
    "L": (2, np.repeat([0, 0, 0, 1], 2), 2 - math.sqrt(2), math.sqrt(2) / 6),
    "touching": (2, np.array([0, 1, 1, 1, 1, 1, 1, 0]), 0.5, 0.0),
    "apart": (3, np.where(np.arange(27) // 9 == 1, 1, 0), 0.5, 0.0),
}


@pytest.mark.parametrize("moved", [False, True])
@pytest.mark.parametrize(("n", "labels", "largest", "centred"), _SOLIDS.values(), ids=_SOLIDS)
def test_balls_in_cubes_are_exact(n: int, labels: np.ndarray, largest: float, centred: float, moved: bool):
    unit = 0.01 / n if moved else 1 / n
    found, about = radii(turned(samples.boxes(n)) if moved else samples.boxes(n), labels)
    assert found[0] / unit == pytest.approx(largest, rel=1e-9)
    if centred is not None:
        assert about[0] / unit == pytest.approx(centred, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("height", [0.4, 3.0])
@pytest.mark.parametrize("n", [3, 4, 6, 8, 40])
def test_balls_in_prisms_are_exact(n: int, height: float) -> None:
    mesh = turned(prism(n, height))
    expected = 0.01 * min(height / 2, math.cos(math.pi / n))
    for found in radii(mesh, np.zeros(1, int)):
        assert found[0] == pytest.approx(expected, rel=1e-9)


def test_balls_in_a_regular_tetrahedron_are_exact() -> None:
    points = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
    mesh = turned(Mesh.from_polyhedra(points, [[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]]))
    assert CR.measure(mesh, np.zeros(1, int))[0] == pytest.approx(1 / math.sqrt(3) / math.sqrt(2))
    assert CRC.measure(mesh, np.zeros(1, int))[0] == pytest.approx(1 / math.sqrt(3) / math.sqrt(2))


@pytest.mark.parametrize("n", [4, 9])
def test_a_plate_and_a_wall_of_many_cubes(n: int) -> None:
    mesh = samples.boxes(n)
    x, y, _ = (mesh.cell_centroids * n).astype(int).T
    plate = (x > 0).astype(int)
    wall = ((x > 0) & (y > 0)).astype(int)  # an L of two plates
    for points in (mesh, turned(mesh)):
        unit = (points.cell_measures[0]) ** (1 / 3)
        assert radii(points, plate)[0][0] / unit == pytest.approx(0.5, rel=1e-9)
        assert radii(points, wall)[0][0] / unit == pytest.approx(2 - math.sqrt(2), rel=1e-9)


@pytest.mark.parametrize("thickness", [1e-1, 1e-3, 1e-6])
def test_two_thin_plates_at_an_angle(thickness: float) -> None:
    t = thickness
    outline = np.array([(0, 0), (1, 0), (1, t), (t, t), (t, 1), (0, 1)])
    points = np.vstack([np.c_[outline, np.full(6, height)] for height in (0.0, 1.0)])
    sides = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    mesh = turned(Mesh.from_polyhedra(points, [[[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *sides]]))
    (found,), _ = radii(mesh, np.zeros(1, int))
    assert 0.01 * t * (0.5 - 1e-9) <= found <= 0.01 * t * (2 - math.sqrt(2) + 1e-9)  # where both meet


@pytest.mark.parametrize("moved", [False, True])
def test_triangles_that_enclose_nothing_hold_no_ball(moved: bool) -> None:
    """Of a hexahedron with two equal corners; the search over boxes ends although it finds no ball."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float)
    sides = [[0, 3, 6, 2], [1, 3, 5, 4], [0, 1, 4, 3], [2, 6, 5, 3], [0, 2, 3, 1], [3, 4, 5, 6]]
    mesh = Mesh.from_polyhedra(points, [sides])
    (found,), (about,) = radii(turned(mesh) if moved else mesh, np.zeros(1, int))
    assert about == 0.0
    assert found < 1e-12


@pytest.mark.parametrize("moved", [False, True])
def test_cracks_inside_a_part_are_surface_on_both_sides(moved: bool) -> None:
    """Two coincident faces of opposite orientation: which of them is nearest does not show the side."""
    walls, square = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 7.0]), np.array([(0, 0), (7, 0), (7, 7), (0, 7)])
    layers = np.column_stack((walls[:-1], walls[1:]))
    points = np.array([(x, *yz) for layer in layers for x in layer for yz in square])
    box = np.array([(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)])
    mesh = Mesh.from_polyhedra(points, [box + 8 * k for k in range(6)], allow_gaps=True)
    found, _ = radii(turned(mesh) if moved else mesh, np.zeros(6, int))
    assert found[0] / (0.01 if moved else 1.0) == pytest.approx(1.0, rel=1e-9)  # in the wide layer


# -- oracles ------------------------------------------------------------------------------------


def _check_balls(mesh: Mesh, labels: np.ndarray, parts: range) -> None:
    largest, centred = radii(mesh, labels)
    centroids = mesh.coarsen(labels).cell_centroids
    for part in parts:
        faces = outer_faces(mesh, labels, part)
        sampled = sampled_radius(faces, seed=part)
        if sampled < largest[part] * (1 - 1e-3):  # few samples may meet a lesser summit, if ours is one
            sampled = sampled_radius(faces, seed=part, starts=100)
        assert largest[part] == pytest.approx(sampled, rel=1e-3), part
        height = heights(centroids[part][None], _triangles(faces))[0]
        assert centred[part] == pytest.approx(max(height, 0.0), abs=1e-9)


@pytest.mark.parametrize("name", MESHES)
def test_agree_with_dense_sampling(name: str) -> None:
    mesh = MESHES[name]()
    _check_balls(mesh, ragged(mesh, 90, seed=3, swaps=0.05), range(1))


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_agree_with_dense_sampling_on_many(name: str) -> None:
    mesh = MESHES[name]()
    for seed, swaps in ((5, 0.0), (6, 0.05)):
        labels = ragged(mesh, 45, seed=seed, swaps=swaps)
        _check_balls(mesh, labels, range(min(labels.max() + 1, 5)))


@pytest.mark.parametrize("mesh", [samples.voronoi3d(40, seed=5), samples.random_tetrahedra(20, seed=6)])
def test_convex_cells_agree_with_linear_programs(mesh: Mesh) -> None:
    labels = np.arange(mesh.n_cells)
    largest, _ = radii(mesh, labels)
    for cell in labels:
        assert largest[cell] == pytest.approx(chebyshev_radius(outer_faces(mesh, labels, cell)), rel=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_balls_of_a_large_convex_part_agree_with_a_linear_program(seed: int) -> None:
    mesh = samples.random_tetrahedra(400, seed=seed)
    points = mesh.points.copy()
    points[:, 2] += 0.3 * points[:, 0]  # a parallelepiped of many triangles
    slanted = Mesh(points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)
    labels = np.zeros(mesh.n_cells, int)
    assert ConvexHull(points).volume == pytest.approx(slanted.cell_measures.sum())
    expected = chebyshev_radius(outer_faces(slanted, labels, 0))
    assert radii(slanted, labels)[0][0] == pytest.approx(expected, rel=1e-9)


# -- invariance ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MESHES)
def test_motions_and_scales_change_nothing(name: str) -> None:
    mesh = MESHES[name]()
    labels = ragged(mesh, 40, seed=9, swaps=0.05)
    for metric in (CR, CRC):
        np.testing.assert_allclose(
            metric.measure(turned(mesh), labels), metric.measure(mesh, labels), rtol=1e-3, atol=1e-9
        )


def test_thin_parts_keep_their_digits() -> None:
    mesh = samples.boxes(4)
    for scale in ((1.0, 1.0, 0.05), (1e3, 1.0, 0.05), (1.0, 1e-4, 1e-4), (1.0, 1.0, 1e-3)):
        flat = turned(Mesh(mesh.points * scale, mesh.face_offsets, mesh.face_vertices, mesh.face_cells))
        notched = np.append(np.zeros(63, int), 1)
        found = radii(flat, notched)[0][0]
        assert found == pytest.approx(0.01 * min(scale) / 2, rel=1e-3)
