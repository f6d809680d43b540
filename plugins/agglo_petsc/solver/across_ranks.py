"""Diffusion on a distributed mesh: each rank assembles the rows of its own cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Discretisation,
    Float,
    Int,
    Listener,
    OptionError,
    Registry,
    default,
    distributed,
    frozen_float,
    frozen_int,
    phase,
    solvers,
)
from agglo_petsc.ksp.checked_solve import solve
from agglo_petsc.ksp.level_report import level_sizes, memory_of
from agglo_petsc.ksp.pcmg import Smoother, chosen_smoother, setup
from agglo_petsc.levels.aggregates import PetscLevels, aggregate_levels
from agglo_petsc.levels.polynomials import monomials
from agglo_petsc.matrices import mat_from_rows, petsc, vector
from agglo_petsc.ranks.vertex_patches import patches_across


@dataclass(frozen=True, eq=False)
class AcrossRanks:
    """A solution on several ranks.

    Attributes
    ----------
    x : (n_own unknowns,) float
        Coefficients of the cells of this rank, by rising global id.
    iterations : int
    residuals : (iterations + 1,) float
        Relative, the same on all ranks.
    converged : bool
    reason : str
        How it ended.
    unknowns : int
        On all ranks.
    levels : int
        How many levels there are, the mesh included.
    sizes : sequence of (int, int)
        Unknowns and stored entries of each level, finest first.
    relative_residual : float
        True, in the 2-norm.
    energy_error : float, optional
        Estimate, relative.
    tests : sequence of str
        Which are passed.
    energy : float
        The work of source and fluxes.
    memory : int
        Bytes of matrices, prolongations and smoothers on all ranks.
    seconds : mapping
        Of the slowest rank, by phase.
    choice : str
        What the levels are.
    """

    x: Float
    iterations: int
    residuals: Float
    converged: bool
    reason: str
    unknowns: int
    levels: int
    sizes: Sequence[tuple[int, int]]
    relative_residual: float
    energy_error: float | None
    tests: Sequence[str]
    energy: float
    memory: int
    seconds: Mapping[str, float]
    choice: str


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of the own cells, with global columns: cells are numbered rank after rank."""

    A: Any
    b: Float
    load: Float
    near_null: Float
    number: Int  # of each local cell, ghosts too
    width: int


def solve_across(
    problem: Diffusion,
    hierarchy: distributed.DistributedHierarchy,
    *,
    degree: int = 1,
    tolerance: float = 1e-6,
    max_iterations: int = 300,
    smoother: Smoother = "auto",
    petsc_options: str = "",
    registry: Registry | None = None,
) -> AcrossRanks:
    """Solve −∇·(κ∇u) = f on a distributed mesh with PETSc's conjugate gradients and our levels; collective.

    Each rank assembles the rows of its cells, with the sharp penalty. Levels are those of the hierarchy, also
    those on fewer ranks: the others have no rows there. The coarsest is solved directly.

    Parameters
    ----------
    problem : Diffusion
        Data are numbers, functions, or given by tag; arrays of cells are not.
    hierarchy : DistributedHierarchy
        Of the mesh, nested.
    degree : int
        Of the polynomials in each cell.
    tolerance, max_iterations
        As for :func:`~agglo_petsc.ksp.checked_solve.solve`.
    smoother, petsc_options
        As for :func:`~agglo_petsc.ksp.pcmg.setup`.
    registry : Registry, optional
        Where ``polydg_mg`` is looked up, whose discretisation this is; by default that of the program.

    Raises
    ------
    OptionError
        If the hierarchy is not nested, or problem and mesh do not fit.
    RankError
        For what fails on another rank.
    """
    known = default() if registry is None else registry
    how = known.build("discretisation", "polydg", degree=degree)
    options: Any = {"smoother": smoother, "petsc_options": petsc_options}
    return solved_across(
        problem, hierarchy, how, degree, tolerance=tolerance, max_iterations=max_iterations, options=options
    )


