"""The fast ways from loops to faces and from faces to cells give what slow, obvious ways give."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from agglo_core import Mesh, agglomerate, samples
from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.mesh.construction.polygon_faces import plain_faces
from agglo_core.mesh.geometry.solid_cells import face_moments
from agglo_core.mesh.kernels.face_loops import loops_with_repeats
from agglo_core.mesh.kernels.faces import match_half_edges
from agglo_core.threads import using_threads


@cache
def mesh_of(name: str) -> Mesh:
    """Meshes by name: ``rough`` ones have cells of many faces, and many faces between two cells."""
    fine = samples.voronoi(1300, seed=2)
    rng = np.random.default_rng(0)
    near = np.linalg.norm(fine.cell_centroids[:, None] - rng.random((30, 2)), axis=2).argmin(axis=1)
    return {
        "voronoi": lambda: fine,
        "triangles": lambda: samples.random_triangles(300, seed=3),
        "rough": lambda: fine.coarsen(np.unique(near, return_inverse=True)[1]),
        "scattered": lambda: fine.coarsen(np.unique(rng.integers(0, 5, 1300), return_inverse=True)[1]),
    }[name]()


def paired(loops: list[list[int]], n_points: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Face vertices and cells by the fast kernels, None where they give up."""
    offsets = frozen_int(np.cumsum([0, *map(len, loops)]))
    vertices = frozen_int(np.concatenate(loops))
    found = plain_faces(offsets, vertices, n_points)
    with using_threads(3, few=7):
        again = plain_faces(offsets, vertices, n_points)
    assert (found is None) == (again is None)
    if found is not None and again is not None:
        assert all(map(np.array_equal, found, again))
    return found


