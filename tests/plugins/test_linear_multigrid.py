"""Linear systems in the default solver: any blocks, near-null vectors, right-hand sides, time steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from flux_matrices import truss, two_point_flux, two_valued
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay

from agglo_core import Graph, Hierarchy, Mesh, OptionError, agglomerate, samples
from agglo_core.multigrid import blockwise, smoothed_near_null
from agglo_core.problems import Diffusion, Linear, Solution
from agglo_core.solvers.solution_report import report
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

SOLVER = PolyDGMultigrid(tolerance=1e-8)


def bare(n: int) -> Hierarchy:
    """A hierarchy without levels of a graph without edges: nothing but a number of cells."""
    graph = Graph.from_arrays(np.zeros(n + 1, np.int64), np.zeros(0, np.int32), np.zeros((n, 2)))
    return Hierarchy(None, graph, [], [], nested=True)


def load(n: int) -> np.ndarray:
    return np.random.default_rng(n).standard_normal(n)


def solved(A: sparse.csr_array, offsets: np.ndarray, hierarchy: Hierarchy, **more: np.ndarray) -> Solution:
    """The solution for a random right-hand side, which must be right."""
    b = load(A.shape[0])
    it = SOLVER.solve(Linear(A, b, offsets, **more), hierarchy)
    assert it.converged
    assert np.linalg.norm(b - A @ it.x) <= 1e-8 * np.linalg.norm(b)
    return it


def triangles(n: int, seed: int) -> tuple[sparse.csr_array, np.ndarray]:
    """Continuous linear elements on triangles between random points, zero on the hull; inner points."""
    points = np.random.default_rng(seed).random((n, 2))
    mesh = Delaunay(points)
    corner = points[mesh.simplices]
    edge = np.roll(corner, 1, axis=1) - np.roll(corner, 2, axis=1)
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    local = np.einsum("tid,tjd->tij", edge, edge) / (4.0 * area)[:, None, None]
    at = (np.repeat(mesh.simplices, 3, axis=1).ravel(), np.tile(mesh.simplices, (1, 3)).ravel())
    A = sparse.csr_array(sparse.coo_array((local.ravel(), at), shape=(n, n)))
    inner = np.setdiff1d(np.arange(n), mesh.convex_hull)
    return sparse.csr_array(A[inner][:, inner]), points[inner]


@pytest.mark.parametrize(("degree", "bound"), [(1, 26), (2, 34)])
def test_its_own_matrices_as_linear_systems(degree: int, bound: int) -> None:
    mesh = samples.voronoi(600, seed=31)
    system = PolyDG(degree, "sharp", scaled_basis=True).assemble(Diffusion(), mesh)
    for hierarchy in (agglomerate(mesh, cells_per_part=(8, 64)), bare(600)):
        it = solved(sparse.csr_array(system.A), system.block_offsets, hierarchy)
        assert it.iterations <= bound


@pytest.mark.parametrize("width", [2, 3])
def test_several_unknowns_in_a_cell(width: int) -> None:
    mesh = samples.voronoi(1500, seed=32)
    coupling = np.eye(width) + 0.3 * (np.ones((width, width)) - np.eye(width))
    A = sparse.csr_array(sparse.kron(two_point_flux(mesh, np.ones(1500)), coupling))
    offsets = np.arange(0, width * 1500 + 1, width)
    assert solved(A, offsets, agglomerate(mesh, cells_per_part=(8, 64))).iterations <= 22
    assert solved(A, offsets, bare(1500)).iterations <= 17


def test_rough_coefficients() -> None:
    mesh = samples.voronoi(2000, seed=33)
    board = np.where(np.floor(mesh.cell_centroids * 8).astype(int).sum(axis=1) % 2, 1e6, 1.0)
    wild = 10.0 ** np.random.default_rng(33).uniform(-3, 3, 2000)
    for kappa in (np.ones(2000), board, two_valued(2000, 33), wild):
        it = SOLVER.solve(
            Linear(two_point_flux(mesh, kappa), mesh.cell_measures, np.arange(2001)), bare(2000)
        )
        assert it.converged
        assert it.iterations <= 30


def test_rigid_motions_are_worth_giving() -> None:
    A, motions = truss(1200, 5)
    held = sparse.csr_array(A + sparse.diags_array(1e-3 * A.diagonal() * (np.arange(2400) < 40)))
    offsets = np.arange(0, 2401, 2)
    with_motions = solved(held, offsets, bare(1200), near_null=motions).iterations
    assert with_motions <= 30
    assert with_motions < solved(held, offsets, bare(1200)).iterations


def test_continuous_elements_in_agglomerates_of_vertices() -> None:
    """The unknowns of a cell are the vertices that lie in it: none, or several."""
    A, points = triangles(3000, 6)
    mesh = samples.squares(30)
    place = np.floor(points * 30).astype(int)
    key = place[:, 1] * 30 + place[:, 0]
    cell_of = np.floor(mesh.cell_centroids * 30).astype(int)
    cell = np.argsort(cell_of[:, 1] * 30 + cell_of[:, 0])[key]
    order = np.argsort(cell, kind="stable")
    offsets = np.append(0, np.cumsum(np.bincount(cell, minlength=900)))
    assert 0 in np.diff(offsets)
    A = sparse.csr_array(A[order][:, order])
    for hierarchy in (agglomerate(mesh, cells_per_part=(8, 64)), bare(900)):
        it = solved(A, offsets, hierarchy)
        assert it.iterations <= 32
        assert it.operator_complexity is not None
        assert it.operator_complexity < 2.0
    with pytest.raises(OptionError, match="the same number of unknowns"):
        PaperMultigrid().solve(Linear(A, load(len(order)), offsets), agglomerate(mesh, n_parts=(100, 10)))


def test_several_right_hand_sides() -> None:
    mesh = samples.squares(20)
    A, at = two_point_flux(mesh, np.ones(400)), np.arange(401)
    b = np.stack([load(400), np.zeros(400), 1e-200 * np.ones(400), 1e6 * mesh.cell_measures], axis=1)
    it = SOLVER.solve(Linear(A, b, at), bare(400))
    alone = [SOLVER.solve(Linear(A, column, at), bare(400)) for column in b.T]
    assert it.converged
    assert it.x.shape == it.b.shape == (400, 4)
    for j, each in enumerate(alone):
        size = np.abs(each.x).max() or 1.0
        assert np.abs(it.x[:, j] - each.x).max() <= 1e-12 * size
    assert it.iterations == max(each.iterations for each in alone) == len(it.residuals) - 1
    assert it.energy_error == pytest.approx(max(each.energy_error or 0.0 for each in alone))
    assert report(mesh, Linear(A, b, at), it)["relative_residual"] <= 1e-8
    one = SOLVER.solve(Linear(A, b[:, :1], at), bare(400))
    assert np.array_equal(one.x, alone[0].x[:, None])


def test_a_column_that_does_not_converge_is_not_hidden() -> None:
    A = two_point_flux(samples.voronoi(900, seed=36), np.ones(900))
    b = np.stack([np.zeros(900), load(900)], axis=1)
    it = PolyDGMultigrid(tolerance=1e-8, max_iterations=3).solve(Linear(A, b, np.arange(901)), bare(900))
    assert not it.converged
    assert it.iterations == 3
    assert it.residuals[-1] == pytest.approx(np.linalg.norm(b[:, 1] - A @ it.x[:, 1]), rel=1e-6)


def test_one_unknown_in_each_cell() -> None:
    """Classical levels, from the matrix or with the agglomerates; one positive near-null vector is kept."""
    mesh = samples.voronoi(3000, seed=37)
    A, at, b = two_point_flux(mesh, np.ones(3000)), np.arange(3001), load(3000)
    hierarchy = agglomerate(mesh, cells_per_part=(8, 64))
    d = 10.0 ** np.random.default_rng(37).uniform(-1, 1, 3000)
    scaled = sparse.csr_array(sparse.diags_array(d) @ A @ sparse.diags_array(d))
    counts = []
    for recipe, problem, words in (
        ("auto", Linear(A, b, at), "classical coarsening, V-cycle"),
        ("agglomerates", Linear(A, b, at), "a classical step, then smoothed aggregation by agglomerates"),
        ("auto", Linear(scaled, b, at), "classical coarsening"),
        ("auto", Linear(scaled, b, at, 1.0 / d), "classical coarsening"),
        ("auto", Linear(A, b, at, -np.ones(3000)), "smoothed aggregation by agglomerates"),
    ):
        it = PolyDGMultigrid(tolerance=1e-8, recipe=recipe).solve(problem, hierarchy)
        assert it.converged
        assert it.choice.startswith(words)
        counts.append(it.iterations)
    assert counts[0] <= 12
    assert counts[1] <= 14
    assert max(counts[2:4]) <= 16
    with pytest.raises(OptionError, match="requires a hierarchy with levels"):
        PolyDGMultigrid(recipe="agglomerates").solve(Linear(A, b, at), bare(3000))
    with pytest.raises(OptionError, match="is for linear systems"):
        PolyDGMultigrid(recipe="agglomerates").solve(Diffusion(), hierarchy)


def test_what_does_not_fit_is_named() -> None:
    A, at, b = sparse.eye_array(4).tocsr(), np.arange(5), np.ones(4)
    for problem, message in (
        (Linear(A, b, at[:-1]), "unknowns in 3 cells, but the hierarchy has 4"),
        (Linear(A, b, np.array([0, 1, 2, 3, 5])), "from 0 to the number of unknowns 4"),
        (Linear(A, np.ones(3), at), r"b must have the shape \(4,\) or \(4, k\)"),
        (Linear(A, b, at, np.ones((3, 1))), r"near_null must have the shape \(4, k\)"),
    ):
        with pytest.raises(OptionError, match=message):
            SOLVER.solve(problem, bare(4))
    with pytest.raises(OptionError, match="is for diffusion problems; for linear systems use"):
        PolyDGMultigrid(recipe="patches").solve(Linear(A, b, at), bare(4))


def test_near_null_vectors_of_files(tmp_path: Path) -> None:
    mesh = samples.squares(3)
    system = Linear.example(mesh)
    B = np.arange(18.0).reshape(9, 2)
    parts = {"data": system.A.data, "indices": system.A.indices, "indptr": system.A.indptr}
    stored = {**parts, "shape": system.A.shape, "format": b"csr"}
    np.savez(tmp_path / "plain.npz", **stored)
    np.savez(tmp_path / "both.npz", **stored, near_null=B)
    np.save(tmp_path / "b.npy", system.b)
    np.save(tmp_path / "B.npy", 2.0 * B)
    for matrix, named, expected in (
        ("plain.npz", {}, None),
        ("both.npz", {}, B),
        ("both.npz", {"near_null": "B.npy"}, 2.0 * B),
        ("plain.npz", {"near_null": "b.npy"}, system.b[:, None]),
    ):
        found = Linear.from_table({"matrix": matrix, "rhs": "b.npy", **named}, mesh, tmp_path).near_null
        assert found is expected or np.array_equal(found, expected)
    np.save(tmp_path / "B.npy", B[1:])
    with pytest.raises(OptionError, match=r"near_null: .* the matrix has 9 rows"):
        Linear.from_table({"matrix": "plain.npz", "rhs": "b.npy", "near_null": "B.npy"}, mesh, tmp_path)


def test_smoothing_of_near_null_vectors() -> None:
    """Against dense sweeps; what A takes to zero stays."""
    A, motions = truss(30, 7)
    offsets = np.arange(0, 61, 2)
    kept = smoothed_near_null(A, offsets, motions)
    assert np.abs(kept - motions).max() < 1e-10
    dense, x = A.toarray(), np.arange(60) % 2 == 1.0
    expected = x.astype(float)
    for part in (*range(30), *reversed(range(30))):
        own = slice(2 * part, 2 * part + 2)
        expected[own] -= np.linalg.solve(dense[own, own], dense[own] @ expected)
    assert np.abs(smoothed_near_null(A, offsets, sweeps=1)[:, 1] - expected).max() < 1e-10
    uneven = np.array([0, 1, 4, 60])
    assert smoothed_near_null(A + sparse.eye_array(60), uneven, sweeps=0).tolist() == [[1.0]] * 60


def test_block_sweeps_are_mirror_images() -> None:
    A = sparse.csr_array(truss(20, 8)[0] + sparse.eye_array(40))
    smoother = blockwise(A, np.array([0, 3, 4, 20, 40]), np.float64)
    before = np.stack([smoother.before(each)[0] for each in np.eye(40)], axis=1)
    after = np.stack([smoother.after(each, np.zeros(40)) for each in np.eye(40)], axis=1)
    assert np.abs(before - after.T).max() < 1e-12


def steps_of(mesh: Mesh, count: int, rate: float) -> list[Diffusion]:
    x = mesh.cell_centroids[:, 0]
    return [Diffusion(kappa=1.0 + rate * k * x, source=1.0 + 0.1 * k) for k in range(count)]


def test_twenty_time_steps_need_few_levels_and_few_more_iterations() -> None:
    mesh = samples.voronoi(300, seed=34)
    hierarchy = agglomerate(mesh, cells_per_part=(8, 64))
    steps = SOLVER.repeated(hierarchy)
    problems = steps_of(mesh, 20, 0.05)
    fresh = [SOLVER.solve(each, hierarchy) for each in problems]
    kept = [steps.solve(each) for each in problems]
    assert all(each.converged for each in kept)
    for one, other in zip(kept, fresh, strict=True):
        assert np.abs(one.x - other.x).max() <= 1e-6 * np.abs(other.x).max()
    assert steps.setups <= 4
    assert sum(each.iterations for each in kept) <= 1.5 * sum(each.iterations for each in fresh)
    assert "levels reused from an earlier system" in kept[1].choice
    assert "levels reused from an earlier system" not in kept[0].choice


def test_levels_that_no_longer_serve_are_renewed() -> None:
    mesh = samples.voronoi(800, seed=35)
    smooth, rough = (two_point_flux(mesh, kappa) for kappa in (np.ones(800), two_valued(800, 35)))
    b, at = mesh.cell_measures, np.arange(801)
    steps = SOLVER.repeated(bare(800))
    for A in (smooth, rough, rough, rough):
        it = steps.solve(Linear(A, b, at))
        assert it.converged
        assert np.linalg.norm(b - A @ it.x) <= 1e-8 * np.linalg.norm(b)
        assert len(it.residuals) == it.iterations + 1
    assert 2 <= steps.setups <= 3
    assert it.iterations <= SOLVER.solve(Linear(rough, b, at), bare(800)).iterations
    small = steps.solve(Linear(smooth[:50, :50], b[:50], np.append(np.arange(51), np.full(750, 50))))
    assert np.allclose(small.x, spsolve(sparse.csc_array(smooth[:50, :50]), b[:50]), rtol=1e-6)


def test_steps_after_a_matrix_that_is_not_definite() -> None:
    A = two_point_flux(samples.squares(12), np.ones(144))
    steps, at, b = SOLVER.repeated(bare(144)), np.arange(145), np.ones(144)
    counts = []
    for matrix in (A, A - 1.0 * sparse.eye_array(144), A):
        it = steps.solve(Linear(sparse.csr_array(matrix), b, at))
        counts.append((it.converged, it.iterations))
    assert counts[0][0]
    assert not counts[1][0]
    assert counts[2] == counts[0]