def solved_across(
    problem: Diffusion,
    hierarchy: distributed.DistributedHierarchy,
    how: Discretisation,
    degree: int,
    *,
    tolerance: float,
    max_iterations: int,
    options: Mapping[str, Any],
    levels: int | None = None,
    progress: Listener | None = None,
) -> AcrossRanks:
    """As :func:`solve_across`, for any discretisation and options of :func:`~agglo_petsc.ksp.pcmg.setup`."""
    mesh, PETSc, watch = hierarchy.mesh, petsc(), solvers.Stopwatch()
    if levels is not None and levels > len(hierarchy.levels) + 1:
        raise OptionError(f"levels = {levels} with the mesh; there are {len(hierarchy.levels) + 1}")
    with watch("assemble"), phase(progress, "assembling"):
        rows = _assembled(problem, mesh, how, degree)
    comm = PETSc.Comm(mesh.ranks.comm)
    with watch("setup"), phase(progress, "setting up the levels"):
        A = mat_from_rows(rows.A, comm, len(rows.b), (rows.width, rows.width))
        count = len(hierarchy.levels) if levels is None else levels - 1
        patches = options["smoother"] not in ("blocks", "sor")
        found = _levels(A, rows, hierarchy, count, patches=patches)
        ksp = PETSc.KSP().create(comm)
        ksp.setOptionsPrefix("agglo_across_")
        ksp.setOperators(A)
        ksp.setType("cg")
        setup(ksp, found, **options)
    with watch("solve"), phase(progress, "solving"):
        history = solve(ksp, vector(A, rows.b), tolerance=tolerance, max_iterations=max_iterations)
    ranks, sizes = mesh.ranks, level_sizes(ksp)
    smoother = chosen_smoother(found) if options["smoother"] == "auto" else options["smoother"]
    on = "one rank" if ranks.size == 1 else f"{ranks.size} ranks"
    return AcrossRanks(
        x=frozen_float(history.x),
        iterations=len(history.residuals) - 1,
        residuals=frozen_float(history.residuals),
        converged=history.converged,
        reason=history.reason,
        unknowns=A.getSize()[0],
        levels=len(sizes),
        sizes=sizes,
        relative_residual=float(history.relative_residual),
        energy_error=history.energy_error,
        tests=history.tests,
        energy=ranks.summed(float(rows.load @ history.x)),
        memory=memory_of(ksp),
        seconds={name: ranks.largest(each) for name, each in watch.wall.items()},
        choice=f"{count} levels of agglomerates, {smoother}, PETSc on {on}, each with its own cells",
    )


def _assembled(
    problem: Diffusion, mesh: distributed.DistributedMesh, how: Discretisation, degree: int
) -> _Rows:
    """Rows of own cells, assembled where ghosts have their neighbours, too: penalties look at both cells."""
    ranks = mesh.ranks
    wide, ids = distributed.with_second_layer(mesh)
    first = sum(ranks.gathered(len(mesh.own))[: ranks.rank])
    number = frozen_int(mesh.exchange(first + np.arange(len(mesh.own))))
    half = ranks.largest(float(np.abs(mesh.local.points - mesh.local.origin).max(initial=0.0)))
    with ranks.together():
        own = mesh.global_ids[mesh.own]
        if not len(own):
            raise OptionError(f"rank {ranks.rank} has no cells: share the mesh out among fewer ranks")
        system, cells = how.assemble(problem, wide), np.searchsorted(ids, own)
        width = int(system.block_offsets[1])
        entries = _unknowns(cells, width)
        A = sparse.csr_array(sparse.csr_array(system.A)[entries])
        place = np.full(len(ids), -1)
        place[np.searchsorted(ids, mesh.global_ids)] = number  # rows of own cells reach no farther
        columns = place[A.indices // width] * width + A.indices % width
        fields = monomials(wide.dim, degree, mesh.local.origin, half)
        near = np.stack([how.project(wide, each)[entries] for each in fields], axis=1)
        shape = (len(entries), mesh.n_cells * width)
        given = sparse.csr_array((A.data, columns, A.indptr), shape=shape)
        load = how.load(problem, wide, system.b)[entries]
        b, near_null = frozen_float(system.b[entries]), frozen_float(near)
        return _Rows(given, b, frozen_float(load), near_null, number, width)


def _levels(
    A: Any, rows: _Rows, hierarchy: distributed.DistributedHierarchy, count: int, *, patches: bool
) -> PetscLevels:
    """The finest levels, so many; their parts may lie on other ranks than the cells."""
    mesh = hierarchy.mesh
    rank = mesh.ranks.rank
    aggregates = [hierarchy.parents(k - 1) if k else hierarchy.levels[0] for k in range(count)]
    owned = [int(bounds[rank + 1] - bounds[rank]) for bounds in hierarchy.bounds[:count]]
    found = None
    if patches and mesh.local.dim == 2:  # in space their matrices are large
        numbers = [rows.number, *(frozen_int(mesh.exchange(each)) for each in hierarchy.levels[: count - 1])]
        cells = np.concatenate(([0], np.cumsum(mesh.ranks.gathered(len(mesh.own)))))
        bounds = [frozen_int(cells), *hierarchy.bounds[: count - 1]]
        found = [patches_across(mesh, *each) for each in zip(numbers, bounds, strict=True)]
    offsets = frozen_int(rows.width * np.arange(len(rows.b) // rows.width + 1))
    return aggregate_levels(A, aggregates, rows.near_null, block_offsets=offsets, patches=found, owned=owned)


def _unknowns(cells: Int, width: int) -> Int:
    return frozen_int((cells[:, None] * width + np.arange(width)).ravel())
