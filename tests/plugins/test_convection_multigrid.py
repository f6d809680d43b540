"""The default solver for problems with convection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse

import agglo_core as agglo
from agglo_core import Mesh, OptionError, agglomerate, samples
from agglo_core.arrays import Float
from agglo_core.multigrid import OrderedGaussSeidel, gcr, paired_levels
from agglo_core.problems import Diffusion, Patches
from agglo_polydg_mg.auxiliary.downstream import downstream_order
from agglo_polydg_mg.forms.convection import face_flows
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

EAST = np.array([1.0, 0.3])


def rotation(x: Float) -> Float:
    return np.stack((-x[:, 1], x[:, 0]), axis=1)


def swirl(x: Float) -> Float:
    return rotation(x - 0.5)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("b", "most"), [(EAST, 12), (rotation, 12), (swirl, 30)])
@pytest.mark.parametrize(
    "peclet",
    [0.1, pytest.param(1.0, marks=pytest.mark.slow), 10.0, pytest.param(1e2, marks=pytest.mark.slow), 1e4],
)
@pytest.mark.parametrize(
    "mesh",
    [
        samples.voronoi(900, seed=7),
        samples.random_triangles(450, seed=7),
        pytest.param(samples.voronoi(2000, seed=7), marks=pytest.mark.slow),
        pytest.param(samples.random_triangles(1000, seed=7), marks=pytest.mark.slow),
    ],
)
def test_iterations_are_few_for_all_peclet_numbers(
    degree: int, b: Any, most: int, peclet: float, mesh: Mesh
) -> None:
    problem = Diffusion(mesh.n_cells**-0.5 / peclet, convection=b)
    solution = agglo.solve(mesh, problem, degree=degree)
    assert solution.converged
    assert solution.iterations <= most
    assert np.linalg.norm(solution.b - solution.A @ solution.x) <= 1.1e-6 * np.linalg.norm(solution.b)
    assert solution.energy_error is None
    assert solution.tests == ("residual",)


@pytest.mark.parametrize(
    ("mesh", "b", "peclet"),
    [
        (samples.voronoi(700, seed=3), EAST, 10.0),
        (samples.voronoi(700, seed=3), swirl, 10.0),
        (samples.random_triangles(700, seed=3), rotation, 100.0),
        (samples.squares(9), EAST, 1e4),
        (samples.voronoi3d(200, seed=1), np.array([1.0, 0.3, -0.2]), 30.0),
    ],
)
def test_solutions_equal_those_of_direct(mesh: Any, b: Any, peclet: float) -> None:
    def g(x: Float) -> Float:
        return 5.0 + x[:, 0]

    kappa = mesh.n_cells ** (-1 / mesh.dim) / peclet
    problem = Diffusion(kappa, convection=b, dirichlet={0: g})
    found = agglo.solve(mesh, problem, tolerance=1e-10)
    exact = agglo.solve(mesh, problem, solver="direct", tolerance=1e-10, penalty="sharp", scaled_basis=True)
    assert found.converged
    assert exact.converged
    assert found.x == pytest.approx(exact.x, abs=1e-6 * np.abs(exact.x).max())


@pytest.mark.parametrize("method", ["kmeans", "coordinate"])
def test_given_levels_serve(method: str) -> None:
    mesh = samples.voronoi(900, seed=4)
    hierarchy = agglomerate(mesh, bisector=method, n_parts=(150, 30))
    solution = agglo.solve(hierarchy, Diffusion(1e-2, convection=EAST))
    assert solution.converged
    assert solution.parts == (900, 150, 30)
    for cycle in ("W", "F"):
        assert agglo.solve(hierarchy, Diffusion(1e-2, convection=EAST), cycle=cycle).converged


def test_steps_with_changing_flow_equal_single_solves() -> None:
    mesh = samples.voronoi(600, seed=5)
    steps = PolyDGMultigrid(tolerance=1e-9).repeated(agglo.agglomerate(mesh, n_parts=(100, 20)))
    problems = [Diffusion(1e-2, 1.0 + k, convection=EAST) for k in range(3)]
    problems += [Diffusion(1e-2), Diffusion(1e-2, convection=-EAST), Diffusion(1e-2, convection=EAST)]
    for problem in problems:
        found = steps.solve(problem)
        single = agglo.solve(mesh, problem, tolerance=1e-9)
        assert found.converged
        assert found.x == pytest.approx(single.x, abs=1e-6 * np.abs(single.x).max())
    assert steps.setups >= 3


@pytest.mark.parametrize("name", ["recipe=conforming", "recipe=patches", "cycle=K", "precision=single"])
def test_options_for_symmetric_matrices_are_refused(name: str) -> None:
    key, value = name.split("=")
    with pytest.raises(OptionError, match=f"{key} '{value}' requires a symmetric matrix"):
        agglo.solve(samples.squares(4), Diffusion(convection=EAST), **{key: value})


def test_no_preconditioner_for_conjugate_gradients() -> None:
    hierarchy = agglomerate(samples.squares(4), n_parts=4)
    with pytest.raises(OptionError, match="not symmetric, but aspreconditioner requires a symmetric matrix"):
        PolyDGMultigrid().aspreconditioner(Diffusion(convection=EAST), hierarchy)


def test_the_outcome_is_honest_after_too_few_iterations() -> None:
    mesh = samples.voronoi(900, seed=4)
    solution = agglo.solve(mesh, Diffusion(1e-2, convection=swirl), max_iterations=2)
    assert not solution.converged
    assert solution.iterations == 2
    assert "after 2 iterations, required 1.0e-06" in solution.reason


@pytest.mark.parametrize("b", [EAST, -EAST, rotation])
def test_cells_follow_those_upstream(b: Any) -> None:
    mesh = samples.voronoi(400, seed=2)
    flows = face_flows(mesh, b)
    order = downstream_order(mesh, flows)
    assert sorted(order.tolist()) == list(range(400))
    turn = np.argsort(order)
    inner = mesh.face_cells[:, 1] >= 0
    first, second = turn[mesh.face_cells[inner]].T
    against = np.where(flows[inner] > 0.0, first > second, second > first)
    assert np.abs(flows[inner])[against].sum() <= 1e-9 * np.abs(flows).sum()


@pytest.mark.parametrize("b", [EAST, swirl, np.zeros(2)])
def test_order_equals_that_of_repeated_searches(b: Any) -> None:
    mesh = samples.voronoi(150, seed=2)
    flows = face_flows(mesh, b)
    dense = np.zeros((150, 150))  # flow from row to column
    for (i, j), flow in zip(mesh.face_cells, flows, strict=True):
        if j >= 0:
            dense[(i, j) if flow > 0.0 else (j, i)] += abs(flow)
    whole, remaining, order = dense.sum(axis=0), dense.sum(axis=0), []
    shares = np.divide(remaining, whole, out=np.zeros(150), where=whole > 0.0)
    for _ in range(150):
        order.append(int(np.argmin(shares)))
        remaining -= dense[order[-1]]
        later = np.divide(remaining, whole, out=np.zeros(150), where=whole > 0.0)
        shares = np.where(later > 1e-9, later, 0.0)
        shares[order] = np.inf
    assert downstream_order(mesh, flows).tolist() == order


def test_few_flows_go_against_the_order_where_streamlines_are_closed() -> None:
    mesh = samples.voronoi(900, seed=2)
    flows = face_flows(mesh, swirl)
    turn = np.argsort(downstream_order(mesh, flows))
    inner = mesh.face_cells[:, 1] >= 0
    first, second = turn[mesh.face_cells[inner]].T
    against = np.where(flows[inner] > 0.0, first > second, second > first)
    assert np.abs(flows[inner])[against].sum() < 0.2 * np.abs(flows[inner]).sum()


@pytest.mark.parametrize("width", [1, 3, 6])
@pytest.mark.parametrize("patches", [[[2], [0], [4], [1], [3]], [[3, 1, 2], [0], [1, 4]], [[0, 1], [2, 1]]])
def test_sweeps_equal_block_substitution(width: int, patches: list[list[int]]) -> None:
    rng = np.random.default_rng(0)
    dense = rng.normal(size=(5 * width, 5 * width)) + 10.0 * width * np.eye(5 * width)
    b, x = rng.normal(size=(2, 5 * width))
    offsets = np.cumsum([0, *map(len, patches)])
    given = Patches(offsets, np.concatenate(patches))
    found = OrderedGaussSeidel(sparse.csr_array(dense), width, given).after(b, x)
    for patch in patches:
        rows = (np.array(patch)[:, None] * width + np.arange(width)).ravel()
        x[rows] += np.linalg.solve(dense[np.ix_(rows, rows)], (b - dense @ x)[rows])
    assert found == pytest.approx(x, abs=1e-12)


def test_a_singular_patch_is_named() -> None:
    A = sparse.csr_array(np.array([[2.0, 1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]]))
    with pytest.raises(np.linalg.LinAlgError, match=r"singular on the parts \[1, 2\]"):
        OrderedGaussSeidel(A, 1, Patches(np.array([0, 1, 3]), np.array([0, 1, 2])))


def test_agglomerates_follow_the_flow() -> None:
    mesh = samples.squares(16)
    along = np.abs(face_flows(mesh, np.array([1.0, 0.01])))
    inner = mesh.face_cells[:, 1] >= 0
    ends, strength = mesh.face_cells[inner], along[inner]
    first, second = paired_levels(ends, strength, 256, 16)
    for labels, width in ((first, 4), (second, 16)):
        assert np.bincount(labels).tolist() == [width] * (256 // width)
        for part in range(256 // width):
            assert np.ptp(mesh.cell_centroids[labels == part, 1]) == 0.0
    assert len(paired_levels(ends, strength, 256, 256)) == 1
    assert len(paired_levels(ends, strength, 256, 16, count=2)) == 1
    assert paired_levels(ends[:3], strength[:3], 49, 16) == []


def test_residuals_are_those_of_gmres() -> None:
    rng = np.random.default_rng(1)
    dense, b = rng.normal(size=(12, 12)) + 4.0 * np.eye(12), rng.normal(size=12)
    history = gcr(
        sparse.csr_array(dense), b, lambda r: r, tolerance=1e-10, measure=lambda r: float(np.linalg.norm(r))
    )
    assert history.converged
    krylov = np.stack([np.linalg.matrix_power(dense, k) @ b for k in range(1, 6)], axis=1)
    for k in range(1, 6):
        y = np.linalg.lstsq(krylov[:, :k], b)[0]
        assert history.residuals[k] == pytest.approx(np.linalg.norm(b - krylov[:, :k] @ y), rel=1e-6)


def test_stagnation_is_reported() -> None:
    shift = sparse.csr_array(np.roll(np.eye(4), 1, axis=0))  # GMRES gains nothing before the last step
    history = gcr(
        shift, np.eye(4)[0], lambda r: np.zeros(4), measure=lambda r: float(np.linalg.norm(r)), most=50
    )
    assert not history.converged
    assert history.ended == "stagnation"


def test_levels_of_a_system_equal_the_rediscretised_matrices() -> None:
    mesh = samples.voronoi(600, seed=6)
    hierarchy = agglomerate(mesh, n_parts=(60,))
    problem = Diffusion(1e-2, convection=EAST)
    solution = PolyDGMultigrid().solve(problem, hierarchy)
    coarse = solution.operators[1][0]
    expected = PolyDG().coarse_operator(problem, mesh, hierarchy.levels[0])
    assert abs(coarse - expected).max() <= 1e-12 * abs(expected).max()
