"""Polynomials on the whole mesh, used as near-null vectors of the coarse spaces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Float, frozen_float


def monomials(dim: int, degree: int, centre: ArrayLike, half: float) -> list[Callable[[Float], Float]]:
    """Return the monomials up to total ``degree`` as functions of points ``(q, d)``, by increasing degree.

    Their arguments are scaled to [−1, 1]^d on a box with half side ``half`` around ``centre``.

    Examples
    --------
    >>> found = monomials(2, 1, [1.0, 1.0], 2.0)
    >>> [each(np.array([[3.0, 0.0]])).tolist() for each in found]
    [[1.0], [-0.5], [1.0]]
    """
    middle = np.asarray(centre)

    def scaled(powers: tuple[int, ...]) -> Callable[[Float], Float]:
        return lambda points: monomial(frozen_float((points - middle) / half), powers)

    return [scaled(each) for each in exponents(dim, degree)]


def exponents(dim: int, degree: int) -> list[tuple[int, ...]]:
    """Return the exponents of all monomials up to total ``degree``, beginning with the constant.

    Examples
    --------
    >>> exponents(2, 1)
    [(0, 0), (0, 1), (1, 0)]
    """
    return [each for each in np.ndindex(*(degree + 1,) * dim) if sum(each) <= degree]


def monomial(points: Float, powers: tuple[int, ...]) -> Float:
    """Evaluate the monomial with given exponents at points ``(q, d)``, and return ``(q,)``.

    Examples
    --------
    >>> monomial(np.array([[2.0, 3.0]]), (2, 1)).tolist()
    [12.0]
    """
    values = np.ones(len(points))
    for axis, power in enumerate(powers):
        if power:
            values *= points[:, axis] ** power
    return frozen_float(values)
