"""Smoothers of the levels of a stack: both sides, by name and made from strangers' components."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from multigrid.random_systems import block_diagonal, mesh_matrix, random_system, two_level
from scipy import sparse
from scipy.linalg import eigh

from agglo_core.errors import OptionError, PluginError
from agglo_core.multigrid import (
    SMOOTHERS,
    BlockJacobi,
    Chebyshev,
    GaussSeidel,
    adapted,
    block_matrix,
    cycle,
    largest_eigenvalue,
    smoother_setup,
)
from agglo_core.problems import MultigridLevel

OFFSETS = {"equal": np.arange(0, 31, 3), "unequal": np.array([0, 2, 2, 9, 14, 15, 30])}


def _most(A: sparse.csr_array, offsets: np.ndarray) -> float:
    blocks = block_matrix(A, offsets)
    return largest_eigenvalue(blocks, blocks.inverses.__matmul__)


def level_of(A: sparse.csr_array, offsets: np.ndarray, steps: int = 1) -> MultigridLevel:
    return MultigridLevel(A, A, offsets, np.arange(len(offsets) - 1), sparse.eye_array(1), None, steps)


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("parts", OFFSETS)
@pytest.mark.parametrize("name", SMOOTHERS)
def test_after_is_the_mirror_image_of_before(name: str, parts: str, steps: int) -> None:
    A, n = random_system(30), 30
    smoother = smoother_setup(name)(level_of(A, OFFSETS[parts], steps), np.float64)
    B = np.stack([smoother.before(e)[0] for e in np.eye(n)], axis=1)
    mirrored = np.stack([smoother.after(e, np.zeros(n)) for e in np.eye(n)], axis=1)
    assert mirrored == pytest.approx(B.T, abs=1e-12)
    b, x = np.random.default_rng(20261122).standard_normal((2, n))
    assert smoother.after(b, x.copy()) == pytest.approx(x + B.T @ (b - A @ x))
    assert smoother.before(b)[1] == pytest.approx(b - A @ (B @ b))
    E = np.eye(n) - B @ A.toarray()
    assert max(abs(np.linalg.eigvals(E))) < 1.0


@pytest.mark.parametrize("name", SMOOTHERS)
def test_in_single_precision_they_do_the_same(name: str) -> None:
    level = level_of(mesh_matrix(50, 3), np.arange(0, 151, 3), 2)
    b, x = np.random.default_rng(20261122).standard_normal((2, 150))
    single, double = (smoother_setup(name)(level, dtype) for dtype in (np.float32, np.float64))
    made, wanted = single.before(b.astype(np.float32)), double.before(b)
    for one, other in zip(made, wanted, strict=True):
        assert one.dtype == np.float32
        assert one == pytest.approx(other, abs=1e-4)
    after = single.after(b.astype(np.float32), x.astype(np.float32))
    assert after.dtype == np.float32
    assert after == pytest.approx(double.after(b, x), abs=1e-4)


@pytest.mark.parametrize("parts", OFFSETS)
def test_the_largest_eigenvalue_is_found(parts: str) -> None:
    A, offsets = random_system(30), OFFSETS[parts]
    exact = eigh(A.toarray(), block_diagonal(A, offsets), eigvals_only=True)[-1]
    found = _most(A, offsets)
    assert 0.95 * exact < found <= exact * (1 + 1e-10)
    assert _most(sparse.eye_array(4).tocsr(), np.arange(5)) == pytest.approx(1.0)


def test_chebyshev_is_the_polynomial() -> None:
    A, degree, ratio = random_system(30), 3, 5.0
    offsets = OFFSETS["equal"]
    smoother = Chebyshev(degree, ratio).setup(level_of(A, offsets))
    values, vectors = eigh(A.toarray(), block_diagonal(A, offsets))
    most = 1.05 * _most(A, offsets)
    low = most / ratio

    def T(t: np.ndarray) -> np.ndarray:
        return np.polynomial.chebyshev.chebval((most + low - 2 * t) / (most - low), [0, 0, 0, 1])

    for value, mode in zip(values, vectors.T, strict=True):
        left = smoother.after(np.zeros(30), mode)
        assert left == pytest.approx(T(value) / T(np.array(0.0)) * mode, abs=1e-9)


def test_jacobi_is_damped_by_the_formula() -> None:
    A, offsets = random_system(30), OFFSETS["equal"]
    x = np.random.default_rng(20261122).standard_normal(30)
    damping = 4 / (3 * _most(A, offsets))
    wanted = x - damping * np.linalg.solve(block_diagonal(A, offsets), A @ x)
    assert BlockJacobi().setup(level_of(A, offsets)).after(np.zeros(30), x) == pytest.approx(wanted)


class Jacobi:
    """A stranger's smoother: one step of damped Jacobi."""

    def setup(self, level: MultigridLevel):
        assert level.A.dtype == np.float64
        damping = 0.5 / level.A.diagonal()
        return lambda b, x: x + damping * (b - level.A @ x)


