"""Solution of diffusion problems on distributed meshes, where each rank assembles the rows of its cells."""

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
from agglo_petsc.ksp.pcmg import Smoother, choose_smoother, setup
from agglo_petsc.levels.aggregates import PetscLevels, aggregate_levels
from agglo_petsc.levels.polynomials import monomials
from agglo_petsc.matrices import mat_from_rows, petsc, vector
from agglo_petsc.ranks.vertex_patches import patches_across


@dataclass(frozen=True, eq=False)
class AcrossRanks:
    """Result of a solve on a distributed mesh: this rank's coefficients, and the iteration history.

    Attributes
    ----------
    x : (n_own unknowns,) float
        Coefficients on the cells of this rank, by increasing global id.
    iterations : int
    residuals : (iterations + 1,) float
        Relative, equal on all ranks.
    converged : bool
    reason : str
        Reason for the end of the iteration.
    unknowns : int
        Total number on all ranks.
    levels : int
        Level count, including the mesh.
    sizes : sequence of (int, int)
        Numbers of unknowns and stored entries per level, finest first.
    relative_residual : float
        True residual, in the 2-norm.
    energy_error : float, optional
        Relative estimate.
    tests : sequence of str
        Passed tests.
    energy : float
        Work of source and fluxes.
    memory : int
        Bytes of matrices, prolongations and smoothers on all ranks.
    seconds : mapping
        The slowest rank's time, by phase.
    choice : str
        Level description.
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
    """This rank's matrix rows and vectors, with cells numbered rank after rank."""

    A: Any
    b: Float
    load: Float
    near_null: Float
    number: Int  # of each local cell, including ghosts
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
    """Solve −∇·(κ∇u) = f on a distributed mesh with PETSc's conjugate gradients. Collective.

    Each rank assembles the rows of its cells, with the sharp penalty. The preconditioner uses the levels of
    the hierarchy, including levels on fewer ranks: other ranks have no rows there. The coarsest level is
    solved directly.

    Parameters
    ----------
    problem : Diffusion
        Data may be numbers, functions, or given by tag, but not cell arrays.
    hierarchy : DistributedHierarchy
        A nested hierarchy of the mesh.
    degree : int
        Polynomial degree in each cell.
    tolerance, max_iterations
        See :func:`~agglo_petsc.ksp.checked_solve.solve`.
    smoother, petsc_options
        See :func:`~agglo_petsc.ksp.pcmg.setup`.
    registry : Registry, optional
        Registry for the discretisation of ``polydg_mg``; by default the program's.

    Raises
    ------
    OptionError
        If the hierarchy is not nested, or problem and mesh do not fit.
    RankError
        For errors on another rank.
    """
    components = default() if registry is None else registry
    discretisation = components.build("discretisation", "polydg", degree=degree)
    options: Any = {"smoother": smoother, "petsc_options": petsc_options}
    return solve_discretised(
        problem,
        hierarchy,
        discretisation,
        degree,
        tolerance=tolerance,
        max_iterations=max_iterations,
        options=options,
    )


def solve_discretised(
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
    """Solve as :func:`solve_across` does, but with any discretisation.

    ``options`` are passed to :func:`~agglo_petsc.ksp.pcmg.setup`.
    """
    mesh, PETSc, watch = hierarchy.mesh, petsc(), solvers.Stopwatch()
    if levels is not None and levels > len(hierarchy.levels) + 1:
        raise OptionError(f"levels = {levels}, but with the mesh there are {len(hierarchy.levels) + 1}")
    # 1. Assemble
    with watch("assemble"), phase(progress, "assembling"):
        rows = _assemble_own_rows(problem, mesh, how, degree)
    comm = PETSc.Comm(mesh.ranks.comm)
    # 2. Set up the levels
    with watch("setup"), phase(progress, "setting up the levels"):
        A = mat_from_rows(rows.A, comm, len(rows.b), (rows.width, rows.width))
        count = len(hierarchy.levels) if levels is None else levels - 1
        patches = options["smoother"] not in ("blocks", "sor")
        petsc_levels = _levels(A, rows, hierarchy, count, patches=patches)
        ksp = PETSc.KSP().create(comm)
        ksp.setOptionsPrefix("agglo_across_")
        ksp.setOperators(A)
        ksp.setType("cg")
        setup(ksp, petsc_levels, **options)
    # 3. Solve
    with watch("solve"), phase(progress, "solving"):
        history = solve(ksp, vector(A, rows.b), tolerance=tolerance, max_iterations=max_iterations)
    assert history.relative_residual is not None  # solve measures it
    ranks, sizes = mesh.ranks, level_sizes(ksp)
    smoother = choose_smoother(petsc_levels) if options["smoother"] == "auto" else options["smoother"]
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
        relative_residual=history.relative_residual,
        energy_error=history.energy_error,
        tests=history.tests,
        energy=ranks.summed(float(rows.load @ history.x)),
        memory=memory_of(ksp),
        seconds={name: ranks.largest(value) for name, value in watch.wall.items()},
        choice=f"{count} levels of agglomerates, {smoother}, PETSc on {on}, each with its own cells",
    )


