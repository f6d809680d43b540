"""Functions for tests on several ranks, run by ``mpiexec``.

Rank 0 prints the answers as JSON: ``mpiexec -n 3 python tests/plugins/petsc_ranks.py``
"""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec

import numpy as np
from mpi4py import MPI
from scipy import sparse

import agglo_core as agglo
import agglo_petsc
from agglo_core.arrays import frozen_int
from agglo_core.distributed import DistributedMesh, Ranks, agglomerate
from agglo_core.errors import OptionError
from agglo_core.multigrid import vertex_patches
from agglo_core.problems import Diffusion, Linear, Patches
from agglo_core.registry import default
from agglo_petsc.matrices import petsc, vector
from agglo_petsc.ranks.patch_sweeps import LevelSweeps
from agglo_petsc.ranks.vertex_patches import patches_across

COMM = MPI.COMM_WORLD
PETSc = petsc()
STRAIGHT = {"bisector": "coordinate", "refiners": (), "polish": False}  # few kernels to compile


def polydg() -> dict[str, object]:
    """Solve PolyDG on Voronoi cells, on one rank and on all ranks.

    Returns iterations, the largest difference in x, and convergence.
    """
    mesh = agglo.samples.voronoi(400, seed=31)
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(8, 32), **STRAIGHT)
    found: dict[str, object] = {}
    for smoother in ("sweeps", "patches", "blocks", "sor"):
        one, all_ = (
            default()
            .build("solver", "petsc_mg", smoother=smoother, ranks=ranks)
            .solve(Diffusion(), hierarchy)
            for ranks in ("one", "world")
        )
        gap = float(np.abs(one.x - all_.x).max() / np.abs(one.x).max())
        found[smoother] = [one.iterations, all_.iterations, gap, all_.converged and one.converged]
    return found


def systems() -> list[float]:
    """Solve a linear system with two unknowns per cell.

    Returns the relative residual and convergence.
    """
    mesh = agglo.samples.squares(12)
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(4,), **STRAIGHT)
    links = mesh.graph.to_scipy()
    scalar = sparse.diags_array(links.sum(axis=1) + 0.01) - links
    A, b = sparse.csr_array(sparse.kron(scalar, np.eye(2))), np.random.default_rng(2).standard_normal(288)
    found = (
        default()
        .build("solver", "petsc_mg", ranks="world")
        .solve(Linear(A, b, np.arange(145) * 2), hierarchy)
    )
    return [float(np.linalg.norm(b - A @ found.x) / np.linalg.norm(b)), float(found.converged)]


def elasticity() -> list[float]:
    """Solve assembled elasticity with its rigid motions, on one rank and on all ranks.

    Returns iterations of both, and the relative residual.
    """
    mesh = agglo.samples.voronoi(400, seed=31)
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(8, 32), **STRAIGHT)
    how = default().build("discretisation", "polydg", degree=1).of_kind("elasticity")
    system = how.assemble(agglo.Elasticity(force=(0.0, -1.0)), mesh)
    problem = Linear(system.A, system.b, system.block_offsets, system.near_null)
    one, all_ = (
        default().build("solver", "petsc_mg", ranks=ranks).solve(problem, hierarchy)
        for ranks in ("one", "world")
    )
    rest = np.linalg.norm(system.b - system.A @ all_.x) / np.linalg.norm(system.b)
    return [one.iterations, all_.iterations, float(rest)]


