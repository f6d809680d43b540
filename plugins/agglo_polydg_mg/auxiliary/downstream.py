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
    frozen_int,
    multigrid,
)
from agglo_core.fields.corrections import corrections
from agglo_polydg_mg.forms.convection import face_flows
from agglo_polydg_mg.paper.level_spaces import polydg_prolongations
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis


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
    return multigrid.downstream_order(into)
