"""Preparation of problems for PETSc: matrix, right-hand side, near-null vectors, level labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Discretisation,
    Float,
    Hierarchy,
    History,
    Int,
    Linear,
    Mesh,
    OptionError,
    Problem,
    Solution,
    frozen_float,
    frozen_int,
    multigrid,
    solvers,
)
from agglo_core.problems.linear import symmetric_system
from agglo_petsc.levels.polynomials import monomials


@dataclass(frozen=True, eq=False)
class PosedSystem:
    """A linear system A x = b, with labels and near-null vectors to build multigrid levels.

    Attributes
    ----------
    A : (n, n) csr
    b : (n,) float
        ``factor`` times the right-hand side: a power of two, 1 unless squares under- or overflow.
    offsets : (n_cells + 1,) int
    measure : callable
        Measures residuals of b.
    labels : list of (n_cells,) int
    near_null : (n, k) float, optional
    mesh : Mesh, optional
    means : callable, optional
        Maps x to the constants that are subtracted from it, where the problem determines x only up to them.
    """

    A: Any
    b: Float
    factor: float
    offsets: Int
    measure: Callable[[Float], float] | None
    labels: list[Int]
    near_null: Float | None
    mesh: Mesh | None
    means: Callable[[Float], Float] | None = None


def pose_system(
    problem: Problem, hierarchy: Hierarchy, how: Discretisation, degree: int, levels: int | None
) -> PosedSystem:
    """Assemble the linear system of a problem on a hierarchy's mesh, with data to build levels.

    Raises
    ------
    OptionError
        If they do not fit, or values are not finite; see also ``how`` and
        :func:`~agglo_core.problems.linear.symmetric_system`.
    MeshError
        See ``how``.
    """
    if isinstance(problem, Diffusion):
        return _pose_diffusion(problem, hierarchy, how, degree, levels)
    if isinstance(problem, Linear):
        return _pose_linear(problem, hierarchy, levels)
    raise OptionError(f"expected a Diffusion or Linear problem, given {type(problem).__name__}")


def _pose_diffusion(
    problem: Diffusion, hierarchy: Hierarchy, discretisation: Discretisation, degree: int, levels: int | None
) -> PosedSystem:
    # 1. Assemble, and check for finite values
    solvers.require_symmetric_problem(problem, "petsc_mg")
    mesh = solvers.own_mesh(hierarchy)
    system = discretisation.assemble(problem, mesh)
    matrix = sparse.csr_array(system.A)
    if not (np.isfinite(system.b).all() and np.isfinite(matrix.data).all()):
        raise OptionError("the matrix or the right-hand side has values that are not finite")
    # 2. Scale, residual measure and levels
    factor, measure = (
        solvers.factor_for(float(np.abs(system.b).max())),
        discretisation.residual_measure(problem, mesh, system.b),
    )
    labels = (
        _select_levels(hierarchy, levels) if hierarchy.levels else solvers.default_levels(hierarchy, levels)
    )
    # 3. Near-null vectors: monomials on the mesh
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    centre, half = (low + high) / 2, float((high - low).max()) / 2
    columns = [discretisation.project(mesh, field) for field in monomials(mesh.dim, degree, centre, half)]
    return PosedSystem(
        matrix,
        frozen_float(factor * system.b),
        factor,
        system.block_offsets,
        lambda r: measure(r / factor),
        labels,
        frozen_float(np.stack(columns, axis=1)),
        mesh,
        means=getattr(discretisation, "means", lambda *_: None)(problem, mesh),
    )


def _pose_linear(problem: Linear, hierarchy: Hierarchy, levels: int | None) -> PosedSystem:
    matrix, b = symmetric_system(problem)
    offsets, cells = frozen_int(problem.block_offsets), hierarchy.graph.n
    solvers.require_cells(problem, cells)
    sizes = np.diff(offsets)
    if sizes.min() < 1:
        raise OptionError(f"every cell must have an unknown; cell {int(sizes.argmin())} has {sizes.min()}")
    near, factor = problem.near_null, solvers.factor_for(float(np.abs(b).max(initial=0.0)))
    B = None if near is None else frozen_float(np.asarray(near, np.float64).reshape(len(b), -1))
    labels = _select_levels(hierarchy, levels) if hierarchy.levels else []
    scaled = frozen_float(factor * b)
    measure = multigrid.row_measure(matrix, scaled)
    return PosedSystem(matrix, scaled, factor, offsets, measure, labels, B, None)


def _select_levels(hierarchy: Hierarchy, levels: int | None) -> list[Int]:
    """Return the labels of the finest levels, for a requested level count including the mesh."""
    if levels is not None and levels > len(hierarchy.levels) + 1:
        raise OptionError(f"levels = {levels}, but with the mesh there are {len(hierarchy.levels) + 1}")
    return list(hierarchy.levels)[: None if levels is None else levels - 1]


def solution_of(
    system: PosedSystem, history: History, operators: Any, watch: solvers.Stopwatch, tolerance: float
) -> Solution:
    """Return the solution object for an iteration history, with run times from ``watch``.

    Raises
    ------
    OptionError
        If it exceeds the floating-point range.
    """
    x, b = solvers.unscaled(history.x, system.factor), system.b / system.factor
    if system.means is not None:
        means = system.means(x)
        x, b = frozen_float(x - means), b - system.A @ means
    return Solution(
        x=x,
        A=system.A,
        b=frozen_float(b),
        operators=operators,
        residuals=frozen_float(history.residuals / system.factor),
        converged=history.converged,
        reason=history.reason,
        iterations=history.iterations,
        seconds=watch.wall,
        cpu_seconds=watch.cpu,
        energy_error=history.energy_error,
        tests=history.tests,
        tolerance=tolerance,
        backward_error=history.backward_error,
        rounding_limited=history.ended == "rounding",
    )
