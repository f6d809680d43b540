"""The kernels of PolyDG against slow, obvious references: numpy for the integrals, shapely for the triangles.

``tests/benchmarks/assembly.py`` times :func:`reference_matrix` beside the kernels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import shapely
from numpy.polynomial import legendre as reference
from numpy.typing import NDArray
from scipy import sparse

from agglo_core import Mesh, samples
from agglo_core.fields.rules import inside
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.forms.penalty import face_penalty, triangle_heights
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import legendre, orders, slopes
from agglo_polydg_mg.space.quadrature import moments, weighted_moments

Array = NDArray[np.float64]


def scattered() -> Mesh:
    """Agglomerates in pieces, with holes and pinch vertices."""
    mesh = samples.voronoi(60, seed=1)
    return mesh.coarsen(np.random.default_rng(0).integers(8, size=mesh.n_cells))


def framed() -> Mesh:
    """A square in the hole of a frame in the hole of a larger frame."""
    column, row = np.arange(25) % 5, np.arange(25) // 5
    return samples.squares(5).coarsen(np.minimum.reduce((column, row, 4 - column, 4 - row)))


MESHES = {
    "squares": lambda: samples.squares(3),
    "triangles": lambda: samples.random_triangles(20, seed=2),
    "voronoi": lambda: samples.voronoi(20, seed=3),
    "scattered": scattered,
    "framed": framed,
    "many faces": lambda: samples.voronoi(70, seed=6),
}


@pytest.fixture(params=MESHES.values(), ids=MESHES.keys())
def mesh(request: pytest.FixtureRequest) -> Mesh:
    build: Callable[[], Mesh] = request.param
    return build()


def reference_matrix(
    mesh: Mesh, degree: int, kappa: Array, sigma: Array, scaled: bool = False
) -> sparse.csr_array:
    """The matrix by points inside the cells and on the faces, with einsum."""
    basis = Basis(mesh, degree, scaled)
    m = basis.n_local
    volume = np.zeros((mesh.n_cells, m, m))
    for batch in inside(mesh, 2 * degree):
        gradient = basis.gradients(batch.cells, batch.points)
        weights = batch.weights * kappa[batch.cells]
        np.add.at(
            volume, batch.cells, np.einsum("q,qdi,qdj->qij", weights, gradient, gradient, optimize=True)
        )
    cells = np.arange(mesh.n_cells)
    blocks, rows, columns = [volume], [cells], [cells]
    nodes, weights = reference.leggauss(degree + 1)
    for inner in (True, False):
        faces = np.flatnonzero(((mesh.face_cells[:, 1] >= 0) == inner) & (sigma > 0))
        sides = mesh.face_cells[faces].T[: 1 + inner]
        jump, flux, mean = [], [], []
        ends = mesh.local_points[mesh.face_pairs[faces]]
        points = ends[:, :1] + 0.5 * (1 + nodes)[:, None] * (ends[:, 1:] - ends[:, :1])
        for side, sign in zip(sides, (1, -1), strict=False):
            at = (np.repeat(side, len(nodes)), points.reshape(-1, 2))
            jump.append(sign * basis.values(*at).reshape(len(faces), -1, m))
            normals = np.repeat(mesh.face_normals[faces], len(nodes), axis=0)
            slope = np.einsum("qd,qdi->qi", normals, basis.gradients(*at))
            flux.append(slope.reshape(len(faces), -1, m))
            mean.append(kappa[side])
        harmonic = 2 / (1 / mean[0] + 1 / mean[1]) if inner else mean[0]
        measure = 0.5 * weights * mesh.face_measures[faces, None]
        for s in range(len(sides)):
            for t in range(len(sides)):
                share = harmonic / len(sides)  # weight of a side times its own κ
                block = np.einsum(
                    "f,fq,fqi,fqj->fij", harmonic * sigma[faces], measure, jump[s], jump[t], optimize=True
                )
                block -= np.einsum("f,fq,fqi,fqj->fij", share, measure, jump[s], flux[t], optimize=True)
                block -= np.einsum("f,fq,fqi,fqj->fij", share, measure, flux[s], jump[t], optimize=True)
                blocks.append(block)
                rows.append(sides[s])
                columns.append(sides[t])
    return from_blocks(np.concatenate(blocks), np.concatenate(rows), np.concatenate(columns), basis.n)


def from_blocks(
    blocks: Array, rows: NDArray[np.int64], columns: NDArray[np.int64], n: int
) -> sparse.csr_array:
    """Sum of blocks at block rows and columns."""
    m = blocks.shape[1]
    i = rows[:, None, None] * m + np.arange(m)[:, None] + np.zeros(m, int)
    j = columns[:, None, None] * m + np.arange(m) + np.zeros((m, 1), int)
    return sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), shape=(n, n)).tocsr()


def reference_heights(mesh: Mesh) -> Array:
    """Heights by shapely: a triangle fits if its part inside the cell has its whole area."""
    heights = np.full((mesh.n_faces, 2), np.inf)
    polygons, offsets, corners = mesh.to_shapely(), *mesh.cell_vertices
    for face, cells in enumerate(mesh.face_cells):
        a, b = mesh.points[mesh.face_pairs[face]]
        for side, cell in enumerate(cells):
            if cell < 0:
                continue
            best = 0.0
            for v in mesh.points[corners[offsets[cell] : offsets[cell + 1]]]:
                turn = (b[0] - a[0]) * (v[1] - a[1]) - (b[1] - a[1]) * (v[0] - a[0])
                area = 0.5 * turn * (1 - 2 * side)  # the owner lies on the left
                if area > best and polygons[cell].intersection(shapely.Polygon([a, b, v])).area > area * (
                    1 - 1e-6
                ):
                    best = area
            heights[face, side] = 2 * best / mesh.face_measures[face]
    return heights


def test_legendre_polynomials_are_those_of_numpy() -> None:
    x = np.linspace(-1.2, 1.2, 7)
    ours, derivatives = legendre(x, 6), slopes(legendre(x, 6))
    for k in range(7):
        unit = reference.Legendre.basis(k) * np.sqrt(k + 0.5)
        np.testing.assert_allclose(ours[k], unit(x), rtol=1e-13)
        np.testing.assert_allclose(derivatives[k], unit.deriv()(x), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 3, 6])
def test_coefficients_of_gradients_are_those_of_the_gradients(mesh: Mesh, degree: int) -> None:
    random = np.random.default_rng(1)
    for on in (mesh, samples.random_tetrahedra(8, seed=1)):
        for scaled in (False, True):
            basis = Basis(on, degree, scaled)
            cells = random.integers(0, on.n_cells, 40)
            points = on.cell_centroids[cells] + 0.1 * random.normal(size=(40, on.dim))
            u = random.normal(size=(on.n_cells, basis.n_local))
            expected = np.einsum("qdk,qk->qd", basis.gradients(cells, points - on.origin), u[cells])
            found = basis.gradient(u, cells, points)
            np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_moments_by_the_boundary_are_those_by_points_inside(mesh: Mesh) -> None:
    boxes, degree = Basis(mesh, 1).boxes, 7
    reference = np.zeros((mesh.n_cells, len(orders(degree))))
    for batch in inside(mesh, degree):
        scaled = (batch.points - boxes[batch.cells, :2]) / boxes[batch.cells, 2:4]
        lx, ly = legendre(scaled[:, 0], degree), legendre(scaled[:, 1], degree)
        i, j = orders(degree).T
        np.add.at(reference, batch.cells, (lx[i] * ly[j] * batch.weights).T)
    size = mesh.cell_measures.max()
    np.testing.assert_allclose(moments(mesh, boxes, degree), reference, atol=1e-12 * size)
    sampled = weighted_moments(mesh, lambda x: np.ones(len(x)), boxes, degree, "one")
    np.testing.assert_allclose(sampled, reference, atol=1e-12 * size)


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_matrix_is_that_of_the_reference(mesh: Mesh, degree: int) -> None:
    kappa = np.geomspace(1, 1e3, mesh.n_cells)
    sigma = face_penalty(mesh, degree)
    for scaled in (False, True):
        A = discretise(mesh, degree, Diffusion(kappa=kappa), scaled_basis=scaled).A.toarray()
        reference = reference_matrix(mesh, degree, kappa, sigma, scaled).toarray()
        np.testing.assert_allclose(A, reference, atol=1e-12 * abs(reference).max())


def test_boxes_hold_the_vertices_of_cells(mesh: Mesh) -> None:
    offsets, vertices = mesh.cell_vertices
    for c, box in enumerate(Basis(mesh, 1).boxes):
        corners = mesh.local_points[vertices[offsets[c] : offsets[c + 1]]]
        low, high = corners.min(axis=0), corners.max(axis=0)
        np.testing.assert_array_equal(box, [*(0.5 * (low + high)), *(0.5 * (high - low)), 1.0, 0.0])


def test_natural_faces_are_left_out_as_in_the_reference(mesh: Mesh) -> None:
    left = (mesh.face_cells[:, 1] < 0) & (mesh.points[mesh.face_pairs][:, :, 0].max(axis=1) < 1e-9)
    tagged = Mesh(**{**vars_of(mesh), "face_tags": {"boundary": left.astype(int)}})
    A = discretise(tagged, 2, Diffusion(dirichlet={1: 0.0})).A.toarray()
    natural = (mesh.face_cells[:, 1] < 0) & ~left
    sigma = np.where(natural, 0.0, face_penalty(mesh, 2))
    reference = reference_matrix(mesh, 2, np.ones(mesh.n_cells), sigma).toarray()
    np.testing.assert_allclose(A, reference, atol=1e-12 * abs(reference).max())


def vars_of(mesh: Mesh) -> dict[str, NDArray[np.generic]]:
    """The arrays a mesh is made of."""
    return {name: getattr(mesh, name) for name in ("points", "face_offsets", "face_vertices", "face_cells")}


def test_largest_triangles_are_those_shapely_finds(mesh: Mesh) -> None:
    heights = triangle_heights(mesh)
    np.testing.assert_allclose(heights, reference_heights(mesh), rtol=1e-7)


def test_penalty_of_squares_is_twenty_over_h() -> None:
    np.testing.assert_allclose(face_penalty(samples.squares(4), 3), 20 * 9 * 4)


def test_a_straight_side_cut_in_two_has_the_triangles_of_its_halves() -> None:
    mesh = Mesh.from_polygons([[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]], [[0, 1, 2, 3, 4]])
    heights = triangle_heights(mesh)
    np.testing.assert_allclose(heights[:, 0], 2.0)


def test_a_reflex_vertex_hides_what_lies_behind_it() -> None:
    """An L: from its lower side the far corner of the upright is hidden, the corner at the bend is not."""
    mesh = Mesh.from_polygons([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], [range(6)])
    heights = triangle_heights(mesh)
    np.testing.assert_allclose(heights[0, 0], 1.0)  # from (0,0)–(3,0) to (3,1) or (1,1)
    np.testing.assert_allclose(heights, reference_heights(mesh))
