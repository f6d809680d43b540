"""Estimator of the error in the DG norm, by cell."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Float,
    Hierarchy,
    Mesh,
    OptionError,
    Solution,
    frozen_float,
    frozen_int,
    solvers,
)
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid
from agglo_polydg_mg.space.projection import transfer


class Hierarchical:
    """Estimate the error by the energy of the difference to the solution of the next higher degree.

    Implements :class:`~agglo_core.protocols.Estimator` for diffusion problems solved by PolyDG with degree
    1..5. It takes another solve with more unknowns.

    Parameters
    ----------
    tolerance : float
        Tolerance of that solve.
    """

    accepts: ClassVar[tuple[str, ...]] = (Diffusion.kind,)

    def __init__(self, tolerance: float = 1e-10) -> None:
        solvers.require_fraction("tolerance", tolerance)
        self.tolerance = tolerance

    def __repr__(self) -> str:
        return solvers.show_options(self)

    def indicate(self, solution: Solution) -> Float:
        """Return the energy of the difference in each cell ``(n_cells,)``, with its penalised jumps."""
        how, mesh, problem = posed(self, solution)
        if how.degree == 6:
            raise OptionError("the hierarchical estimator needs degree + 1, and 6 is the largest degree")
        bare = Hierarchy(mesh, mesh.graph, [], [], nested=True)
        solver = PolyDGMultigrid(how.degree + 1, self.tolerance, penalty=how.penalty)
        better = solver.solve(problem, bare)
        if not (better.converged or better.rounding_limited):
            raise OptionError(f"the solution of degree {how.degree + 1} did not converge: {better.reason}")
        cells = np.arange(mesh.n_cells)
        same = frozen_int(np.stack((cells, cells), axis=1))
        given = transfer(how.basis(mesh), solution.x, solver.discretisation.basis(mesh), same)
        difference = (better.x - given).reshape(mesh.n_cells, -1)
        blocks = _diagonal_blocks(better.A, mesh.n_cells)
        energy = np.einsum("ci,cij,cj->c", difference, blocks, difference)
        return frozen_float(np.sqrt(np.maximum(energy, 0.0)))


def posed(estimator: Any, solution: Solution) -> tuple[PolyDG, Mesh, Diffusion]:
    """Return discretisation, mesh and problem of a solution, or raise OptionError for other solutions."""
    how, mesh, problem = solution.discretisation, solution.mesh, solution.problem
    if isinstance(how, PolyDG) and mesh is not None and isinstance(problem, Diffusion):
        return how, mesh, problem
    raise OptionError(
        f"{type(estimator).__name__} estimates the error of diffusion problems solved by PolyDG; given a "
        f"solution of {type(problem).__name__} by {type(how).__name__}"
    )


def _diagonal_blocks(A: Any, n_cells: int) -> Float:
    """Return the diagonal blocks ``(n_cells, k, k)`` of a matrix with k unknowns per cell."""
    size = A.shape[0] // n_cells
    blocks = sparse.bsr_array(sparse.csr_array(A), blocksize=(size, size))
    rows = np.repeat(np.arange(n_cells), np.diff(blocks.indptr))
    diagonal = np.zeros((n_cells, size, size))
    on_diagonal = rows == blocks.indices
    diagonal[rows[on_diagonal]] = blocks.data[on_diagonal]
    return diagonal
