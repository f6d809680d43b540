"""Components of the domain where data determine the solution only up to a constant.

There the matrix is singular, and the solution exists only for data that balance. A positive number added to
one diagonal entry makes the matrix positive definite, and leaves the solution of a balanced system
unchanged up to the constant (``docs/mathematics.md``).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.problems import Field

_QUADRATURE: Final = 1e-4
"""Imbalance of source and fluxes, relative to the integral of their magnitudes, that counts as quadrature
error and is corrected. A smaller value refuses balanced callables on coarse meshes."""
_log = logging.getLogger("agglo")


@dataclass(frozen=True, eq=False)
class Floating:
    """Components where the solution is determined only up to a constant.

    Attributes
    ----------
    mesh : Mesh
    cells, unknowns : sequence of (k,) int
        Cells and unknowns of each component.
    ones, unit : (n,) float
        Unknowns of the function 1, and the load of the source 1.
    """

    mesh: Mesh
    cells: Sequence[Int]
    unknowns: Sequence[Int]
    ones: Float
    unit: Float

    def energies(self, kappa: Float) -> Iterator[tuple[int, float]]:
        """Yield a cell of each component, and the energy to add to its matrix for u = 1.

        It is κ |Ω|^(1 − 2/d) with the mean of ``kappa (n_cells,)``, which depends on the component alone, and
        not on its cells. The cell has the largest κ.
        """
        for cells in self.cells:
            volumes = self.mesh.cell_measures[cells]
            mean = kappa[cells] @ volumes / volumes.sum()
            yield (
                int(cells[np.argmax(kappa[cells])]),
                float(mean * volumes.sum() ** (1.0 - 2.0 / self.mesh.dim)),
            )

    def balanced(self, b: Float, sizes: Float) -> Float:
        """Return the right-hand side ``b (n,)`` with zero sum on each component.

        Imbalances at the level of quadrature errors are distributed as a constant source. They are relative
        to ``sizes (n_cells,)``, the integrals of the magnitudes of source and fluxes.

        Raises
        ------
        OptionError
            If source and fluxes do not balance, with their integral.
        """
        result = np.array(b)
        for cells, own in zip(self.cells, self.unknowns, strict=True):
            imbalance, size = float(b[own] @ self.ones[own]), float(sizes[cells].sum())
            if abs(imbalance) > _QUADRATURE * size:
                raise OptionError(
                    f"the component of cell {cells[0]} has no boundary face with Dirichlet data, no reaction "
                    "and no Robin data with positive alpha, so the solution is determined only up to a "
                    "constant there, and source and fluxes must balance; they integrate to "
                    f"{imbalance:.6g}, their magnitudes to {size:.6g}: change the data, or give a Dirichlet "
                    "value for one of its boundary tags"
                )
            if abs(imbalance) > 1e-12 * size:
                _log.info(
                    "source and fluxes are balanced up to %.1e, which is corrected", abs(imbalance) / size
                )
            result[own] -= imbalance / self.mesh.cell_measures[cells].sum() * self.unit[own]
        return result

    def means(self, x: Float) -> Float:
        """Return the unknowns ``(n,)`` of the mean of a function on each component, 0 elsewhere."""
        result = np.zeros(len(x))
        for cells, own in zip(self.cells, self.unknowns, strict=True):
            mean = self.unit[own] @ x[own] / self.mesh.cell_measures[cells].sum()
            result[own] = mean * self.ones[own]
        return frozen_float(result)


def magnitude(field: Field) -> Field:
    """Return the absolute values of a field."""
    if callable(field):
        return lambda points: np.abs(np.asarray(field(points), float))
    return frozen_float(np.abs(np.asarray(field, float)))
