"""The continuous space inside the discontinuous one: what it reproduces, where it is split, its matrix."""

from __future__ import annotations

import numpy as np
import pytest
from random_diffusion import graded
from scipy import sparse
from scipy.linalg import block_diag

from agglo_core import Mesh, samples
from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.multigrid import LevelStack, cycle
from agglo_core.problems import Diffusion, System
from agglo_polydg_mg.auxiliary.conforming_kernels import cluster_vertices
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack, labels_of_unknowns
from agglo_polydg_mg.auxiliary.galerkin_kernels import drop_small_entries
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.forms.penalty import face_penalty
from agglo_polydg_mg.solver.choose import choose
from agglo_polydg_mg.space.basis import Basis

FRESH = np.random.SeedSequence(20).generate_state(2).tolist()


def space_on(mesh: Mesh, degree: int, kappa: object = 1.0) -> tuple[Basis, ConformingSpace]:
    """Basis and continuous space on a mesh."""
    basis = Basis(mesh, degree, True)
    return basis, conforming_space(basis, face_penalty(mesh, degree), np.broadcast_to(kappa, mesh.n_cells))


def stack_on(
    mesh: Mesh, degree: int = 1, kappa: object = 1.0, **options: object
) -> tuple[System, LevelStack]:
    """A system of diffusion and its levels."""
    values = np.broadcast_to(kappa, mesh.n_cells).astype(float)
    system = discretise(mesh, degree, Diffusion(values, 8.0), scaled_basis=True)
    basis, sigma = Basis(mesh, degree, True), face_penalty(mesh, degree)
    return system, conforming_stack(system, basis, sigma, values, **options)


def iterations(system: System, stack: LevelStack, kind: str = "V", tolerance: float = 1e-6) -> int:
    """Of flexible conjugate gradients (Polak, Ribière) to a relative residual; fails after 100."""
    M, b = cycle(stack, kind), system.b
    x, r, z = np.zeros_like(b), b, M @ b
    p = z
    for k in range(1, 101):
        Ap = system.A @ p
        step = (r @ z) / (p @ Ap)
        assert step > 0.0
        x, before, along = x + step * p, r, r @ z
        r = r - step * Ap
        if np.linalg.norm(r) <= tolerance * np.linalg.norm(b):
            assert np.linalg.norm(b - system.A @ x) <= 3 * tolerance * np.linalg.norm(b)
            return k
        z = M @ r
        p = z + (z @ (r - before)) / along * p
    raise AssertionError("100 iterations are not enough")


def at_vertices(mesh: Mesh, space: ConformingSpace, function: object) -> np.ndarray:
    """Values of a function in the unknowns of vertices: of a vertex of each that is a corner of the cell."""
    x = np.zeros(space.n)
    for c in range(mesh.n_cells):
        own = space.unknowns[space.offsets[c] : space.offsets[c + 1]]
        own = own[own < space.n_vertices]
        faces = mesh.cell_faces[1][mesh.cell_faces[0][c] : mesh.cell_faces[0][c + 1]]
        corners = list(dict.fromkeys(mesh.face_pairs[faces].ravel()))  # in the order of the faces
        x[own] = function(mesh.points[corners])
    return x


@pytest.mark.parametrize("mesh", [samples.random_triangles(40, seed=5), samples.squares(5)], ids=str)
def test_linear_functions_are_those_of_their_values_at_vertices(mesh: Mesh) -> None:
    def linear(x: np.ndarray) -> np.ndarray:
        return 1.0 + 2.0 * x[:, 0] - x[:, 1]

    basis, space = space_on(mesh, 1)
    x = at_vertices(mesh, space, linear)
    assert np.allclose(space.prolongation() @ x, basis.project(linear), atol=1e-11)


def test_bubbles_give_quadratic_functions_on_triangles() -> None:
    mesh = samples.triangles(3)
    basis, space = space_on(mesh, 2)
    x = at_vertices(mesh, space, lambda at: at[:, 0] * at[:, 1])
    P = space.prolongation()
    wanted = basis.project(lambda at: at[:, 0] * at[:, 1])
    x[space.n_vertices :] = np.linalg.lstsq(P.toarray()[:, space.n_vertices :], wanted - P @ x, rcond=None)[0]
    assert space.n == space.n_vertices + mesh.n_faces
    assert np.allclose(P @ x, wanted, atol=1e-5 * np.abs(wanted).max())  # the regularisation