class Sided:
    """A stranger's smoother with two sides, which only they use."""

    def setup(self, level: MultigridLevel):
        return Sides(level.A)


class Sides:
    def __init__(self, A) -> None:
        self.lower = np.tril(A.toarray())
        self.A = A

    def before(self, b):
        x = np.linalg.solve(self.lower, b)
        return x, b - self.A @ x

    def after(self, b, x):
        return x + np.linalg.solve(self.lower.T, b - self.A @ x)

    def __call__(self, b, x):
        raise AssertionError("not to be asked")


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("smoother", [Jacobi(), Sided()], ids=lambda each: type(each).__name__)
def test_a_strangers_smoother_makes_a_symmetric_cycle(smoother: object, dtype: type) -> None:
    A = mesh_matrix(40)
    M = cycle(two_level(A, 1, smoother, dtype=dtype)) @ np.eye(40)
    assert pytest.approx(M.T, abs=(1e-12 if dtype is np.float64 else 1e-4) * abs(M).max()) == M
    assert np.linalg.eigvalsh(M + M.T).min() > 0.0


def test_a_strangers_sides_are_used() -> None:
    A = mesh_matrix(40)
    stranger, ours = (cycle(two_level(A, 1, each)) @ np.ones(40) for each in (Sided(), "gauss_seidel"))
    assert stranger == pytest.approx(ours)


class Returns:
    """A smoother that returns what it was made with."""

    def __init__(self, given: object) -> None:
        self.given = given

    def setup(self, level: MultigridLevel):
        return self.given


class Pairs(Sides):
    """Two sides with answers of one's own."""

    def __init__(self, pair: object) -> None:
        self.pair = pair

    def before(self, b):
        return self.pair


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (None, "mine: setup returned None, expected a function"),
        (lambda b, x: x[:3], r"mine: smooth\(b, x\) returned shape \(3,\) of float64, expected \(30,\)"),
        (lambda b, x: x > 0, "of bool"),
        (Pairs(np.ones(30)), "mine: before.b. returned array"),
        (Pairs((np.ones(30), np.ones(3))), r"before\(b\) returned shape \(3,\)"),
    ],
)
def test_what_a_stranger_returns_is_checked(given: object, says: str) -> None:
    with pytest.raises(PluginError, match=says):
        adapted(Returns(given), level_of(random_system(30), OFFSETS["equal"]), "mine").before(np.ones(30))


def test_calls_of_a_stranger_are_guarded() -> None:
    @contextmanager
    def guard():
        try:
            yield
        except ZeroDivisionError as error:
            raise PluginError("that was mine") from error

    level = level_of(random_system(30), OFFSETS["equal"])
    ready = adapted(Returns(lambda b, x: 1 / 0), level, "mine", guard)
    for call in (lambda: ready.before(np.ones(30)), lambda: ready.after(np.ones(30), np.ones(30))):
        with pytest.raises(PluginError, match="that was mine"):
            call()


def test_a_function_of_level_and_dtype_is_a_smoother_too() -> None:
    level = level_of(random_system(30), OFFSETS["equal"])
    own = smoother_setup(lambda level, dtype: GaussSeidel().setup(level, dtype))(level, np.float32)
    assert own.before(np.ones(30, np.float32))[0].dtype == np.float32


@pytest.mark.parametrize("given", ["sor", 3, GaussSeidel])
def test_anything_else_is_refused(given: object) -> None:
    with pytest.raises(OptionError, match="one of block_jacobi, chebyshev, gauss_seidel, an object with"):
        smoother_setup(given)


def test_options_of_chebyshev() -> None:
    for options in ({"degree": 0}, {"degree": 1.5}, {"ratio": 1.0}, {"ratio": np.inf}):
        with pytest.raises(OptionError, match="must be"):
            Chebyshev(**options)  # type: ignore[arg-type]
