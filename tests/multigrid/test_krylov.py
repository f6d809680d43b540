"""Preconditioned conjugate gradients: what they compute, what they claim, how they break down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from random_systems import in_single_precision, random_system
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from agglo_core.errors import OptionError
from agglo_core.multigrid import pcg, pcg_columns
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
from agglo_core.problems.iteration_history import TESTS, History
from agglo_core.problems.residuals.backward_error import LIMIT, backward_error, explain_end

N = 40
RANDOM = np.random.default_rng(11)
Q = np.linalg.qr(RANDOM.normal(size=(N, N)))[0]
EIGENVALUES = np.geomspace(1e-4, 1.0, N)
A = (Q * EIGENVALUES) @ Q.T
A = (A + A.T) / 2
b = RANDOM.normal(size=N)
X = np.linalg.solve(A, b)


def energy_error(x: np.ndarray) -> float:
    return float(np.sqrt((x - X) @ A @ (x - X) / (b @ X)))


def inverse(noise: float, seed: int = 3) -> np.ndarray:
    """A⁻¹ with eigenvalues off by some factors."""
    return (Q * np.exp(noise * np.random.default_rng(seed).normal(size=N)) / EIGENVALUES) @ Q.T


def claims_of(seed: int) -> int:
    """Iterations beyond the first iterate that was right; −1 if converged was not said."""
    case, seen = random_system(seed), []
    beta = "flexible" if seed // 10 % 2 else "fletcher-reeves"
    elimination, size = np.linalg.inv(case.A), float(np.sqrt(case.b @ case.x.astype(float)))

    def measure(r: np.ndarray) -> float:
        seen.append(float(np.sqrt(abs(r @ elimination @ r))) / size)
        return float(np.linalg.norm(r) / np.linalg.norm(case.b))

    found = pcg(case.A, case.b, case.M, tolerance=case.tolerance, most=3000, beta=beta, measure=measure)
    assert found.converged == (found.ended == "met")
    if not found.converged:
        assert f"required {case.tolerance:.1e}" in found.reason
        return -1
    assert case.energy_error(found.x) <= case.tolerance, case.quality
    assert found.energy_error <= case.tolerance
    assert "energy error" in found.tests
    right = [at for at, error in enumerate(seen) if error <= case.tolerance]
    return max(0, found.iterations - min(right, default=found.iterations))


def test_what_is_called_converged_is_right() -> None:
    further = [claims_of(seed) for seed in range(3000, 3020)]
    assert sum(each >= 0 for each in further) >= 12


@pytest.mark.slow
def test_what_is_called_converged_is_right_on_two_hundred_systems() -> None:
    """With the further iterations that it takes to know: the median of those that converge."""
    further = np.array([claims_of(seed) for seed in range(4000, 4200)])
    assert (further >= 0).sum() >= 140
    assert np.median(further[further >= 0]) <= 2


@pytest.mark.parametrize("beta", ["flexible", "fletcher-reeves"])
def test_iterates_are_those_of_scipy(beta: str) -> None:
    M, seen = inverse(0.3), []
    cg(A, b, rtol=0.0, atol=0.0, M=M, maxiter=12, callback=lambda x: seen.append(x.copy()))
    for steps in (1, 5, 12):
        found = pcg(A, b, M, tolerance=1e-14, most=steps, beta=beta)
        assert found.ended == "most iterations"
        assert found.iterations == steps
        assert found.x == pytest.approx(seen[steps - 1], rel=1e-6)
        assert found.residuals[-1] == pytest.approx(np.linalg.norm(b - A @ found.x), rel=1e-8)


def test_the_energy_error_is_bounded_closely_if_the_preconditioner_is_good() -> None:
    for tolerance in (1e-3, 1e-6, 1e-9):
        found = pcg(A, b, inverse(0.4), tolerance=tolerance)
        assert found.converged
        assert energy_error(found.x) <= found.energy_error <= 3 * energy_error(found.x)
        assert found.relative_residual == pytest.approx(
            np.linalg.norm(b - A @ found.x) / np.linalg.norm(b), rel=1e-6
        )
    exact = pcg(A, b, np.linalg.inv(A), tolerance=1e-8)
    assert (exact.converged, exact.iterations) == (True, 1)


def test_each_test_may_stop_alone_and_all_are_reported() -> None:
    """Of few large eigenvalues the residual is large long after the error is small, and the other way."""
    M = inverse(0.4)
    found = {stop: pcg(A, b, M, tolerance=1e-6, stop=stop) for stop in ("energy", "residual", "both")}
    assert all(each.converged for each in found.values())
    assert found["energy"].energy_error <= 1e-6
    assert found["residual"].relative_residual <= 1e-6
    assert found["both"].tests == TESTS
    assert found["both"].iterations >= max(found["energy"].iterations, found["residual"].iterations)
    smooth = A @ (A @ b)  # no energy in slow modes beside large ones
    early = pcg(A, smooth, None, tolerance=1e-2, stop="residual")
    assert "residual" in early.tests


def test_columns_are_iterated_each_on_its_own() -> None:
    B = np.stack([b, np.zeros(N), 1e6 * np.ones(N), A @ b], axis=1)
    start = np.stack([0 * b, b, b, -b], axis=1)
    M = inverse(0.3)
    for operator in (M, LinearOperator((N, N), matvec=lambda r: M @ r.ravel(), dtype=float), lambda r: M @ r):
        found = pcg_columns(sparse.csr_array(A), B, operator, start, tolerance=1e-8)
        alone = [pcg(A, B[:, i], M, start[:, i], tolerance=1e-8) for i in range(4)]
        for one, other in zip(found, alone, strict=True):
            assert one.converged
            assert one.iterations == other.iterations
            assert one.x == pytest.approx(other.x, rel=1e-6, abs=1e-300)
            assert one.residuals == pytest.approx(other.residuals, rel=1e-3)
        assert found[1].iterations == 0
        assert not found[1].x.any()


def test_an_iteration_goes_on_from_a_guess() -> None:
    M = inverse(0.8)
    half = pcg(A, b, M, tolerance=1e-4)
    rest = pcg(A, b, M, half.x, tolerance=1e-9)
    whole = pcg(A, b, M, tolerance=1e-9)
    assert rest.converged
    assert 0 < rest.iterations < whole.iterations
    assert energy_error(rest.x) <= 1e-9
    far = pcg(A, b, M, 1e8 * RANDOM.normal(size=N), tolerance=1e-4)
    assert far.converged
    assert energy_error(far.x) <= 1e-4


def test_insufficient_single_precision_is_detected_and_replaced() -> None:
    """Eigenvalues over ten orders: in single precision the smallest ones of M drown in noise."""
    values = np.geomspace(1e-9, 1.0, N)
    bad = (Q * values) @ Q.T
    bad = (bad + bad.T) / 2
    M = (Q / values) @ Q.T
    right = bad @ RANDOM.normal(size=N)
    first = pcg(bad, right, in_single_precision(M), tolerance=1e-8)
    assert not first.converged
    assert first.ended in ("loss of conjugacy", "indefinite preconditioner")
    assert first.preconditioner_failed
    then = pcg(bad, right, M, first.x, tolerance=1e-8)
    assert then.converged


def skew(r: np.ndarray) -> np.ndarray:
    turned = np.triu(np.ones((N, N)), 1)
    return r + 3.0 * (turned - turned.T) @ r


BREAKDOWNS: dict[str, tuple[Callable, str]] = {
    "indefinite matrix": (lambda: pcg(A - 0.1 * np.eye(N), b), "the matrix is not positive definite"),
    "indefinite preconditioner": (lambda: pcg(A, b, -np.eye(N)), "preconditioner is not positive definite"),
    "loss of conjugacy": (lambda: pcg(A, b, skew), "not symmetric, or not precise enough"),
    "preconditioner not finite": (lambda: pcg(A, b, lambda r: r * np.nan), "preconditioner returned values"),
    "matrix not finite": (lambda: pcg(np.full((N, N), np.nan), b), "the matrix product returned values"),
    "rounding": (lambda: pcg(A, b, inverse(0.2), tolerance=1e-30), "as accurate as double precision"),
    "most iterations": (
        lambda: pcg(A, b, most=7),
        "relative residual .* after 7 iterations, required 1.0e-06",
    ),
    "underflow": (lambda: pcg(A, 1e-200 * b), "too small for floating-point numbers"),
}


@pytest.mark.parametrize("name", BREAKDOWNS)
def test_breakdowns_are_named(name: str) -> None:
    solve, message = BREAKDOWNS[name]
    found = solve()
    assert found.ended == name
    assert not found.converged
    assert message.split(" .* ")[-1] in found.reason
    assert found.preconditioner_failed == ("preconditioner" in name or "conjugacy" in name)
    assert np.isfinite(found.x).all()


@pytest.mark.parametrize("seed", [33, 38])
def test_an_iterate_at_the_limit_of_rounding_is_judged_before_it_is_given_up(seed: int) -> None:
    """The tolerance lies 1.5 times above what rounding lets b − A x fall to."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((60, 60)))[0]
    values = np.geomspace(1.0, 10.0 ** rng.uniform(4, 12), 60)
    stiff, M = (Q * values) @ Q.T, (Q / values * (1.0 + 0.3 * rng.random(60))) @ Q.T
    stiff, M, right = (stiff + stiff.T) / 2, (M + M.T) / 2, rng.standard_normal(60)
    least = pcg(stiff, right, M, tolerance=1e-30)
    assert least.ended == "rounding"
    assert not least.converged
    tolerance = 1.5 * float(np.linalg.norm(right - stiff @ least.x) / np.linalg.norm(right))
    found = pcg(stiff, right, M, tolerance=tolerance)
    error = found.x - np.linalg.solve(stiff, right)
    assert found.converged
    assert error @ stiff @ error < (tolerance**2) * (found.x @ stiff @ found.x)


