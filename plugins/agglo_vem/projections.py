"""Functions of the space by their L2 projections on the cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Float, Int, OptionError
from agglo_vem.local_spaces import Space
from agglo_vem.monomials import count, derivatives, monomials


class AtPoints(NamedTuple):
    """Values ``(q,)`` and gradients ``(q, d)`` of a function."""

    values: Float
    slopes: Float


@dataclass(frozen=True, eq=False)
class Projected:
    """L2 projections of a function.

    Attributes
    ----------
    space : Space
    coefficients : (n_cells, m) float
        Of the monomials in cell coordinates.
    """

    space: Space
    coefficients: Float

    @classmethod
    def of(cls, space: Space, x: Float) -> Projected:
        """Project the function with unknowns ``x (n,)``."""
        x = np.asarray(x, dtype=float)
        if x.shape != (space.n,):
            raise OptionError(f"x must have the shape ({space.n},), given {x.shape}")
        coefficients = np.empty((space.mesh.n_cells, count(space.degree, space.mesh.dim)))
        for batch in space.batches():
            coefficients[batch.cells] = np.einsum("cmn,cn->cm", batch.l2, x[batch.unknowns])
        return cls(space, coefficients)

    @cached_property
    def slopes(self) -> Float:
        """Coefficients of the gradient ``(n_cells, d, m)``."""
        return self.gradient(self.coefficients)

    def gradient(self, coefficients: Float) -> Float:
        """Map coefficients ``(n_cells, ..., m)`` to those of gradients ``(n_cells, ..., d, m)``."""
        space, table = self.space, derivatives(self.space.degree, self.space.mesh.dim)
        slopes = np.zeros((*coefficients.shape[:-1], *table.shape[:2]))
        local = np.einsum("amn,c...m->c...an", table, coefficients)
        slopes[..., : table.shape[2]] = np.einsum("c...an,cab->c...bn", local, space.frames.maps)
        return slopes

    def basis(self, cells: Int, points: Float) -> Float:
        """Evaluate the monomials at points relative to the mesh origin, in known cells."""
        return monomials(self.space.frames.coordinates(cells, points), self.space.degree)

    def at(self, cells: Int, points: Float) -> AtPoints:
        """Evaluate the projections at points relative to the mesh origin, in known cells."""
        tests = self.basis(cells, points)
        values = np.einsum("qm,qm->q", tests, self.coefficients[cells])
        return AtPoints(values, np.einsum("qm,qam->qa", tests, self.slopes[cells]))

    def mean_slopes(self) -> Float:
        """Return the mean of the gradient over each cell ``(n_cells, d)``."""
        space = self.space
        table, means = derivatives(space.degree, space.mesh.dim), space.frames.means(space.degree - 1)
        slopes = np.einsum("cm,amn,cn->ca", self.coefficients, table, means, optimize=True)
        return np.asarray(np.einsum("ca,cab->cb", slopes, space.frames.maps))
