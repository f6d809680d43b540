"""Monomials in cell coordinates, ordered by degree, so that lower degrees come first."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np

from agglo_core.authoring import Float, Int, frozen_float, frozen_int


@cache
def exponents(degree: int, dim: int) -> Int:
    """Return the exponents ``(m, d)`` of all monomials up to a degree."""
    powers = [e for e in product(range(degree + 1), repeat=dim) if sum(e) <= degree]
    powers.sort(key=lambda e: (sum(e), [-k for k in e]))
    return frozen_int(np.array(powers, int).reshape(-1, dim))


def count(degree: int, dim: int) -> int:
    """Return the number of monomials up to a degree."""
    return len(exponents(degree, dim))


@cache
def _places(degree: int, dim: int) -> dict[tuple[int, ...], int]:
    return {tuple(e): k for k, e in enumerate(exponents(degree, dim).tolist())}


@cache
def products(degree: int, dim: int) -> Int:
    """Return the number ``(m, m)`` of each product of two monomials among those up to twice the degree."""
    powers = exponents(degree, dim)
    places = _places(2 * degree, dim)
    return frozen_int([[places[tuple((a + b).tolist())] for b in powers] for a in powers])


@cache
def derivatives(degree: int, dim: int) -> Float:
    """Return the derivatives ``(d, m, n)`` of the monomials by those of the next lower degree."""
    powers, places = exponents(degree, dim), _places(max(degree - 1, 0), dim)
    table = np.zeros((dim, len(powers), len(places)))
    for k, power in enumerate(powers):
        for axis in np.flatnonzero(power):
            table[axis, k, places[tuple((power - np.eye(dim, dtype=int)[axis]).tolist())]] = power[axis]
    return frozen_float(table)


def monomials(points: Float, degree: int) -> Float:
    """Evaluate the monomials up to a degree at points ``(…, d)``: values ``(…, m)``."""
    dim = points.shape[-1]
    places, values = _places(degree, dim), np.ones((*points.shape[:-1], count(degree, dim)))
    for power, k in places.items():
        if k:
            axis = next(a for a in range(dim) if power[a])
            lower = tuple(e - (a == axis) for a, e in enumerate(power))
            values[..., k] = points[..., axis] * values[..., places[lower]]
    return values