def _assemble_own_rows(
    problem: Diffusion, mesh: distributed.DistributedMesh, discretisation: Discretisation, degree: int
) -> _Rows:
    """Assemble the matrix rows of the cells owned by this rank.

    A second ghost layer gives the ghosts their neighbours, too: penalties depend on both cells.
    """
    ranks = mesh.ranks
    # 1. Wider mesh, and global cell numbers
    wide, ids = distributed.with_second_layer(mesh)
    first = sum(ranks.gathered(len(mesh.own))[: ranks.rank])
    number = frozen_int(mesh.exchange(first + np.arange(len(mesh.own))))
    half = ranks.largest(float(np.abs(mesh.local.points - mesh.local.origin).max(initial=0.0)))
    with ranks.together():
        own_ids = mesh.global_ids[mesh.own]
        if not len(own_ids):
            raise OptionError(f"rank {ranks.rank} has no cells: distribute the mesh over fewer ranks")
        solvers.require_symmetric_problem(problem, "petsc_mg")
        # 2. Rows of own cells, with global columns
        system, cells = discretisation.assemble(problem, wide), np.searchsorted(ids, own_ids)
        width = int(system.block_offsets[1])
        entries = _unknowns(cells, width)
        A = sparse.csr_array(sparse.csr_array(system.A)[entries])
        place = np.full(len(ids), -1)
        place[np.searchsorted(ids, mesh.global_ids)] = number  # rows of own cells have no other columns
        columns = place[A.indices // width] * width + A.indices % width
        # 3. Near-null vectors and loads
        fields = monomials(wide.dim, degree, mesh.local.origin, half)
        near = np.stack([discretisation.project(wide, field)[entries] for field in fields], axis=1)
        shape = (len(entries), mesh.n_cells * width)
        global_rows = sparse.csr_array((A.data, columns, A.indptr), shape=shape)
        load = discretisation.load(problem, wide, system.b)[entries]
        b, near_null = frozen_float(system.b[entries]), frozen_float(near)
        return _Rows(global_rows, b, frozen_float(load), near_null, number, width)


def _levels(
    A: Any, rows: _Rows, hierarchy: distributed.DistributedHierarchy, count: int, *, patches: bool
) -> PetscLevels:
    """Build the ``count`` finest multigrid levels, where parts may be on other ranks than their cells."""
    mesh = hierarchy.mesh
    rank = mesh.ranks.rank
    aggregates = [hierarchy.parents(k - 1) if k else hierarchy.levels[0] for k in range(count)]
    owned = [int(bounds[rank + 1] - bounds[rank]) for bounds in hierarchy.bounds[:count]]
    level_patches = None
    if patches and mesh.local.dim == 2:  # in 3-D their matrices are large
        numbers = [rows.number, *(frozen_int(mesh.exchange(item)) for item in hierarchy.levels[: count - 1])]
        cells = np.concatenate(([0], np.cumsum(mesh.ranks.gathered(len(mesh.own)))))
        bounds = [frozen_int(cells), *hierarchy.bounds[: count - 1]]
        level_patches = [patches_across(mesh, *item) for item in zip(numbers, bounds, strict=True)]
    offsets = frozen_int(rows.width * np.arange(len(rows.b) // rows.width + 1))
    return aggregate_levels(
        A, aggregates, rows.near_null, block_offsets=offsets, patches=level_patches, owned=owned
    )


def _unknowns(cells: Int, width: int) -> Int:
    return frozen_int((cells[:, None] * width + np.arange(width)).ravel())
