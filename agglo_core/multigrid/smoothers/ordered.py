"""Block Gauss–Seidel in a given order of patches, for matrices that need not be symmetric."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen, frozen_float, frozen_index, frozen_int
from agglo_core.multigrid.kernels.block_sweeps import block_sweeps
from agglo_core.multigrid.smoothers.patch_smoother import slices
from agglo_core.multigrid.stack import Real
from agglo_core.problems import Patches


class OrderedGaussSeidel:
    """Sweeps through patches in the given order, before and after the coarse correction.

    A step solves for the unknowns of a patch. Where convection dominates and the order is downstream, a
    sweep nearly solves the system.

    Parameters
    ----------
    A : (n, n) sparse
        Matrix with equal blocks, not necessarily symmetric.
    width : int
        Unknowns per part.
    patches : Patches
        Patches of parts, possibly overlapping, in the order of the sweeps. Parts in no patch stay unchanged.

    Raises
    ------
    LinAlgError
        If the matrix is singular on a patch.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import OrderedGaussSeidel
    >>> from agglo_core.problems import Patches
    >>> A = sparse.csr_array([[2.0, -1.0], [0.0, 2.0]])
    >>> OrderedGaussSeidel(A, 1, Patches(np.array([0, 1, 2]), np.array([1, 0]))).before(np.array([2.0, 4.0]))
    (array([2., 2.]), array([0., 0.]))
    """

    def __init__(self, A: Any, width: int, patches: Patches) -> None:
        blocks = sparse.bsr_array(A, blocksize=(width, width))
        rows, entries = slices(frozen_int(blocks.indptr), frozen_int(patches.parts))
        columns, data = frozen_index(blocks.indices[entries]), frozen_float(blocks.data[entries])
        starts, inverses = _inverses(patches, rows, columns, data)
        pattern = frozen_int(patches.offsets), frozen_index(patches.parts)
        self._A, self._arrays = A, (*pattern, starts, inverses, rows, columns, data)
        self._sweep = block_sweeps(width)[1]

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a sweep from 0, and the residual b − A x."""
        x = self.after(b, np.zeros(len(b)))
        return x, b - self._A @ x

    def after(self, b: Real, x: Real) -> Real:
        """Return x ``(n,)`` after a further sweep."""
        swept = np.array(x, np.float64)
        self._sweep(*self._arrays, frozen(b, np.float64), swept, 1)
        return swept


def _inverses(patches: Patches, rows: Int, columns: Any, data: Float) -> tuple[Int, Float]:
    """Return the transposed inverse of the matrix on each patch, and where it starts.

    Row s of blocks, that of ``patches.parts[s]``, has the entries ``rows[s]:rows[s + 1]``.
    """
    width, sizes = data.shape[1], np.diff(patches.offsets)
    starts = np.concatenate(([0], np.cumsum((sizes * width) ** 2)))
    # 1. Place of each entry's column in the patch of its row
    patch = np.repeat(np.arange(len(sizes)), sizes)
    n_parts = max(int(patches.parts.max(initial=0)), int(columns.max(initial=0))) + 1
    keys = patch * n_parts + patches.parts
    order = np.argsort(keys)
    row = np.repeat(np.arange(len(patch)), np.diff(rows))
    wanted = patch[row] * n_parts + columns
    place = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(order) - 1)]
    inside = np.flatnonzero(keys[place] == wanted)
    inside = inside[np.argsort(sizes[patch[row[inside]]], kind="stable")]
    row, place = row[inside], place[inside]
    # 2. Dense matrices of all patches of a size, inverted
    inverses, of_size = np.empty(starts[-1]), sizes[patch[row]]
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        some = slice(*np.searchsorted(of_size, [size, size + 1]))
        number = np.searchsorted(chosen, patch[row[some]])
        first = patches.offsets[patch[row[some]]]
        dense = np.zeros((len(chosen), size, width, size, width))
        dense[number, row[some] - first, :, place[some] - first, :] = data[inside[some]]
        dense = dense.reshape(len(chosen), size * width, size * width)
        try:
            inverted = np.linalg.inv(dense)
        except np.linalg.LinAlgError:
            at = chosen[np.argmin(np.abs(np.linalg.det(dense)))]
            parts = patches.parts[patches.offsets[at] : patches.offsets[at + 1]]
            raise np.linalg.LinAlgError(f"the matrix is singular on the parts {parts.tolist()}") from None
        places = starts[chosen][:, None] + np.arange((size * width) ** 2)
        inverses[places] = inverted.transpose(0, 2, 1).reshape(len(chosen), -1)
    return frozen_int(starts), frozen_float(inverses)
