"""Polynomials in two and three variables: products of Legendre polynomials, by total degree."""

from __future__ import annotations

from functools import cache
from math import comb
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Float, Int, frozen_float, frozen_int
from agglo_core.fields.gauss_points import gauss
from agglo_core.threads import over_ranges


def n_polynomials(degree: int, dim: int = 2) -> int:
    """Return the dimension of polynomials of a total degree, such as 3 for degree 1 in 2-D."""
    return comb(degree + dim, dim)


@cache
def orders(degree: int, dim: int = 2) -> Int:
    """Return the degrees ``(m, dim)`` along the axes for all cell polynomials, by total degree."""
    return frozen_int([each for total in range(degree + 1) for each in _of_total(total, dim)])


def _of_total(total: int, dim: int) -> list[tuple[int, ...]]:
    if dim == 1:
        return [(total,)]
    return [(i, *rest) for i in range(total, -1, -1) for rest in _of_total(total - i, dim - 1)]


@cache
def derivatives(degree: int, dim: int) -> Float:
    """Return the matrices ``(dim, m, m)`` that map coefficients of cell polynomials to those of derivatives.

    P'_i is the sum of (2j + 1) P_j over j = i − 1, i − 3, …
    """
    powers = orders(degree, dim)
    step = powers[None, :] - powers[:, None]  # of each polynomial over each term of its derivatives
    matrices = np.zeros((dim, len(powers), len(powers)))
    for axis in range(dim):
        along = step[:, :, axis]
        terms = (along > 0) & (along % 2 == 1) & (np.abs(step).sum(axis=2) == along)
        lengths = np.sqrt(2.0 * powers[:, axis] + 1.0)
        matrices[axis] = np.where(terms, lengths[:, None] * lengths, 0.0)
    return frozen_float(matrices)


def legendre(x: Float, degree: int) -> Float:
    """Evaluate orthonormal Legendre polynomials 0..degree at ``x (q,)``, shape ``(degree + 1, q)``."""
    values = np.empty((degree + 1, *np.shape(x)))
    before, value = np.zeros_like(x), np.ones_like(x)
    for k in range(degree + 1):
        values[k] = value * np.sqrt(k + 0.5)
        before, value = value, ((2 * k + 1) * x * value - k * before) / (k + 1)
    return values


def slopes(values: Float) -> Float:
    """Return the derivatives of Legendre polynomials from their ``values (degree + 1, q)``.

    Uses P'_{k+1} = P'_{k−1} + (2k + 1) P_k.
    """
    result = np.zeros_like(values)
    for k in range(len(values) - 1):
        below = result[k - 1] / np.sqrt(k - 0.5) if k else 0.0
        result[k + 1] = (below + 2 * np.sqrt(k + 0.5) * values[k]) * np.sqrt(k + 1.5)
    return result


def products(
    integrals: list[Float],
    degree: int,
    derivatives: list[tuple[int, ...]],
    others: list[tuple[int, ...]] | None = None,
) -> Float:
    """Return the integrals ``(n, m, m)`` of products of two polynomial derivatives, summed over a list.

    A product of two Legendre polynomials is a sum of Legendre polynomials, so the only cell data are the
    integrals ``(n, k)`` of polynomials up to the product degree. Each array in the list is paired with one
    tuple of differentiation orders along the axes. If the second factors have ``others``, the products with
    exchanged orders are added, unless both are equal.
    """
    from agglo_polydg_mg.space.legendre_kernels import sparse_products

    size = n_polynomials(degree, len(derivatives[0]))
    blocks = np.zeros((len(integrals[0]), size, size))
    for weights, first, second in zip(integrals, derivatives, others or derivatives, strict=True):
        values = frozen_float(weights)
        terms = _expansion(degree, _degree_of(weights.shape[1], len(first)), first, second)
        over_ranges(
            lambda start, stop: sparse_products(values[start:stop], *terms, blocks[start:stop]),  # noqa: B023
            len(blocks),
        )
    return blocks


def _degree_of(count: int, dim: int) -> int:
    """Return the total degree of a space of ``count`` polynomials."""
    return next(degree for degree in range(count) if n_polynomials(degree, dim) >= count)


@cache
def _expansion(
    degree: int, most: int, derivatives: tuple[int, ...], others: tuple[int, ...]
) -> tuple[Int, Int, Float]:
    """Expand products of two polynomial derivatives in polynomials up to degree ``most``.

    Returns the pairs ``(t, 2)``, the polynomials ``(t,)`` and the factors ``(t,)`` of the nonzero terms.
    """
    dim = len(derivatives)
    powers, sums = orders(degree, dim), orders(most, dim)
    first, second = np.tril_indices(len(powers))
    table = np.zeros((len(sums), len(first)))
    for ordered in {(derivatives, others), (others, derivatives)}:
        product = np.ones(table.shape)
        for axis, (one, other) in enumerate(zip(*ordered, strict=True)):
            axis_table = _triple(degree, one, other)
            product *= axis_table[powers[first, axis], powers[second, axis], sums[:, axis, None]]
        table += product
    pairs, columns = np.nonzero(np.abs(table.T) > 1e-13 * np.abs(table).max())
    places = np.stack((first[pairs], second[pairs]), axis=1)
    return frozen_int(places), frozen_int(columns), frozen_float(table[columns, pairs])


@cache
def _triple(degree: int, one: int, other: int) -> Float:
    """Return the integrals of L_i⁽ᵈ⁾ L_k⁽ᵉ⁾ L_a over [−1, 1] with a <= 2 degree."""
    nodes, weights = gauss(2 * degree + 1)
    values = legendre(nodes, 2 * degree)
    low = values[: degree + 1], slopes(values[: degree + 1])
    return np.asarray(np.einsum("iq,kq,aq,q->ika", low[one], low[other], values, weights))


class Monomials(NamedTuple):
    """Monomials in three coordinates, with index tables for products and derivatives.

    ``powers (k, 3)`` up to twice a degree; ``sums (n, n)`` the product of two of the ``n`` up to the
    degree; ``lowered (n, n, 3)`` the product of the first and the derivative of the second along an axis, 0
    if it vanishes; ``terms (t, 2)`` index pairs whose second exponents nowhere exceed the first.
    """

    powers: Int
    sums: Int
    lowered: Int
    terms: Int


@cache
def monomials(degree: int) -> Monomials:
    """Build the monomials up to a degree and their index tables, in the order of :func:`orders`."""
    powers, low_powers = orders(2 * degree, 3), orders(degree, 3)
    number = {tuple(power): k for k, power in enumerate(powers.tolist())}
    sum_powers = low_powers[:, None] + low_powers[None]
    sums = [[number[tuple(power)] for power in row] for row in sum_powers.tolist()]
    lower_powers = sum_powers[:, :, None] - np.eye(3, dtype=int)
    lowered = [
        [[number.get(tuple(power), 0) for power in part] for part in row] for row in lower_powers.tolist()
    ]
    terms = np.argwhere((low_powers[:, None] >= low_powers[None]).all(axis=2))
    return Monomials(powers, frozen_int(sums), frozen_int(lowered), frozen_int(terms))
