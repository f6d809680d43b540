"""The paper's smoother and the iterations around cycles, on matrices made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import block_diag
from scipy.sparse.linalg import cg

from agglo_core.multigrid import injection
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
from agglo_core.problems import MultigridLevel
from agglo_core.solvers.residual_measure import ResidualMeasure
from agglo_polydg_mg.paper.schwarz import Schwarz, pcg_steps
from agglo_polydg_mg.paper.stationary import stationary

WIDTH = 2


def spd(n: int, seed: int = 0) -> sparse.bsr_array:
    """A tridiagonal block matrix, positive definite."""
    random = np.random.default_rng(seed)
    strip = sparse.random_array((n, n), density=0.3, rng=random)
    path = sparse.diags_array([-np.ones(n - 1), 2.2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    return sparse.bsr_array(path + 0.05 * (strip @ strip.T), blocksize=(WIDTH, WIDTH))


A = spd(16)
b = np.random.default_rng(1).random(16)
P = injection(np.arange(8) // 2, WIDTH)
COARSE = P.T @ A @ P


def test_pcg_steps_minimise_over_the_krylov_space() -> None:
    x0, weight = np.linspace(0, 1, 16), 1.0 / A.diagonal()
    r = b - A @ x0
    for steps in (1, 3, 5):
        basis = [weight * r]
        for _ in range(steps - 1):
            basis.append(weight * (A @ basis[-1]))
        V = np.linalg.qr(np.array(basis).T)[0]
        wanted = x0 + V @ np.linalg.solve(V.T @ (A @ V), V.T @ r)
        found = pcg_steps(A, b, x0, lambda r: weight * r, steps)
        assert found == pytest.approx(wanted, abs=1e-10)


def test_pcg_steps_leave_a_solution_alone() -> None:
    x = np.arange(16.0)
    assert np.array_equal(pcg_steps(A, A @ x, x, lambda r: r, 3), x)


def test_pcg_steps_refuse_an_indefinite_matrix() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        pcg_steps(-A, b, np.zeros(16), lambda r: r, 3)


def test_one_schwarz_step_is_steepest_descent_with_blocks_and_coarse_space() -> None:
    dense, prolong = A.toarray(), P.toarray()
    blocks = block_diag(*(np.linalg.inv(dense[i : i + 2, i : i + 2]) for i in range(0, 16, 2)))
    B = blocks + prolong @ np.linalg.inv(COARSE.toarray()) @ prolong.T
    correct = prolong @ np.linalg.inv(COARSE.toarray()) @ prolong.T
    parts = np.arange(0, 17, 2), np.arange(8), P
    smooth = Schwarz().setup(MultigridLevel(A, A, *parts, coarse=lambda r: correct @ r, steps=1))
    z = B @ b
    assert smooth(b, np.zeros(16)) == pytest.approx(z * (b @ z) / (z @ dense @ z))


def test_the_stationary_iteration_stops_at_the_tolerance() -> None:
    """Halving every error, the residual decides; with slow modes the energy error does."""
    least = 1e-3 * np.linalg.norm(b)
    halving = stationary(A, b, lambda b, x: x + 0.5 * np.linalg.solve(A.toarray(), b - A @ x), 1e-3, 500)
    assert halving.residuals[-1] <= least < halving.residuals[-2]
    assert halving.residuals[-1] == pytest.approx(np.linalg.norm(b - A @ halving.x))
    assert halving.iterations == len(halving.residuals) - 1 == 10
    history = stationary(A, b, lambda b, x: x + (b - A @ x) / 5.0, 1e-3, 500)
    assert history.residuals[-1] <= least
    for each in (halving, history):
        assert each.converged
        assert (each.reason, each.tests) == ("tolerance met", ("residual", "energy error"))
        assert each.energy_error == pytest.approx(energy_error(each.x), rel=0.01)
        assert each.energy_error <= 1e-3
    before = stationary(A, b, lambda b, x: x + (b - A @ x) / 5.0, 1e-3, history.iterations - 1)
    assert (before.converged, before.tests) == (False, ("residual",))
    assert energy_error(before.x) > 1e-3
    assert "energy error about 1.1e-03 after" in before.reason


def energy_error(x: np.ndarray) -> float:
    """‖x − A⁻¹b‖_A over ‖A⁻¹b‖_A."""
    exact = np.linalg.solve(A.toarray(), b)
    return float(np.sqrt((x - exact) @ (A @ (x - exact)) / (b @ exact)))


def test_what_does_not_converge_is_flagged() -> None:
    slow = stationary(A, b, lambda b, x: x + (b - A @ x) / 50.0, 1e-10, 3)
    assert (slow.converged, slow.iterations) == (False, 3)
    assert "after 3 iterations, required" in slow.reason
    wild = stationary(A, b, lambda b, x: x + 10.0 * (b - A @ x), 1e-10, 100)
    assert not wild.converged
    assert wild.reason.startswith("diverged: residual")
    lost = stationary(A, b, lambda b, x: x * np.nan, 1e-10, 100)
    assert (lost.converged, lost.iterations, lost.x.any()) == (False, 0, False)  # never worse than 0
    assert np.linalg.norm(b - A @ wild.x) == wild.residuals[-1] <= np.linalg.norm(b)


def test_residual_measures_by_hand() -> None:
    """Two cells, κ = 1 and 100; Dirichlet data put 300 into the second, the source 4 into the first."""
    r, b, kappa, load = (np.array(each) for each in ([0.4, 2.0], [4.0, 300.0], [1.0, 100.0], [4.0, 0.0]))
    assert ResidualMeasure(b)(r) == pytest.approx(np.hypot(0.4, 2.0) / np.hypot(4.0, 300.0))
    assert ResidualMeasure(b, kappa, load)(r) == pytest.approx(np.hypot(0.4, 2.0) / np.hypot(4.0, 3.0))
    soft = np.array([0.4, 0.0])
    assert ResidualMeasure(b, kappa)(soft) == pytest.approx(0.4 / np.hypot(4.0, 3.0))  # r / κ against b / κ
    assert ResidualMeasure(0 * b, kappa)(0 * r) == 0.0
    assert ResidualMeasure(0 * b)(r) == np.inf


def test_a_stricter_residual_measure_is_obeyed() -> None:
    measure = ResidualMeasure(b, np.geomspace(1, 1e4, 16), np.zeros(16))
    for history in (
        stationary(A, b, lambda b, x: x + (b - A @ x) / 5.0, 1e-6, 500, measure),
        conjugate_gradients(A, b, 1e-6, measure=measure),
    ):
        assert history.converged
        assert measure(b - A @ history.x) <= 1e-6
        assert history.residuals[-1] < 0.5e-6 * history.residuals[0]  # more than by default


def test_no_right_hand_side_needs_no_iteration() -> None:
    for history in (stationary(A, 0 * b, lambda b, x: x, 1e-6, 9), conjugate_gradients(A, 0 * b)):
        assert (history.converged, history.iterations, history.x.any()) == (True, 0, False)


def test_plain_conjugate_gradients_count_as_scipys() -> None:
    steps: list[int] = []
    x, info = cg(A, b, rtol=1e-8, callback=lambda _: steps.append(1))
    history = conjugate_gradients(A, b, 1e-8)
    assert info == 0
    assert history.converged
    assert history.iterations == len(steps)
    assert history.x == pytest.approx(x)


def test_conjugate_gradients_that_end_early_return_the_smallest_residual() -> None:
    full = conjugate_gradients(A, b, 1e-14, most=8)
    assert not full.converged
    assert full.residuals[-1] == full.residuals.min()
    assert full.reason.startswith("smallest relative residual")
    assert f"in iteration {full.iterations} of 8, required 1.0e-14" in full.reason
    assert np.linalg.norm(b - A @ full.x) == pytest.approx(full.residuals[-1])


def test_conjugate_gradients_that_find_no_better_iterate_say_what_they_did() -> None:
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(
        2.0
    )  # rows of a diagonal matrix are solved one by one
    matrix = sparse.csr_array(turn * np.array([1.0, 1e4]) @ turn.T)
    found = conjugate_gradients(matrix, turn @ np.array([1.0, 0.02]), 1e-9, most=1)
    assert (found.converged, found.iterations, found.x.any()) == (False, 0, False)
    assert "smallest relative residual 1.0e+00 in iteration 0 of 1" in found.reason
    lost = conjugate_gradients(-A, b)
    assert lost.reason.startswith("the matrix is not positive definite: ")