@pytest.mark.parametrize("name", ["voronoi", "triangles"])
def test_faces_come_in_the_order_in_which_cells_meet_them(name: str) -> None:
    """Points of several buckets, numbered in any order."""
    mesh = mesh_of(name)
    loops, rng = mesh.boundary_loops, np.random.default_rng(1)
    cells = np.split(rng.permutation(mesh.n_points)[loops.vertices], loops.loop_offsets[1:-1])
    shuffled = [cells[c].tolist() for c in rng.permutation(mesh.n_cells)]
    for given in (shuffled, shuffled[: mesh.n_cells // 2]):
        numbers: dict[frozenset[int], int] = {}
        vertices, sides = [], []
        for c, loop in enumerate(given):
            for a, b in zip(loop, loop[1:] + loop[:1], strict=True):
                face = numbers.setdefault(frozenset((a, b)), len(numbers))
                if face == len(vertices):
                    vertices.append([a, b])
                    sides.append([c, -1])
                else:
                    sides[face][1] = c
        found = paired(given, mesh.n_points)
        assert found is not None
        assert found[0].tolist() == vertices
        assert found[1].tolist() == sides


@pytest.mark.parametrize(
    "loops",
    [
        [[0, 1, 2], [1, 0, 3], [0, 1, 4]],  # three cells at an edge
        [[0, 1, 2], [0, 1, 3]],  # two on one side
        [[0, 1, 2, 3, 1], [2, 1, 4]],  # an edge traversed both ways by no cell, a point met twice: plain
        [[0, 1, 2, 0, 3, 4, 3]],  # a bridge: the cell lies on both sides
    ],
)
def test_the_fast_pairing_gives_up_exactly_where_it_must(loops: list[list[int]]) -> None:
    offsets = frozen_int(np.cumsum([0, *map(len, loops)]))
    vertices, sides, doubles, fault = match_half_edges(offsets, frozen_int(np.concatenate(loops)), 5)
    bridge = any(loop[i - 1] == loop[(i + 1) % len(loop)] for loop in loops for i in range(len(loop)))
    found = paired(loops, 5)
    assert (found is None) == (fault[0] >= 0 or len(doubles) > 0 or bridge)
    if found is not None:
        assert found[0].tolist() == vertices.tolist()
        assert found[1].tolist() == sides.tolist()


@pytest.mark.parametrize("name", ["voronoi", "triangles", "rough", "scattered"])
def test_plane_cells_are_what_a_loop_over_their_faces_gives(name: str) -> None:
    """To the last bit, and neighbours in the order of the faces."""
    mesh = mesh_of(name)
    at, beside = mesh.local_points.tolist(), mesh.cell_neighbours
    for c in range(mesh.n_cells):
        faces = mesh.cell_faces[1][slice(*mesh.cell_faces[0][c : c + 2])]
        x0, y0 = at[mesh.face_pairs[faces[0], 0]]
        tails, shared, exposed, a, mx, my = [], {}, 0.0, 0.0, 0.0, 0.0
        for f in faces:
            side = 0 if mesh.face_cells[f, 0] == c else 1
            p, q, other = mesh.face_pairs[f, side], mesh.face_pairs[f, 1 - side], mesh.face_cells[f, 1 - side]
            (px, py), (qx, qy) = at[p], at[q]
            length = np.sqrt((qx - px) * (qx - px) + (qy - py) * (qy - py))
            assert length == mesh.face_measures[f]
            px, py, qx, qy = px - x0, py - y0, qx - x0, qy - y0
            cross = px * qy - qx * py
            a, mx, my = a + cross, mx + (px + qx) * cross, my + (py + qy) * cross
            tails.append(p)
            if other < 0:
                exposed += length
            else:
                shared[other] = shared.get(other, 0.0) + length
        row = slice(*beside.indptr[c : c + 2])
        assert mesh.cell_measures[c] == 0.5 * a
        assert mesh.local_centroids[c].tolist() == [x0 + mx / (3.0 * a), y0 + my / (3.0 * a)]
        assert mesh.cell_vertices[1][slice(*mesh.cell_vertices[0][c : c + 2])].tolist() == tails
        assert dict(zip(beside.indices[row], beside.interface[row], strict=True)) == shared
        assert beside.indices[row].tolist() == list(shared)
        assert beside.boundary[c] == exposed


def test_the_meshes_above_have_what_they_are_for() -> None:
    assert len(mesh_of("voronoi").points) > 2048  # more than one bucket
    sizes = {name: np.diff(mesh_of(name).cell_faces[0]) for name in ("rough", "scattered", "triangles")}
    rows = {name: np.diff(mesh_of(name).cell_neighbours.indptr) for name in sizes}
    assert sizes["triangles"].max() == 3
    assert 16 < sizes["rough"].max() < 1024 < sizes["scattered"].max()
    assert (rows["scattered"] < sizes["scattered"]).all()


def test_moments_of_faces_are_sums_over_fans_of_triangles() -> None:
    """Faces of boxes that were pushed out of plane, and one that is a line."""
    rng = np.random.default_rng(5)
    points = frozen_float(rng.random((40, 3)))
    loops = [rng.permutation(40)[:size].tolist() for size in (3, 4, 5, 9)] + [[0, 1, 0]]
    offsets = frozen_int(np.cumsum([0, *map(len, loops)]))
    total, centre = face_moments(points, offsets, frozen_int(np.concatenate(loops)))
    for f, loop in enumerate(loops[:-1]):
        a, b, c = points[loop[0]], points[loop[1:-1]], points[loop[2:]]
        parts = 0.5 * np.cross(b - a, c - a)
        np.testing.assert_allclose(total[f], parts.sum(axis=0), rtol=1e-13)
        share = parts @ total[f] / np.linalg.norm(total[f])
        wanted = share @ ((a + b + c) / 3) / np.linalg.norm(total[f])
        np.testing.assert_allclose(centre[f], wanted, rtol=1e-12)
    assert total[-1].tolist() == [0, 0, 0]
    assert centre[-1].tolist() == points[0].tolist()


def test_loops_that_meet_a_point_twice_are_found() -> None:
    loops = [[0, 1, 2], [2, 1, 3, 2], [3, 4, 0], [4, 3, 4], [0, 1, 2, 3, 4]]
    offsets = frozen_int(np.cumsum([0, *map(len, loops)]))
    found = loops_with_repeats(offsets, frozen_int(np.concatenate(loops)), 5)
    assert found.tolist() == [len(set(loop)) < len(loop) for loop in loops]


@pytest.mark.parametrize("n", [24, 48])
def test_edges_of_a_cell_on_one_line_do_not_cross(n: int) -> None:
    """Parts of a ring have separate edges on one radius, whose points are in line except for rounding."""
    coarse = agglomerate(samples.ring(n), bisector="coordinate", n_parts=(12, 4), seed=0).mesh(0)
    loops = coarse.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    again = Mesh.from_polygons(coarse.points, cells)
    np.testing.assert_allclose(again.cell_measures, coarse.cell_measures, rtol=1e-12)
