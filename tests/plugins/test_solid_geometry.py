"""Shapes of polyhedra as PolyDG sees them: moments, heights, sides, samples, and which cell holds a point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from solid_meshes import MESHES, gauss_tetrahedron, loops

from agglo_core.fields.location import locate
from agglo_core.fields.sampling import sample_points
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.forms.penalty import simplex_heights
from agglo_polydg_mg.forms.sides import sides_of
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import legendre, orders
from agglo_polydg_mg.space.quadrature import moments, weighted_moments
from agglo_polydg_mg.space.sampling import evaluate


@pytest.mark.parametrize("name", MESHES)
def test_moments_are_sums_over_signed_tetrahedra(name: str) -> None:
    mesh, degree = MESHES[name], 5
    basis = Basis(mesh, 1)
    points, weights = gauss_tetrahedron(6)
    expected = np.zeros((mesh.n_cells, len(orders(degree, 3))))
    for ring, cells in zip(loops(mesh), mesh.face_cells, strict=True):
        for side, c in enumerate(cells.tolist()):
            for b, d in pairwise(ring[1:] if c >= 0 else []):
                edges = np.array((ring[0], b, d))
                volume = np.linalg.det(edges) * (1 - 2 * side)
                inside = (points @ edges - basis.centres[c]) / basis.halves[c]
                lines = [legendre(x, degree)[k] for x, k in zip(inside.T, orders(degree, 3).T, strict=True)]
                expected[c] += np.prod(lines, axis=0) @ (volume * weights)
    found = moments(mesh, basis.boxes, degree)
    np.testing.assert_allclose(found, expected, atol=1e-12 * mesh.cell_measures.max())
    sampled_ones = weighted_moments(mesh, lambda x: np.ones(len(x)), basis.boxes, degree, "one")
    np.testing.assert_allclose(sampled_ones, expected, atol=1e-12 * mesh.cell_measures.max())


def test_farthest_vertices_make_heights_in_convex_cells() -> None:
    mesh = MESHES["Voronoi"]
    heights = simplex_heights(mesh, np.ones(mesh.n_cells, bool))
    offsets, vertices = mesh.cell_vertices
    for f, cells in enumerate(mesh.face_cells.tolist()):
        for side, c in enumerate(cells):
            if c < 0:
                assert np.isinf(heights[f, side])
                continue
            corners = mesh.points[vertices[offsets[c] : offsets[c + 1]]]
            distance = np.abs((corners - mesh.face_centroids[f]) @ mesh.face_normals[f]).max()
            assert heights[f, side] == pytest.approx(distance)


@pytest.mark.parametrize("name", MESHES)
def test_points_are_found_in_their_cells(name: str) -> None:
    mesh = MESHES[name]
    basis = Basis(mesh, 1, True)
    points = np.random.default_rng(5).random((400, 3)) * 1.2 - 0.1
    cells = locate(mesh, points)
    outside = ((points < 0) | (points > 1)).any(axis=1)
    np.testing.assert_array_equal(cells < 0, outside)
    values = evaluate(basis, basis.constants(np.arange(mesh.n_cells, dtype=float)), points)
    np.testing.assert_allclose(values[~outside], cells[~outside], atol=1e-9)
    if name == "hexahedra":
        np.testing.assert_array_equal(cells[~outside], np.floor(points[~outside] * 3) @ (1, 3, 9))
        assert locate(mesh, np.array([[1 / 3, 1 / 3, 1 / 3], [1, 1, 1], [2, 2, 2]])).tolist() == [0, 26, -1]


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_samples_fill_the_cells(degree: int) -> None:
    mesh = MESHES["Voronoi"]
    cells, points, simplices = sample_points(mesh, degree)
    corners = points[simplices]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    assert (volumes > 0).all()
    np.testing.assert_allclose(np.bincount(cells[simplices[:, 0]], volumes), mesh.cell_measures)


def test_sides_are_what_two_cells_share() -> None:
    for mesh in MESHES.values():
        sides = sides_of(mesh)
        pairs = {tuple(sorted(each)) for each in mesh.face_cells.tolist() if each[1] >= 0}
        inner = sides.cells[sides.cells[:, 1] >= 0]
        assert sorted(map(tuple, inner.tolist())) == sorted(pairs)
        for s, (a, b) in enumerate(sides.cells.tolist()):
            faces = sides.faces[sides.offsets[s] : sides.offsets[s + 1]]
            assert (sides.of_faces[faces] == s).all()
            assert {tuple(sorted(each)) for each in mesh.face_cells[faces].tolist()} == {
                tuple(sorted((a, b)))
            }
            assert b >= 0 or (mesh.face_normals[faces] @ mesh.face_normals[faces].T > 0).all()


@pytest.mark.parametrize("name", MESHES)
def test_transfers_are_injections(name: str) -> None:
    """A polynomial of an agglomerate has the same values in its cells."""
    mesh = MESHES[name]
    labels = np.arange(mesh.n_cells) // 3
    fine, coarse = Basis(mesh, 3, True), Basis(mesh.coarsen(labels), 2, True)
    x = np.random.default_rng(3).standard_normal(coarse.n)
    cells = np.repeat(np.arange(mesh.n_cells), 5)
    points = mesh.cell_centroids[cells] + 0.1 * np.random.default_rng(4).standard_normal((len(cells), 3))
    expected = coarse.evaluate(x, labels[cells], points)
    y = project_between(fine, coarse, labels) @ x
    np.testing.assert_allclose(fine.evaluate(y, cells, points), expected, atol=1e-10 * np.abs(expected).max())
