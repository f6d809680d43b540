"""Build multigrid levels by smoothed agglomeration: few iterations on any mesh.

Each level is smoothed by vertex patches or, cheaper in 3-D, cell by cell. Prolongations are injections
between polynomials on nested agglomerates, smoothed by a damped block Jacobi step; coarse matrices are
Galerkin products. Each cell's unknowns are scaled so that its diagonal block is the identity:
otherwise single precision would lose all digits in the blocks of flat cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, OptionError, frozen_int, multigrid
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.auxiliary.conforming_stack import cell_sweeps
from agglo_polydg_mg.auxiliary.transfer import block_matrix
from agglo_polydg_mg.space.basis import Basis

_DENSE = 1500
"""Number of unknowns up to which a level is the coarsest, and inverted. A larger value gives fewer levels,
but the time of the inverse grows with its cube (benchmarks/solid_ratios.py --meshes solids)."""


def patch_stack(
    basis: Basis,
    A: Any,
    labels: Sequence[Int],
    dtype: Any = np.float64,
    *,
    damping: float = 4 / 3,
    overlap: bool = True,
    coarse_degree: int | None = None,
    tensors: Float | None = None,
) -> multigrid.LevelStack:
    """Build multigrid levels of polynomials on agglomerates, down to at most 1500 unknowns.

    Parameters
    ----------
    basis : Basis
        Basis on the mesh.
    A : (n, n) sparse
        Symmetric and positive definite matrix in that basis.
    labels : sequence of (n_cells,) int
        Agglomerate of each cell on the coarse levels, finest first, each nested in the next. About 8 cells
        per agglomerate, and 8 agglomerates per agglomerate of the next level, serve well.
    dtype : numpy dtype
        Cycle precision: float32 takes half the memory, less time, and as few iterations.
    damping : float
        Damping of :func:`~agglo_core.multigrid.smoothed_prolongation`.
    overlap : bool
        Smooth vertex patches instead of single cells and agglomerates (block Gauss–Seidel).
    coarse_degree : int, optional
        Polynomial degree on agglomerates; by default the degree on the mesh.
    tensors : (n_cells, d, d) float, optional
        Coefficient per cell, along which the patches of the mesh extend.

    Raises
    ------
    OptionError
        If a level's labels are not nested in the next.
    LinAlgError
        If A is not positive definite.
    """
    mesh, low = basis.mesh, basis.degree if coarse_degree is None else min(basis.degree, coarse_degree)
    # 1. Scale the diagonal blocks to the identity
    fine = block_matrix(A, basis.n_local)
    fine.sort_indices()
    A, T, LT = multigrid.block_scaled(fine)
    levels: list[multigrid.Level] = []
    scaling, cell_labels = T, frozen_int(np.arange(mesh.n_cells))
    for at, coarse in enumerate(labels):
        if A.shape[0] <= _DENSE:
            break
        # 2. Prolongation: injection from the next level, smoothed
        nested = multigrid.parents(cell_labels, coarse)
        if nested is None:
            raise OptionError(
                f"the agglomerates of level {at} are not unions of agglomerates of the finer level; "
                "agglomerate with nested=True"
            )
        below = Basis(mesh.coarsen(coarse), low, basis.scaled)
        P = multigrid.smoothed_prolongation(
            A, LT @ project_between(basis, below, nested), damping, scaled=True
        )
        # 3. Smoother
        offsets, patches = _offsets(A, basis.n_local), None
        smoother: Any = None
        if overlap:
            patches = multigrid.vertex_patches(mesh, cell_labels if at else None, tensors=tensors)
            smoother = multigrid.VertexPatches(A, patches, dtype)
        else:
            smoother = cell_sweeps(A, offsets, dtype)
        finer = smoother.A if overlap else A.astype(dtype)
        # 4. Scaled Galerkin matrix
        A, T, LT = multigrid.block_scaled(multigrid.galerkin(A, P))
        P = sparse.bsr_array(P @ T.T).astype(dtype)
        levels.append(multigrid.Level(finer, offsets, P, smoother, cell_labels, patches))
        basis, cell_labels = below, coarse
    # 5. Coarsest level
    levels.append(multigrid.Level(A.astype(dtype), _offsets(A, basis.n_local), labels=cell_labels))
    return multigrid.LevelStack(levels, multigrid.direct_solver(A, dtype, _DENSE), dtype, scaling)


def _offsets(A: Any, width: int) -> Int:
    return frozen_int(np.arange(0, A.shape[0] + 1, width))
