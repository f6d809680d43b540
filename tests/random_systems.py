"""Random symmetric positive definite systems, preconditioners of all qualities, and exact energy errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

__all__ = ["QUALITIES", "RandomSystem", "exact_solution", "in_single_precision", "random_system"]

Array = NDArray[np.float64]
QUALITIES = ("none", "jacobi", "exact", "good", "poor", "single", "nonsymmetric", "indefinite", "random")


@dataclass(frozen=True, eq=False)
class RandomSystem:
    """System A x = b with a preconditioner, the exact solution and a tolerance."""

    A: Array
    b: Array
    M: Any
    tolerance: float
    quality: str
    x: NDArray[np.longdouble]

    def energy_error(self, x: Array) -> float:
        """Return ‖x − A⁻¹b‖_A / ‖A⁻¹b‖_A in extended precision."""
        A, e = self.A.astype(np.longdouble), self.x - x
        return float(np.sqrt(max(e @ A @ e, 0.0) / (self.x @ A @ self.x)))


def exact_solution(A: Array, b: Array) -> NDArray[np.longdouble]:
    """Return A⁻¹b by elimination with iterative refinement in extended precision."""
    wide, right = A.astype(np.longdouble), b.astype(np.longdouble)
    x = np.linalg.solve(A, b).astype(np.longdouble)
    for _ in range(12):
        x = x + np.linalg.solve(A, (right - wide @ x).astype(np.float64))
    return x


def random_system(seed: int) -> RandomSystem:
    """Return a system with at most 70 unknowns.

    The condition number is at most 1e10 before the rows are scaled.
    """
    random = np.random.default_rng(seed)
    n = int(random.integers(3, 70))
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    scale = np.exp(random.normal(size=n) * random.choice([0, 0, 2]))
    A = (Q * _eigenvalues(random, n)) @ Q.T * scale[:, None] * scale
    d, V = np.linalg.eigh((A + A.T) / 2)
    A = (V * np.maximum(d, 1e-11 * d[-1])) @ V.T
    A = (A + A.T) / 2
    d, V = np.linalg.eigh(A)
    white = random.normal(size=n)
    few = V[:, random.integers(0, n, 2)] @ random.normal(size=2)
    b = [white, A @ white, (V * np.sqrt(d)) @ white, few][random.integers(4)] * 10 ** random.uniform(-3, 3)
    quality = QUALITIES[seed % len(QUALITIES)]
    M = _preconditioner(random, quality, A, d, V)
    return RandomSystem(A, b, M, 10 ** -random.uniform(1, 10), quality, exact_solution(A, b))


def _eigenvalues(random: Generator, n: int) -> Array:
    """Return eigenvalues from 1e-10 to 1: uniform or random in the logarithm, clustered, or an outlier."""
    condition = 10 ** random.uniform(0, 10)
    spread = condition ** -random.random(n)
    clustered = np.where(random.random(n) < 0.8, 1 + 0.1 * random.random(n), spread)
    found = [spread, clustered, np.geomspace(1 / condition, 1, n), 1 + random.random(n)][random.integers(4)]
    found[0], found[-1] = min(found[0], 1 / condition), 1.0
    return found


def _preconditioner(random: Generator, quality: str, A: Array, d: Array, V: Array) -> Any:
    n = len(A)

    def inverse(power: float, noise: float) -> Array:
        return (V * d**-power * np.exp(noise * random.normal(size=n))) @ V.T

    if quality == "nonsymmetric":
        M = inverse(1, 0.4)
        return M + 10 ** random.uniform(-8, -1) * np.abs(M).max() * random.normal(size=(n, n)) / n**0.5
    if quality == "indefinite":
        turned = np.exp(0.4 * random.normal(size=n)) / d
        turned[random.integers(n)] *= -(10 ** random.uniform(-6, 0))
        return (V * turned) @ V.T
    if quality == "random":
        X = random.normal(size=(n, n))
        return X @ X.T / n + 0.1 * np.eye(n)
    if quality == "single":
        return in_single_precision(inverse(random.uniform(0.8, 1), 0.3))
    kinds = {"none": lambda: None, "jacobi": lambda: np.diag(1 / np.diag(A)), "exact": lambda: inverse(1, 0)}
    kinds |= {"good": lambda: inverse(1, 0.5), "poor": lambda: inverse(random.uniform(0.3, 0.9), 1)}
    return kinds[quality]()


def in_single_precision(M: Array) -> Any:
    """Return the product with M in single precision, with rounding as in a multigrid cycle."""
    single = M.astype(np.float32)

    def product(r: Array) -> Array:
        size = np.abs(r).max() or 1.0
        return size * (single @ (r / size).astype(np.float32)).astype(np.float64)

    return product