def test_a_preconditioner_that_breaks_late_leaves_the_iterate_before() -> None:
    calls = []

    def breaking(r: np.ndarray) -> np.ndarray:
        calls.append(0)
        return r if len(calls) < 6 else r * np.inf

    found = pcg(A, b, breaking)
    assert (found.ended, found.iterations) == ("preconditioner not finite", 5)
    assert found.residuals[-1] == pytest.approx(np.linalg.norm(b - A @ found.x))


def test_a_recursion_that_drifts_is_not_believed() -> None:
    """A product that is off by 1e-5 lets the recursion fall to nothing and b − A x stay."""
    calls = []

    def product(v: np.ndarray) -> np.ndarray:
        calls.append(0)
        return A @ v + 1e-5 * np.sin(len(calls) + np.arange(N)) * np.abs(A @ v).max()

    found = pcg(LinearOperator((N, N), matvec=product, dtype=float), b, inverse(0.3), tolerance=1e-9)
    assert not found.converged
    assert energy_error(found.x) > 1e-9


REFUSED = {
    "b": (partial(pcg, A, np.ones((N, 2))), "one right-hand side"),
    "flat": (partial(pcg_columns, A, b), "right-hand sides"),
    "A": (partial(pcg, A[:3, :3], b), r"A has shape \(3, 3\)"),
    "M": (partial(pcg, A, b, np.eye(3)), r"M has shape \(3, 3\)"),
    "x0": (partial(pcg, A, b, None, np.ones(3)), "x0 has shape"),
    "complex": (partial(pcg, A, b * 1j), "b holds complex128"),
    "NaN": (partial(pcg, A, b * np.nan), "b holds values that are not finite"),
    "tolerance": (partial(pcg, A, b, tolerance=0.0), "tolerance must be above 0"),
    "most": (partial(pcg, A, b, most=-1), "must be 0 or more"),
    "beta": (partial(pcg, A, b, beta="other"), "beta must be one of flexible, fletcher-reeves"),
    "stop": (partial(pcg, A, b, stop="never"), "stop must be one of energy, residual, both"),
    "shape of z": (partial(pcg, A, b, lambda r: r[:3]), r"M must map vectors of shape \(40,\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_fit_is_refused(name: str) -> None:
    solve, message = REFUSED[name]
    with pytest.raises(OptionError, match=message):
        solve()


def test_plain_conjugate_gradients_name_their_end_too() -> None:
    assert conjugate_gradients(A, b).ended == "met"
    assert conjugate_gradients(A, b, most=3).ended == "most iterations"
    assert conjugate_gradients(-A, b).ended == "indefinite matrix"
    assert conjugate_gradients(A, 1e-200 * b).ended == "underflow"


@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_energy_errors_of_all_iterates_are_reported(noise: float) -> None:
    found = pcg(A, b, inverse(noise), tolerance=1e-8)
    errors = found.energy_errors
    assert len(errors) == len(found.residuals) == found.iterations + 1 > 4
    assert errors[-1] == pytest.approx(found.energy_error)
    iterates = [pcg(A, b, inverse(noise), tolerance=1e-8, most=k).x for k in range(found.iterations)]
    true = np.array([energy_error(x) for x in iterates])
    np.testing.assert_allclose(errors[:-4], true[:-3], rtol=0.01)
    np.testing.assert_allclose(errors[-4:-1], true[-3:], rtol=0.3)  # where the bound at the end is felt


def test_energy_errors_of_plain_conjugate_gradients() -> None:
    found = conjugate_gradients(A, b, 1e-8)
    assert found.converged
    errors = found.energy_errors
    assert errors[0] == pytest.approx(1.0, rel=1e-6)
    assert errors[-1] == pytest.approx(found.energy_error)
    assert (np.diff(errors) < 0).all()
    assert len(conjugate_gradients(A, b, 1e-8, most=3).energy_errors) == 0  # nobody knows what is left


def far_apart(n: int = 60) -> np.ndarray:
    """A positive definite matrix whose entries span ten decades: rounding of x alone shows in b − A x."""
    size = np.geomspace(1.0, 1e5, n)
    random = np.random.default_rng(5)
    Z = random.normal(size=(n, n)) / n**0.5
    made = np.outer(size, size) * (Z @ Z.T + 0.05 * np.eye(n))
    return (made + made.T) / 2


def test_x_limited_by_rounding_is_as_accurate_as_by_elimination() -> None:
    hard = far_apart()
    wanted = np.ones(len(hard))
    exact = np.linalg.solve(hard, wanted)
    for _ in range(3):
        exact = exact + np.linalg.solve(hard, wanted - hard @ exact)
    best = np.linalg.norm(wanted - hard @ exact)
    M = np.linalg.inv(hard * (1 + 0.05 * np.eye(len(hard))))
    found = pcg(hard, wanted, (M + M.T) / 2, tolerance=1e-16, stop="both")
    assert (found.converged, found.ended, found.final) == (False, "rounding", True)
    assert found.backward_error <= LIMIT
    assert found.backward_error == backward_error(hard, found.x, wanted)
    assert "as accurate as double precision allows (backward error" in found.reason
    assert np.linalg.norm(wanted - hard @ found.x) <= 3.0 * best
    assert found.residuals[-1] == pytest.approx(np.linalg.norm(wanted - hard @ found.x))
    e = found.x - exact
    assert np.sqrt(e @ hard @ e / (wanted @ exact)) <= 4.0 * found.energy_error


def test_the_backward_error_is_the_same_for_a_matrix_in_blocks() -> None:
    rng = np.random.default_rng(3)
    n = 5000  # rows of blocks: more than are taken at a time
    A = sparse.random_array((n, n), density=3 / n, rng=rng) - sparse.eye_array(n)
    A = sparse.kron(A, rng.standard_normal((2, 2)), format="bsr")
    A.sort_indices()
    x, b = rng.standard_normal((2, 2 * n))
    plain = sparse.csr_array(A)
    expected = np.linalg.norm(b - plain @ x) / np.linalg.norm(abs(plain) @ np.abs(x) + np.abs(b))
    assert A.has_canonical_format
    assert A.blocksize == (2, 2)
    assert backward_error(A, x, b) == pytest.approx(expected, rel=1e-12)


def test_the_limit_of_precision_is_claimed_of_known_entries_alone() -> None:
    hard = far_apart()
    unknown = LinearOperator(hard.shape, matvec=lambda x: hard @ x, dtype=float)
    M = np.linalg.inv(hard * (1 + 0.05 * np.eye(len(hard))))
    found = pcg(unknown, np.ones(len(hard)), (M + M.T) / 2, tolerance=1e-16, stop="both")
    assert (found.converged, found.ended, found.final) == (False, "stagnation", False)
    assert found.backward_error is None


@pytest.mark.parametrize("stop", ["both", "residual"])
def test_an_iteration_ends_once_its_residual_is_rounding(stop: str) -> None:
    hard = far_apart()
    M = np.linalg.inv(hard * (1 + 0.05 * np.eye(len(hard))))
    unknown = LinearOperator(hard.shape, matvec=lambda x: hard @ x, dtype=float)
    known, other = (
        pcg(A, np.ones(len(hard)), (M + M.T) / 2, tolerance=1e-13, stop=stop) for A in (hard, unknown)
    )
    assert (known.ended, other.ended) == ("rounding", "stagnation")
    assert known.iterations < other.iterations  # which has to see that fresh starts gain nothing
    np.testing.assert_allclose(known.residuals, other.residuals[: known.iterations + 1], rtol=1e-6)
    assert known.residuals[-1] <= 4.0 * other.residuals[-1]


def test_the_limit_of_precision_is_not_claimed_far_from_it() -> None:
    given = History(X * (1 + 1e-9), np.ones(2), False, "fell no further: …", 1e-9, (), "stagnation")
    explained = explain_end(given, A, b)
    assert (explained.ended, explained.final) == ("stagnation", False)
    assert explained.backward_error > 1e-13
    singular = replace(given, x=X, energy_error=0.5)
    assert explain_end(singular, A, b).ended == "stagnation"
    assert explain_end(replace(given, x=X), A, b).ended == "rounding"
    assert explain_end(replace(given, ended="most iterations"), A, b).backward_error is None
