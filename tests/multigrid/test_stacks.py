"""Stacks built from a matrix and prolongations, and the solvers of their coarsest level."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from multigrid.random_systems import mesh_matrix, random_system
from scipy import sparse
from scipy.sparse.linalg import cg

from agglo_core import samples
from agglo_core.errors import OptionError
from agglo_core.multigrid import (
    COARSE_SOLVERS,
    SMOOTHERS,
    Composition,
    additive_schwarz,
    build_stack,
    coarse_solver,
    cycle,
    direct_solver,
    galerkin,
    injection,
)
from agglo_core.problems import MultigridLevel, Patches, System


class Halved:
    """Half a step of Jacobi."""

    def setup(self, level: MultigridLevel) -> _HalvedStep:
        return _HalvedStep(level.A)


class _HalvedStep:
    def __init__(self, A: sparse.csr_array) -> None:
        self.A = A

    def __call__(self, b: np.ndarray, x: np.ndarray) -> np.ndarray:
        return x + 0.5 * (b - self.A @ x) / self.A.diagonal()


class Inverse:
    def solver_for(self, A: sparse.csr_array) -> Any:
        return np.linalg.inv(A.toarray()).__matmul__


@pytest.mark.parametrize("width", [1, 3])
def test_galerkin_products_of_blocks_and_of_rows_agree(width: int) -> None:
    A, P = random_system(12 * width), injection([0, 2, 1, 1, 0, 2, 2, 2, 0, 3, 3, 1], width)
    assert P.toarray().sum(axis=1) == pytest.approx(1.0)
    wanted = P.T.toarray() @ A.toarray() @ P.toarray()
    blocks = galerkin(sparse.bsr_array(A, blocksize=(width, width)), P)
    assert blocks.format == "bsr"
    assert blocks.toarray() == pytest.approx(wanted)
    assert galerkin(A, P).toarray() == pytest.approx(wanted)
    assert galerkin(A, P.tocsc()).toarray() == pytest.approx(wanted)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("smoother", SMOOTHERS)
def test_cycles_of_three_levels_precondition_conjugate_gradients(smoother: str, dtype: type) -> None:
    A, b = mesh_matrix(400, 3), np.random.default_rng(20261122).standard_normal(1200)
    P = [injection(np.arange(400) // 4, 3), injection(np.arange(100) // 5, 3)]
    stack = build_stack(A, np.arange(0, 1201, 3), P, smoother, dtype=dtype)
    assert [level.A.shape[0] for level in stack.levels] == [1200, 300, 60]
    assert {level.A.dtype for level in stack.levels} == {np.dtype(dtype)}
    M = cycle(stack)
    u, v = np.random.default_rng(20261122).standard_normal((2, 1200))
    assert u @ (M @ v) == pytest.approx(v @ (M @ u), rel=1e-9 if dtype is np.float64 else 1e-2, abs=1e-2)
    counts = []
    for preconditioner in (None, M):
        seen: list[int] = []
        x, info = cg(
            A, b, rtol=1e-8, M=preconditioner, maxiter=2000, callback=lambda x, seen=seen: seen.append(0)
        )
        assert info == 0
        counts.append(len(seen))
    assert np.linalg.norm(b - A @ x) < 1e-7 * np.linalg.norm(b)
    assert counts[1] < 0.6 * counts[0]


def test_coarse_levels_are_inherited_with_their_parts() -> None:
    seen: list[MultigridLevel] = []

    class Watches:
        def setup(self, level: MultigridLevel):
            seen.append(level)
            return lambda b, x: x + 0.1 * (b - level.A @ x)

    A = random_system(12)
    P = [injection([0, 0, 1, 1], 3), sparse.csr_array(np.random.default_rng(20261122).random((6, 2)))]
    labels = [np.arange(4), np.array([0, 0, 1, 1]), np.zeros(4, int)]
    patches = [Patches(np.array([0, 2]), np.array([0, 1])), None]
    stack = build_stack(A, np.arange(0, 13, 3), P, Watches(), labels=labels, patches=patches, steps=3)
    inherited = P[0].T.toarray() @ A.toarray() @ P[0].toarray()
    assert seen[1].A.toarray() == pytest.approx(inherited)
    assert stack.levels[2].A.toarray() == pytest.approx(P[1].T.toarray() @ inherited @ P[1].toarray())
    assert [level.block_offsets.tolist() for level in stack.levels] == [
        [0, 3, 6, 9, 12],
        [0, 3, 6],
        [0, 1, 2],
    ]
    assert [level.steps for level in seen] == [3, 3]
    assert [level.patches for level in seen] == patches
    assert [level.labels.tolist() for level in stack.levels] == [each.tolist() for each in labels]
    given = [np.array([0, 6, 12]), np.array([0, 1, 6]), np.array([0, 2])]
    stack = build_stack(A, given, P, Watches())
    assert [level.block_offsets.tolist() for level in stack.levels] == [each.tolist() for each in given]


def test_a_single_level_is_solved_directly() -> None:
    A = random_system(10)
    b = np.random.default_rng(20261122).standard_normal(10)
    assert cycle(build_stack(A, np.arange(11), [])) @ b == pytest.approx(np.linalg.solve(A.toarray(), b))


def test_what_does_not_fit_is_refused() -> None:
    A, P = random_system(12), [injection(np.arange(12) // 2)]
    with pytest.raises(OptionError, match=r"prolongation 0 has shape \(6, 3\)"):
        build_stack(A, np.arange(13), [injection(np.arange(6) // 2)])
    with pytest.raises(OptionError, match="block_offsets are given for 1 levels, but 1 prolongations make 2"):
        build_stack(A, [np.arange(13)], P)
    with pytest.raises(OptionError, match="labels must be given for each of 2 levels; given 1"):
        build_stack(A, np.arange(13), P, labels=[np.arange(12)])
    bad = -1.0 * A
    with pytest.raises(np.linalg.LinAlgError, match=r"level 0: .* part 0"):
        build_stack(bad, np.arange(13), P)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", [*COARSE_SOLVERS, "own"])
def test_coarse_solvers_solve(name: str, dtype: type) -> None:
    A = random_system(40)
    scaled = sparse.diags_array(10.0 ** np.linspace(-6, 6, 40))
    A, b = sparse.csr_array(scaled @ A @ scaled), np.random.default_rng(20261122).standard_normal(40)
    b = scaled @ b
    given = name if name != "own" else lambda A: lambda b: np.linalg.solve(A.toarray(), b)
    x = coarse_solver(given, A, dtype)(b.astype(dtype))
    assert x.dtype == dtype
    wanted = scaled @ np.linalg.solve(A.toarray(), b)
    assert scaled @ x == pytest.approx(
        wanted, abs=(1e-9 if dtype is np.float64 else 1e-3) * abs(wanted).max()
    )


def test_a_semidefinite_matrix_is_solved_up_to_its_kernel() -> None:
    mesh = mesh_matrix(30)
    A = sparse.csr_array(mesh - sparse.diags_array(mesh.sum(axis=1)))  # constants cost nothing
    b = np.random.default_rng(20261122).standard_normal(30)
    b -= b.mean()
    x = coarse_solver("dense", A)(b)
    assert A @ x == pytest.approx(b, abs=1e-9)
    assert abs(x).max() < 1e6
    zero = sparse.csr_array(np.diag([0.0, 2.0]))
    assert coarse_solver("dense", zero)(np.array([1.0, 1.0])).tolist() == [0.0, 0.5]


def test_coarse_matrices_that_cannot_be_solved_are_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="eigenvalue"):
        coarse_solver("dense", sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(np.linalg.LinAlgError, match="negative diagonal"):
        coarse_solver("dense", sparse.csr_array([[-1.0]]))
    with pytest.raises(np.linalg.LinAlgError, match="2 unknowns is singular"):
        coarse_solver("lu", sparse.csr_array([[1.0, 1.0], [1.0, 1.0]]))
    with pytest.raises(OptionError, match=r"6000 unknowns are too many .* use coarse=lu"):
        coarse_solver("dense", sparse.eye_array(6000))
    with pytest.raises(OptionError, match="one of dense, elimination, lu, or a function"):
        coarse_solver("qr", sparse.eye_array(2))
    with pytest.raises(OptionError, match="expected a function of b"):
        coarse_solver(lambda A: None, sparse.eye_array(2))  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize("coarse", [*COARSE_SOLVERS, direct_solver])
@pytest.mark.parametrize("smoother", [*SMOOTHERS, Halved()])
def test_stacks_and_cycles_can_be_pickled(smoother: Any, coarse: Any) -> None:
    A, b = mesh_matrix(60, 3), np.arange(180.0) - 50.0
    stack = build_stack(A, np.arange(0, 181, 3), [injection(np.arange(60) // 4, 3)], smoother, coarse)
    x = cycle(stack) @ b
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(cycle(stack, "V"))) @ b, x)
    np.testing.assert_array_equal(cycle(pickle.loads(pickle.dumps(stack))) @ b, x)
    scaled = replace(stack, scaling=sparse.diags_array(np.full(180, 2.0)).tobsr((3, 3)))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(cycle(scaled, "W"))) @ b, cycle(scaled, "W") @ b)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-4)])
def test_a_dense_solve_is_row_by_row_for_vectors_and_columns(dtype: Any, tolerance: float) -> None:
    A = sparse.csr_array(mesh_matrix(200, 1) + sparse.eye_array(200))
    solve: Any = direct_solver(A, dtype)
    assert solve.inverse.flags.c_contiguous  # rows are read at full speed
    b = np.stack([np.arange(200) - 99.5, np.ones(200)], axis=1).astype(dtype)
    exact = np.linalg.solve(A.toarray(), b.astype(np.float64))
    for found, expected in ((solve(b), exact), (solve(b[:, 0]), exact[:, 0])):
        assert found.dtype == dtype
        np.testing.assert_allclose(found, expected, atol=tolerance * abs(exact).max())


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_sparse_factors_are_made_again_when_they_are_unpickled(shift: float) -> None:
    """Of a matrix that is singular, and of one that is not."""
    A = sparse.csr_array(mesh_matrix(200, 1) * 1.0)
    A = sparse.csr_array(sparse.diags_array(A.diagonal() - A.sum(axis=1) + shift) + A)
    solve, b = direct_solver(A, dense=0), np.arange(200.0) - 99.5
    np.testing.assert_allclose(A @ solve(b), b, atol=1e-7)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(solve))(b), solve(b))


def test_compositions_and_domain_decompositions_can_be_pickled() -> None:
    mesh = samples.squares(8)
    A = sparse.csr_array(sparse.diags_array(mesh.graph.to_scipy().sum(axis=1) + 0.1) - mesh.graph.to_scipy())
    b, labels = np.arange(64.0), np.arange(64) // 4
    for smoother in ("vertex_patches", "schwarz"):
        parts = Composition(smoother=smoother, coarse_solver=Inverse())
        M = cycle(parts.stack(System(A, b, mesh=mesh), [labels]))
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(M)) @ b, M @ b)
    M = additive_schwarz(A, None, labels)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(M)) @ b, M @ b)
