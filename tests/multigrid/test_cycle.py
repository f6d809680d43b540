"""Cycles: symmetry, exactness, and the difference of their kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import cg, splu

from agglo_core.errors import OptionError
from agglo_core.multigrid import Level, LevelStack, cycle


class Damped:
    """Jacobi, damped."""

    def __init__(self, A: sparse.csr_array) -> None:
        self.A, self.inverse = A, 0.6 / A.diagonal()

    def before(self, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = self.inverse * b
        return x, b - self.A @ x

    def after(self, b: np.ndarray, x: np.ndarray) -> np.ndarray:
        return x + self.inverse * (b - self.A @ x)


def line_stack(n: int, coarsest: int = 4) -> LevelStack:
    """Levels of the Laplacian of a path, two cells to a part."""
    A = sparse.csr_array(sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)))
    levels = []
    while A.shape[0] > coarsest:
        m = A.shape[0]
        P = sparse.csr_array((np.ones(m), (np.arange(m), np.arange(m) // 2)))
        levels.append(Level(A, np.arange(m + 1), P, Damped(A)))
        A = sparse.csr_array(P.T @ A @ P)
    levels.append(Level(A, np.arange(A.shape[0] + 1)))
    return LevelStack(levels, splu(A.tocsc()).solve)


@pytest.mark.parametrize("kind", ["V", "W"])
def test_a_cycle_is_a_symmetric_positive_definite_operator(kind: str) -> None:
    stack = line_stack(64)
    M = cycle(stack, kind) @ np.eye(64)
    assert np.allclose(M, M.T, atol=1e-12)
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_more_work_converges_faster() -> None:
    stack = line_stack(256)
    A = stack.levels[0].A.toarray()
    rho = {
        kind: np.abs(np.linalg.eigvals(np.eye(256) - (cycle(stack, kind) @ np.eye(256)) @ A)).max()
        for kind in ("V", "F", "W")
    }
    assert rho["W"] < rho["F"] < rho["V"] < 1.0


def test_two_visits_to_every_level_are_the_w_cycle() -> None:
    stack = line_stack(64)
    twice = replace(stack, levels=[replace(level, visits=2) for level in stack.levels])
    first = replace(stack, levels=[stack.levels[0], replace(stack.levels[1], visits=2), *stack.levels[2:]])
    M, W, V = (cycle(each, kind) @ np.eye(64) for each, kind in ((twice, "V"), (stack, "W"), (first, "V")))
    assert np.array_equal(M, W)
    assert np.allclose(V, V.T, atol=1e-12)
    assert not np.allclose(V, W)


def test_the_k_cycle_needs_fewer_iterations_than_v() -> None:
    stack, b = line_stack(512), np.ones(512)
    A = stack.levels[0].A
    used = {}
    for kind in ("V", "K"):
        seen: list[float] = []
        cg(A, b, rtol=1e-8, M=cycle(stack, kind), callback=lambda x, seen=seen: seen.append(0.0))
        used[kind] = len(seen)
    assert used["K"] < used["V"]


def test_two_levels_are_what_the_formula_says() -> None:
    stack = line_stack(8)
    A, P, w = stack.levels[0].A.toarray(), stack.levels[0].P.toarray(), stack.levels[0].smoother.inverse
    smooth = np.eye(8) - w[:, None] * A
    correct = np.eye(8) - P @ np.linalg.inv(P.T @ A @ P) @ P.T @ A
    M = cycle(stack) @ np.eye(8)
    assert np.allclose(np.eye(8) - M @ A, smooth @ correct @ smooth, atol=1e-12)


def test_single_precision_inside_and_any_size_of_residual() -> None:
    stack = line_stack(32)
    single = LevelStack(
        [Level(L.A.astype(np.float32), L.block_offsets, L.P, L.smoother) for L in stack.levels],
        stack.coarse,
        np.float32,
    )
    b = np.linspace(1.0, 2.0, 32)
    for size in (1e-200, 1.0, 1e200):
        assert np.allclose(cycle(single) @ (size * b) / size, cycle(stack) @ b, rtol=1e-5)
    assert not (cycle(stack) @ np.zeros(32)).any()


def test_complexities() -> None:
    stack = line_stack(16)
    assert stack.grid_complexity == (16 + 8 + 4) / 16
    assert stack.operator_complexity == (46 + 22 + 10) / 46
    assert [A.shape[0] for A, _ in stack.operators] == [16, 8, 4]


def test_another_kind_is_refused() -> None:
    with pytest.raises(OptionError, match="V, W, F, K; given 'X'"):
        cycle(line_stack(8), "X")  # type: ignore[arg-type]
