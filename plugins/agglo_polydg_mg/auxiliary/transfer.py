"""Transfer unknowns between the levels of a hierarchy.

The spaces of two levels are nested if every coarse agglomerate is a union of fine agglomerates: then
prolongation is injection. Otherwise it is the L2 projection. All agglomerates are unions of fine cells, so
the required products are sums over the fine mesh: with J_k the injection of level k into the fine space and
M the fine mass matrix, P = (J_kᵀ M J_k)⁻¹ J_kᵀ M J_{k+1}.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, frozen_float
from agglo_polydg_mg.space.basis import block_diagonal


def l2_projection(fine: Any, coarse: Any, mass: Any, width: int) -> sparse.bsr_array:
    """Return the prolongation between spaces that are not nested, the L2 projection.

    Parameters
    ----------
    fine, coarse : sparse
        Injections J_k and J_{k+1} of both levels into the fine space.
    mass : sparse
        Mass matrix M of the mesh.
    width : int
        Unknowns per cell.
    """
    weighted = sparse.bsr_array(fine.T @ mass, blocksize=(width, width))
    inverses = frozen_float(np.linalg.inv(diagonal_blocks(weighted @ fine, width)))
    return block_diagonal(inverses) @ sparse.bsr_array(weighted @ coarse, blocksize=(width, width))


def block_matrix(A: Any, width: int) -> sparse.bsr_array:
    """Convert ``A`` to a block matrix with block size ``width``, with 32-bit indices if they suffice."""
    return sparse.bsr_array(A, blocksize=(width, width))


def diagonal_blocks(A: Any, width: int) -> Float:
    """Return the diagonal blocks ``(n, w, w)`` of a square matrix, zero where none is stored."""
    bsr = block_matrix(A, width)
    n = bsr.shape[0] // width
    rows = np.repeat(np.arange(n), np.diff(bsr.indptr))
    on = rows == bsr.indices
    blocks = np.zeros((n, width, width))
    blocks[rows[on]] = bsr.data[on]
    return blocks
