"""Build multigrid levels for problems with convection, smoothed downstream.

Coarse spaces are polynomials on agglomerates, and the upwind form is stable there, too: functions have no
jumps inside agglomerates. Diffusion is rediscretised, because inherited penalties would be too large. Block
Gauss–Seidel passes the cells of every level along the flow (J. Bey, G. Wittum, Appl. Numer. Math. 23, 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Float,
    Int,
    Mesh,
    MeshError,
    Patches,
    frozen_float,
    frozen_index,
    frozen_int,
    multigrid,
)
from agglo_polydg_mg.auxiliary.flow_kernels import flow_order
from agglo_polydg_mg.forms.convection import face_flows
from agglo_polydg_mg.paper.level_spaces import polydg_prolongations
from agglo_polydg_mg.polydg import PolyDG, corrections
from agglo_polydg_mg.space.basis import Basis

_FEWEST = 60  # parts of the coarsest level, as in `default_levels`


def downstream_stack(
    how: PolyDG,
    problem: Diffusion,
    mesh: Mesh,
    basis: Basis,
    A: Any,
    labels: Sequence[Int],
    patches: Patches | None = None,
) -> multigrid.LevelStack:
    """Build the multigrid levels of a problem with convection, in double precision.

    Parameters
    ----------
    mesh, basis, A : Mesh, Basis, (n, n) sparse
        Mesh, basis on the mesh, and matrix of the problem in that basis.
    labels : sequence of (n_cells,) int
        Agglomerate of each cell on the coarse levels, finest first. The last level is factorised.
    patches : Patches, optional
        Cells of the mesh to smooth together. Default: single cells.

    Raises
    ------
    LinAlgError
        If the block of a cell or patch, or the matrix of the last level, is singular.
    """
    # 1. Spaces and prolongations
    meshes = [mesh, *(mesh.coarsen(each) for each in labels)]
    prolongations = polydg_prolongations([basis, *(how.basis(each) for each in meshes[1:])], labels)
    problems = [problem, *(corrections(problem, mesh, each) for each in labels)]
    parts = [frozen_int(np.arange(mesh.n_cells)), *labels]
    levels: list[multigrid.Level] = []
    for at, P in enumerate(prolongations):
        # 2. Smoother
        offsets = frozen_int(np.linspace(0, A.shape[0], meshes[at].n_cells + 1))
        order = downstream_order(meshes[at], face_flows(meshes[at], problems[at].convection))
        cells = Patches(frozen_int(np.arange(len(order) + 1)), order)
        sweeps = cells if at or patches is None else _sorted(patches, order)
        smoother = multigrid.OrderedGaussSeidel(A, int(offsets[1]), sweeps)
        levels.append(multigrid.Level(A, offsets, sparse.csr_array(P), smoother, parts[at]))
        # 3. Coarse matrix, inherited if agglomerates overlap themselves
        try:
            A = how.assemble(problems[at + 1], meshes[at + 1]).A
        except MeshError:
            A = sparse.bsr_array(P.T @ A @ P, blocksize=(int(offsets[1]), int(offsets[1])))
    # 4. Coarsest level
    offsets = frozen_int(np.linspace(0, A.shape[0], meshes[-1].n_cells + 1))
    levels.append(multigrid.Level(A, offsets, labels=parts[-1]))
    return multigrid.LevelStack(levels, multigrid.coarse_solver("lu", A))


def flow_agglomerates(mesh: Mesh, strength: Float, fewest: int, count: int | None = None) -> list[Int]:
    """Return the agglomerate of each cell ``(n_cells,)`` on the coarse levels, finest first.

    Strongly coupled parts are paired, and the pairs paired again unless few enough: agglomerates follow the
    flow where it dominates. Across closed streamlines a solution varies by diffusion alone, and wide
    agglomerates would not resolve it.

    Parameters
    ----------
    mesh : Mesh
    strength : (n_faces,) float
        Coupling through each face. Couplings between the same two parts are added.
    fewest : int
        Number of parts that ends the coarsening, after at least one level if there are more than 60 cells.
    count : int, optional
        Number of levels, counting the mesh, as long as there are more than 60 parts.
    """
    inner = mesh.face_cells[:, 1] >= 0
    faces, strength = mesh.face_cells[inner], strength[inner]
    labels, levels, n = np.arange(mesh.n_cells), list[Int](), mesh.n_cells
    while n > _FEWEST and (n > fewest or not levels or count is not None) and len(levels) + 1 != count:
        for _ in range(2):
            # Pairs of parts by descending coupling
            ends = np.sort(labels[faces], axis=1).T
            sums = sparse.csr_array((strength, ends), shape=(n, n)).tocoo()
            pairs = np.stack(sums.coords, axis=1)[np.argsort(-sums.data, kind="stable")]
            pairs = pairs[pairs[:, 0] != pairs[:, 1]]
            groups = multigrid.joined_patches(frozen_int(pairs), n, most=2)
            merged = np.empty(n, np.int64)
            merged[groups.parts] = np.repeat(np.arange(len(groups)), np.diff(groups.offsets))
            labels, n = merged[labels], len(groups)
            if n <= fewest:
                break
        if levels and n == levels[-1].max() + 1:  # parts without neighbours
            break
        levels.append(frozen_int(labels))
    return levels


def _sorted(patches: Patches, order: Int) -> Patches:
    """Return the patches by the mean position of their cells in an order."""
    sizes = np.diff(patches.offsets)
    means = np.add.reduceat(np.argsort(order)[patches.parts], patches.offsets[:-1]) / sizes
    chosen = np.argsort(means, kind="stable")
    members = np.argsort(np.repeat(np.argsort(chosen), sizes), kind="stable")
    offsets = np.concatenate(([0], np.cumsum(sizes[chosen])))
    return Patches(frozen_int(offsets), frozen_int(patches.parts[members]))


def downstream_order(mesh: Mesh, flows: Float) -> Int:
    """Return the cells ``(n_cells,)`` sorted along the flow ``(n_faces,)``, outward of the first cells.

    Each cell follows those from which it has inflow. Where streamlines are closed, the next cell is the
    one with the least inflow from later cells, relative to its whole inflow.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_polydg_mg.auxiliary.downstream import downstream_order
    >>> from agglo_polydg_mg.forms.convection import face_flows
    >>> mesh = samples.squares(2)
    >>> downstream_order(mesh, face_flows(mesh, np.array([-2.0, -1.0])))
    array([3, 1, 2, 0])
    """
    used = (mesh.face_cells[:, 1] >= 0) & (flows != 0.0)
    cells, flow = mesh.face_cells[used], flows[used]
    above, below = np.where((flow > 0.0)[:, None], cells, cells[:, ::-1]).T
    into = sparse.csr_array((np.abs(flow), (above, below)), shape=(mesh.n_cells, mesh.n_cells))
    return frozen_int(flow_order(*map(frozen_index, (into.indptr, into.indices)), frozen_float(into.data)))
