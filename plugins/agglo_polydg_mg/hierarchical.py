"""Estimator of the error in the DG norm, by cell."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from agglo_core.authoring import (
    Diffusion,
    Float,
    Hierarchy,
    OptionError,
    Solution,
    frozen_float,
    frozen_int,
    solvers,
)
from agglo_polydg_mg.auxiliary.transfer import diagonal_blocks
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
        how, mesh, problem = solution.discretisation, solution.mesh, solution.problem
        if not (isinstance(how, PolyDG) and mesh is not None and isinstance(problem, Diffusion)):
            raise OptionError(
                "Hierarchical estimates the error of diffusion problems solved by PolyDG; given a solution "
                f"of {type(problem).__name__} by {type(how).__name__}"
            )
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
        blocks = diagonal_blocks(better.A, difference.shape[1])
        energy = np.einsum("ci,cij,cj->c", difference, blocks, difference)
        return frozen_float(np.sqrt(np.maximum(energy, 0.0)))