@pytest.mark.parametrize("seed", FRESH)
def test_constants_are_ones_at_vertices_on_any_mesh(seed: int) -> None:
    voronoi = samples.voronoi(90, seed=seed)
    scattered = voronoi.coarsen(np.random.default_rng(seed).permutation(90) // 15)
    for mesh in (voronoi, scattered):
        for degree in (1, 3):
            basis, space = space_on(mesh, degree, 10.0 ** (seed % 7 * np.arange(mesh.n_cells) % 5))
            ones = np.arange(space.n) < space.n_vertices
            assert np.allclose(space.prolongation() @ ones, basis.constants(np.ones(mesh.n_cells)), atol=1e-9)
            corners = space.unknowns < space.n_vertices
            cells = np.repeat(np.arange(mesh.n_cells), np.diff(space.offsets))[corners]
            assert np.bincount(cells).max() <= 36


def test_a_scaled_prolongation_is_the_product_with_the_blocks() -> None:
    mesh = samples.random_triangles(20, seed=2)
    _, space = space_on(mesh, 2)
    blocks = frozen_float(np.random.default_rng(0).standard_normal((mesh.n_cells, 6, 6)))
    product = block_diag(*blocks) @ space.prolongation().toarray()
    assert np.allclose(space.prolongation(scale=blocks).toarray(), product, atol=1e-12)


def test_small_entries_between_vertices_go_to_the_diagonal() -> None:
    mesh = samples.voronoi(200, seed=FRESH[1])
    A = discretise(mesh, 1, Diffusion(1.0, 1.0), scaled_basis=True).A
    _, space = space_on(mesh, 1)
    C = space.galerkin(A).toarray()
    thin = space.galerkin(A, small_vertices=0.01)
    D, scale = thin.toarray(), np.sqrt(np.outer(C.diagonal(), C.diagonal()))
    off = ~np.eye(space.n, dtype=bool)
    small = off & (np.abs(C) <= 0.01 * scale)
    light = np.abs(np.where(small, C, 0.0)).sum(axis=1) <= 0.25 * C.diagonal()
    assert thin.has_sorted_indices
    assert np.count_nonzero(C) > 1.1 * thin.nnz
    assert np.array_equal(off & (D == 0.0), off & ((C == 0.0) | (small & (C > 0.0) & light[:, None] & light)))
    assert np.allclose(D[off & (D != 0.0)], C[off & (D != 0.0)], atol=1e-11 * scale.max())
    assert np.allclose(D.sum(axis=1), C.sum(axis=1), atol=1e-10 * scale.max())
    assert np.linalg.eigvalsh(D)[0] > 0.0
    assert np.linalg.eigvalsh(D - C)[0] > -1e-10 * scale.max()  # hexagons leave nothing to spare


def test_small_entries_stay_where_nothing_else_joins_two_groups() -> None:
    rows, columns = frozen_int([0, 2, 4, 6, 7]), frozen_index([0, 1, 1, 2, 2, 3, 3])
    values = frozen_float([2.0, -1.0, 2.0, 0.001, 2.0, -1.0, 2.0])  # 0–1 and 2–3, joined by 1–2 alone
    starts, found, data = drop_small_entries(rows, columns, values, 4, 0.0, 0.0, 0.01)
    C = sparse.csr_array((data, found, starts), shape=(4, 4)).toarray()
    assert np.array_equal(C, C.T)
    assert C[1, 2] == 0.001
    assert np.array_equal(C.diagonal(), np.full(4, 2.0))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_matrix_is_that_of_the_prolongation(degree: int) -> None:
    mesh = samples.voronoi(60, seed=FRESH[0])
    kappa = np.random.default_rng(1).choice([1.0, 1e4], mesh.n_cells)
    A = discretise(mesh, degree, Diffusion(kappa, 1.0), scaled_basis=True).A
    _, space = space_on(mesh, degree, kappa)
    P = space.prolongation().toarray()
    wanted = P.T @ A.toarray() @ P
    C = space.galerkin(A)
    assert C.has_sorted_indices
    assert np.allclose(C.toarray(), wanted, atol=1e-11 * np.abs(wanted).max())
    scale = np.sqrt(np.outer(wanted.diagonal(), wanted.diagonal()))
    thin, vertex = space.galerkin(A, 0.01, 0.1), np.arange(space.n) < space.n_vertices
    bubbles = ~vertex[:, None] & ~vertex
    kept = np.where(np.abs(wanted) > np.where(bubbles, 0.1, 0.01) * scale, wanted, 0.0)
    out, ratio = np.abs(wanted - kept), wanted.diagonal()[:, None] / scale
    diagonal = np.where(bubbles, out * ratio, 0.0).sum(axis=1)
    assert thin.has_sorted_indices
    assert thin.nnz == np.count_nonzero(kept) < C.nnz
    assert np.allclose(thin.toarray(), kept + np.diag(diagonal), atol=1e-11 * scale.max())


def test_a_vertex_splits_where_strong_cells_touch_at_it_only() -> None:
    mesh = samples.squares(2)
    x, y = mesh.cell_centroids.T
    assert space_on(mesh, 1)[1].n_vertices == 9
    assert space_on(mesh, 1, np.where((x < 0.5) == (y < 0.5), 1e6, 1.0))[1].n_vertices == 12
    assert space_on(mesh, 1, np.where(x < 0.5, 1e6, 1.0))[1].n_vertices == 9  # the weaker follows
    assert space_on(mesh, 1, np.where((x < 0.5) == (y < 0.5), 2.0, 1.0))[1].n_vertices == 9


def test_the_space_is_discontinuous_across_the_sides_of_flat_cells() -> None:
    points = np.stack(np.meshgrid(np.arange(4.0), 1e-4 * np.arange(4.0)), axis=-1).reshape(-1, 2)
    corner = (np.arange(3)[:, None] * 4 + np.arange(3)).ravel()
    mesh = Mesh.from_polygons(points, np.stack([corner, corner + 1, corner + 5, corner + 4], axis=1))
    assert space_on(mesh, 1)[1].n_vertices == 3 * 4 * 2  # three columns, each continuous


def test_a_chain_of_short_edges_becomes_more_than_one_cluster() -> None:
    points = np.stack((0.1 * np.arange(11), np.zeros(11)), axis=1)
    edges = np.stack((np.arange(10), np.arange(1, 11)), axis=1)
    clusters = cluster_vertices(frozen_float(points), frozen_int(edges), frozen_float(np.full(10, 0.35)))
    sizes = np.unique(clusters, return_counts=True)[1]
    assert sizes.max() <= 4
    assert len(sizes) < 6


def test_vertices_take_the_label_of_their_first_cell() -> None:
    mesh = samples.squares(3)
    _, space = space_on(mesh, 1)
    found = labels_of_unknowns(space, np.arange(9))
    for v in range(space.n_vertices):
        cells = [c for c in range(9) if v in space.unknowns[space.offsets[c] : space.offsets[c + 1]]]
        assert found[v] == min(cells)


def test_the_cycle_is_symmetric_and_positive_definite() -> None:
    system, stack = stack_on(samples.voronoi(80, seed=FRESH[1]), 2, dtype=np.float64)
    M = cycle(stack) @ np.eye(system.A.shape[0])
    assert np.allclose(M, M.T, atol=1e-10 * np.abs(M).max())
    assert np.linalg.eigvalsh(M).min() > 0.0


@pytest.mark.parametrize("seed", FRESH)
@pytest.mark.parametrize("degree", [1, 2])
def test_few_iterations_on_fresh_meshes(seed: int, degree: int) -> None:
    assert iterations(*stack_on(samples.triangles(16), degree)) <= 14
    assert iterations(*stack_on(samples.voronoi(500, seed=seed), degree)) <= 22
    assert iterations(*stack_on(samples.random_triangles(250, seed=seed), 1)) <= 32


@pytest.mark.parametrize("seed", FRESH)
def test_coefficients_that_jump_by_a_million(seed: int) -> None:
    random = np.random.default_rng(seed)
    for mesh in (samples.voronoi(500, seed=seed), samples.triangles(16), samples.squares(22)):
        away = np.linalg.norm(mesh.cell_centroids - random.random(2), axis=1)
        assert iterations(*stack_on(mesh, 1, np.where(away < 0.3, 1e6, 1.0)), tolerance=1e-4) <= 30
        two = random.choice([1.0, 1e6], mesh.n_cells)
        assert iterations(*stack_on(mesh, 1, two), tolerance=1e-4) <= 60


@pytest.mark.parametrize(("ratio", "most"), [(1e-3, 25), (1e-6, 40)])
def test_boundary_layers(ratio: float, most: int) -> None:
    assert iterations(*stack_on(graded(32, ratio)), "W") <= most


def test_the_choice_by_the_penalty() -> None:
    def chosen(mesh: Mesh, degree: int, kappa: object = 1.0) -> tuple[object, ...]:
        values = np.broadcast_to(kappa, mesh.n_cells).astype(float)
        found = choose(mesh, face_penalty(mesh, degree), values, degree)
        return found.smoother, found.bubbles, found.vertices, found.cycle, found.dtype

    aggregated, classical = ("aggregates", "W"), ("classical", "V")
    single, double = (np.float32,), (np.float64,)
    assert chosen(samples.squares(6), 1) == ("cells", True, *aggregated, *single)
    assert chosen(samples.squares(6), 1, np.geomspace(1, 1e6, 36)) == ("cells", True, *classical, *single)
    assert chosen(samples.squares(6), 1, 10.0 ** np.arange(36)) == ("cells", True, *classical, *double)
    assert chosen(samples.triangles(6), 2) == ("cells", True, *classical, *single)
    assert chosen(samples.hexagons(6), 1) == ("cells", False, *aggregated, *single)
    assert chosen(samples.hexagons(6), 2) == ("cells", False, *classical, *single)
    assert chosen(samples.hexagons(6), 3) == ("patches", False, *classical, *single)
    assert chosen(graded(12, 1e-3), 1) == ("groups", True, *classical, *single)
    assert chosen(graded(12, 1e-3), 2) == ("patches", True, *classical, *single)
    assert choose(samples.squares(6), face_penalty(samples.squares(6), 1), np.ones(36), 1).strong == 0.0
