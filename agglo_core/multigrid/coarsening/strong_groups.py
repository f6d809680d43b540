"""Groups of strongly coupled blocks or unknowns, such as grid lines in anisotropic problems."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.errors import OptionError
from agglo_core.multigrid.smoothers.patch_smoother import VertexPatches
from agglo_core.multigrid.smoothers.patches import joined_patches
from agglo_core.problems import Patches

_STRONG = 0.1
"""Minimum coupling ‖A_ij‖ / (‖A_ii‖ ‖A_jj‖)^½ that joins two blocks.

Smaller: larger groups, which cost more time and memory per sweep (benchmarks/solve.py, mesh ``layers``).
"""
_RAISED = 1e-6
"""Relative increase of the diagonal, because A may be semidefinite, and singular on a group."""


def strong_groups(A: Any, most: int = 8) -> Patches:
    """Return disjoint groups of up to ``most`` blocks, formed along the strongest couplings.

    Couplings count if their norm is at least a tenth of (‖A_ii‖ ‖A_jj‖)^½, for single unknowns with either
    sign.

    Parameters
    ----------
    A : (n, n) bsr_array
        Symmetric matrix with positive definite diagonal blocks.
    most : int

    Raises
    ------
    OptionError
        If ``most`` is less than 1.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import strong_groups
    >>> A = sparse.csr_array([[2.0, -1.0, 0.0], [-1.0, 2.0, -0.1], [0.0, -0.1, 2.0]])
    >>> groups = strong_groups(A.tobsr((1, 1)))
    >>> groups.offsets.tolist(), groups.parts.tolist()
    ([0, 2, 3], [0, 1, 2])
    """
    if most < 1:
        raise OptionError(f"most, the largest number of blocks in a group, must be 1 or more; given {most!r}")
    rows, columns = np.repeat(np.arange(len(A.indptr) - 1), np.diff(A.indptr)), A.indices
    norms = np.sqrt(np.einsum("kij,kij->k", A.data, A.data))
    own = rows == columns
    root = np.ones(len(A.indptr) - 1)
    root[rows[own]] = np.sqrt(norms[own])
    upper = rows < columns
    rows, columns = rows[upper], columns[upper]
    strength = norms[upper] / (root[rows] * root[columns])
    joined = np.flatnonzero(strength >= _STRONG)
    joined = joined[np.argsort(-strength[joined], kind="stable")]
    return joined_patches(np.column_stack((rows[joined], columns[joined])), len(root), most=most)


def group_smoother(A: Any, most: int, dtype: Any = np.float64) -> VertexPatches:
    """Return symmetric block Gauss–Seidel over :func:`strong_groups`, for A plus 1e-6 times its diagonal.

    Raises
    ------
    LinAlgError
        If the matrix is indefinite on a group.
    """
    raised = sparse.csr_array(A + _RAISED * sparse.diags_array(A.diagonal()))
    raised.sort_indices()
    return VertexPatches(raised.tobsr((1, 1)), strong_groups(A.tobsr((1, 1)), most), dtype)
