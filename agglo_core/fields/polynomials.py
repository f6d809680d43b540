"""Piecewise polynomial functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int


class AtPoints(NamedTuple):
    """Values ``(q,)`` and gradients ``(q, d)`` of a function."""

    values: Float
    slopes: Float


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Piecewise polynomial function, in a basis of polynomials on each cell.

    Attributes
    ----------
    basis : callable
        ``basis(cells, points)`` returns the basis ``(q, m)`` of ``cells (q,)`` at points ``(q, d)``, relative
        to the mesh origin.
    gradient : callable
        Maps coefficients ``(n_cells, ..., m)`` to those of the gradients ``(n_cells, ..., d, m)``.
    mass : (n_cells, m, m) float
        Mass matrices of the basis.
    coefficients : (n_cells, m) float
    offset : (n_cells,) float
        Constants to add.
    """

    basis: Callable[[Int, Float], Float]
    gradient: Callable[[Float], Float]
    mass: Float
    coefficients: Float
    offset: Float

    @cached_property
    def slopes(self) -> Float:
        """Coefficients of the gradient ``(n_cells, d, m)``."""
        return self.gradient(self.coefficients)

    def at(self, cells: Int, points: Float) -> AtPoints:
        """Evaluate the function at points ``(q, d)`` relative to the mesh origin, in known ``cells (q,)``."""
        tests = self.basis(cells, points)
        values = np.einsum("qm,qm->q", tests, self.coefficients[cells]) + self.offset[cells]
        return AtPoints(values, np.einsum("qm,qdm->qd", tests, self.slopes[cells]))