def own_rows() -> list[float]:
    """Solve a path of 90 unknowns without rows on the first rank.

    Returns error, iterations and coarse size.
    """
    sizes = [0, *np.full(COMM.size - 1, 90 // (COMM.size - 1))]
    first = int(sum(sizes[: COMM.rank]))
    whole = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(90, 90)).tocsr()
    mine = slice(first, first + int(sizes[COMM.rank]))
    A = agglo_petsc.mat_from_rows(whole[mine], PETSc.COMM_WORLD, int(sizes[COMM.rank]))
    pairs = np.arange(first, first + sizes[COMM.rank]) // 3  # 90 / 1 and 90 / 2 are multiples of 9
    fours = np.arange(first // 3, (first + sizes[COMM.rank]) // 3) // 3
    levels = agglo_petsc.aggregate_levels(A, [pairs, fours])
    ksp = PETSc.KSP().create(PETSc.COMM_WORLD)
    ksp.setOperators(A)
    ksp.setType("cg")
    agglo_petsc.setup(ksp, levels)
    wanted = np.sin(np.arange(90.0))
    history = agglo_petsc.solve(ksp, vector(A, (whole @ wanted)[mine]), tolerance=1e-10)
    gap = COMM.allreduce(float(np.abs(history.x - wanted[mine]).max(initial=0.0)), MPI.MAX)
    return [gap, history.iterations, levels.prolongations[-1].getSize()[1]]


def wrong() -> list[str]:
    """Return the errors for an aggregate on two ranks and for missing labels.

    The errors must agree on all ranks.
    """
    n = 6
    rows = sparse.eye_array(n * COMM.size, format="csr")[n * COMM.rank : n * (COMM.rank + 1)]
    A, told = agglo_petsc.mat_from_rows(rows, PETSc.COMM_WORLD, n), []
    last = COMM.rank == COMM.size - 1
    for aggregates in (np.zeros(n, int), np.arange(n - last) // 2 + 3 * COMM.rank):
        try:
            agglo_petsc.aggregate_levels(A, [aggregates])
            told.append("nothing")
        except OptionError as error:
            told.append(str(error))
    return told if COMM.allgather(told) == [told] * COMM.size else ["ranks differ"]


def across() -> dict[str, list[float]]:
    """Solve on a distributed mesh with coarse levels on one rank.

    Returns iterations, difference and levels.
    """
    mesh = agglo.samples.voronoi(600, seed=32)
    found: dict[str, list[tuple[int, object, int]]] = {}
    for ranks in (Ranks(MPI.COMM_SELF), Ranks()):
        whole = DistributedMesh.scatter(mesh if ranks.rank == 0 else None, ranks)
        hierarchy = agglomerate(whole, agglo.Pipeline(n_parts=(75, 12, 3), **STRAIGHT))
        for smoother in ("sweeps", "patches", "blocks"):
            there = agglo_petsc.solve_across(
                Diffusion(source=8.0), hierarchy, degree=1, tolerance=1e-8, smoother=smoother
            )
            assert there.converged
            x = whole.gather(there.x.reshape(len(whole.own), -1))
            found.setdefault(smoother, []).append((there.iterations, x, there.levels))
    return {
        name: [i, j, float(np.abs(x - y).max() / np.abs(x).max()), levels]
        for name, ((i, x, _), (j, y, levels)) in found.items()
    }


def sweep() -> list[float]:
    """Compare a sweep with the planned sequence of projections, and with its transpose.

    Returns the differences.
    """
    mesh = agglo.samples.squares(8)
    whole = sparse.csr_array(mesh.graph.to_scipy() * -1.0 + sparse.diags_array(np.full(64, 5.0)))
    starts = np.linspace(0, 64, COMM.size + 1).astype(int)
    mine = slice(starts[COMM.rank], starts[COMM.rank + 1])
    A = agglo_petsc.mat_from_rows(whole[mine], PETSc.COMM_WORLD, mine.stop - mine.start)
    patches = vertex_patches(mesh)
    lists = [
        each for each in np.split(patches.parts, patches.offsets[1:-1]) if mine.start <= each[0] < mine.stop
    ]
    ends = np.concatenate(([0], np.cumsum([len(each) for each in lists])))
    sweeps = LevelSweeps(Patches(frozen_int(ends), frozen_int(np.concatenate(lists))), 1).of(A)
    b = np.random.default_rng(5).standard_normal((2, 64))
    forwards, backwards = (
        np.concatenate(COMM.allgather(how(b[k, mine])))
        for k, how in enumerate((sweeps.forwards, sweeps.backwards))
    )
    x = np.zeros(64)
    for patch in _in_order(lists, whole, starts):
        x[patch] += np.linalg.solve(whole.toarray()[np.ix_(patch, patch)], (b[0] - whole @ x)[patch])
    mirrored = abs(float(forwards @ b[1] - backwards @ b[0])) / float(np.linalg.norm(forwards))
    return [float(np.abs(forwards - x).max()), mirrored]


def _in_order(lists: list[object], whole: object, starts: object) -> list[object]:
    """Return all patches in planned order: away from borders, then of even ranks, then of odd ranks."""
    owner = np.searchsorted(starts, np.arange(64), side="right") - 1
    alone = [int(np.ptp(owner[(abs(whole) @ np.isin(np.arange(64), each)) > 0])) == 0 for each in lists]
    every = COMM.allgather((lists, alone))
    turns = [*every[::2], *every[1::2]]  # ranks form a row
    inner = [p for these, own in every for p, free in zip(these, own, strict=True) if free]
    return inner + [p for these, own in turns for p, free in zip(these, own, strict=True) if not free]


def patches() -> list[bool]:
    """Return True for cells and for agglomerates if the distributed patches equal the patches of the whole
    mesh.
    """
    mesh, found = agglo.samples.squares(12), []
    whole = DistributedMesh.scatter(mesh if COMM.rank == 0 else None, Ranks())
    labels = np.arange(144) // 12 // 3 * 4 + np.arange(144) % 12 // 3  # blocks of 3 by 3
    for parts, count in ((np.arange(144), 144), (labels, 16)):
        bounds = np.minimum(np.arange(COMM.size + 1) * 20, count)  # the last rank gets the rest
        bounds[-1] = count
        mine = patches_across(whole, frozen_int(parts[whole.global_ids]), frozen_int(bounds))
        every = [tuple(p) for each in COMM.allgather(_lists(mine)) for p in each]
        found.append(
            sorted(every) == sorted(map(tuple, _lists(vertex_patches(mesh, None if count == 144 else parts))))
        )
    return found


def _lists(patches: Patches) -> list[list[int]]:
    return [sorted(each.tolist()) for each in np.split(patches.parts, patches.offsets[1:-1]) if len(each)]


def dolfinx_poisson() -> list[float]:
    """Solve linear elements on a DOLFINx mesh with local agglomeration per rank.

    Returns iterations.
    """
    from dolfinx import fem, mesh as meshes
    from dolfinx.fem import petsc as forms
    from ufl import TestFunction, TrialFunction, dx, grad, inner

    domain = meshes.create_unit_square(COMM, 24, 24)
    space = fem.functionspace(domain, ("Lagrange", 1))
    u, v = TrialFunction(space), TestFunction(space)
    A = forms.assemble_matrix(fem.form((inner(grad(u), grad(v)) + 1e-2 * u * v) * dx))
    A.assemble()
    mesh = agglo_petsc.from_dolfinx(domain)
    levels = agglo.agglomerate(mesh, cells_per_part=(8, 64), **STRAIGHT).levels
    table = space.dofmap.list[: mesh.n_cells]
    own, cell_of = A.getLocalSize()[0], np.repeat(np.arange(mesh.n_cells), table.shape[1])
    inside = table.ravel() < own
    labels = agglo_petsc.labels_of_unknowns(table.ravel()[inside], cell_of[inside], levels, own)
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(A)
    ksp.setType("cg")
    agglo_petsc.setup(ksp, labels)
    b = vector(A, np.random.default_rng(COMM.rank).standard_normal(own))
    history = agglo_petsc.solve(ksp, b, tolerance=1e-8)
    return [history.iterations, float(history.converged)]


def plex() -> list[float]:
    """Convert a distributed DMPlex as in the how-to guide.

    Returns the values of :func:`_seen`.
    """
    whole = agglo.samples.random_triangles(150, seed=4)
    triangles = whole.boundary_loops.vertices.reshape(-1, 3).astype(np.int32)
    points, k = whole.points, whole.n_cells if COMM.rank == 0 else 0
    made = PETSc.DMPlex().createFromCellList(2, triangles[:k], points[: len(points) * (k > 0)], comm=COMM)
    made.distribute()
    first, last = made.getHeightStratum(0)
    start, stop = made.getDepthStratum(0)
    numbers = made.getVertexNumbering().getIndices()
    ids = np.where(numbers < 0, -numbers - 1, numbers)
    closures = [made.getTransitiveClosure(cell)[0] for cell in range(first, last)]
    cells = [closure[(closure >= start) & (closure < stop)] - start for closure in closures]
    mine = made.getCoordinatesLocal().array.reshape(-1, 2)
    return _seen(DistributedMesh.from_local(Ranks(made.comm.tompi4py()), mine, cells, ids), whole)


def dolfinx_mesh() -> list[float]:
    """Convert a distributed DOLFINx mesh as in the how-to guide."""
    from dolfinx import mesh as meshes

    domain = meshes.create_unit_square(COMM, 12, 12)
    own = domain.topology.index_map(domain.topology.dim).size_local
    nodes = domain.geometry.index_map()
    ids = nodes.local_to_global(np.arange(nodes.size_local + nodes.num_ghosts, dtype=np.int32))
    cells = domain.geometry.dofmap[:own]
    mesh = DistributedMesh.from_local(Ranks(domain.comm), domain.geometry.x[:, :2], cells, ids)
    return _seen(mesh, agglo.samples.triangles(12))


def _seen(mesh: DistributedMesh, whole: agglo.Mesh) -> list[float]:
    """Return cells, neighbours and mesh size relative to the whole mesh, and the share of connected parts."""
    mesh.check()
    made = agglomerate(mesh, agglo.Pipeline(cells_per_part=(8,), **STRAIGHT))
    entries = mesh.ranks.summed(float(np.diff(mesh.local.graph.indptr)[mesh.own].sum()))
    ratios = mesh.n_cells / whole.n_cells, entries / len(whole.graph.indices), mesh.h / whole.h
    return [*ratios, made.quality(0, ["UF"])["connected"]]


if __name__ == "__main__":
    asked = {
        each.__name__: each
        for each in (polydg, systems, elasticity, own_rows, wrong, across, sweep, patches, plex)
    }
    if find_spec("dolfinx"):
        asked |= {"dolfinx_poisson": dolfinx_poisson, "dolfinx_mesh": dolfinx_mesh}
    answers = {name: ask() for name, ask in asked.items()}
    if COMM.rank == 0:
        json.dump(answers, sys.stdout)
