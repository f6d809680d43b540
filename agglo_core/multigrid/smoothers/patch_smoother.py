"""Schwarz smoothing on patches: exact solves in overlapping groups of parts, in turn.

For discontinuous polynomials, cell-wise smoothing does not reduce the continuous part of the error, but
patches around vertices do. J. Schöberl, J. M. Melenk, C. Pechstein, S. Zaglmayr, "Additive Schwarz
preconditioning for p-version triangular and tetrahedral finite elements", IMA J. Numer. Anal. 28 (2008).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.block_sweeps import block_sweeps, clear_tiny
from agglo_core.multigrid.kernels.patch_factors import patch_factors, patch_orders
from agglo_core.multigrid.kernels.patch_sweeps import patch_inverses, patch_sweep
from agglo_core.multigrid.matrices.block_matrix import in_precision
from agglo_core.multigrid.stack import Real
from agglo_core.problems import MultigridLevel, Patches

_TINY = 1e-22  # relative to the largest value: smaller values become 0 in single precision
_CUBICS = 10
"""Block size of cubics, where overlapping patches are most useful: factors are compiled for this size.

Other sizes share a kernel (benchmarks/solve.py).
"""


class _Groups:
    """Disjoint patches with inverses and matrix rows in patch order, for sweeps.

    Backward sweeps have separate arrays, so that memory is always read from the beginning.
    """

    def __init__(self, A: Any, patches: Patches, dtype: Any, some: bool) -> None:
        # 1. Invert the matrix on each patch
        self.offsets, self.parts = _check_patches(A, patches, some)
        pattern, sizes = _pattern(A), np.diff(self.offsets) * int(A.blocksize[0])
        self.starts = frozen_int(np.concatenate(([0], np.cumsum(sizes**2))))
        values = np.empty(self.starts[-1], dtype)
        bad_patch = patch_inverses(
            self.offsets, self.parts, *pattern, frozen(A.data, A.dtype), self.starts, values
        )
        _require_definite(bad_patch, self.offsets, self.parts)
        self.inverses = frozen(values, dtype)
        # 2. Copy them, and the matrix rows, in both orders
        groups, blocks = np.arange(len(sizes)), in_precision(A, dtype).data
        self.forwards, self.backwards = (self._ordered(groups[::step], *pattern, blocks) for step in (1, -1))

    def _ordered(self, groups: Int, indptr: Int, indices: Any, blocks: Real) -> tuple[Any, ...]:
        """Return groups in another order: offsets, parts, starts, inverses, and matrix rows (BSR)."""
        offsets, members = slices(self.offsets, groups)
        starts, values = slices(self.starts, groups)
        parts = self.parts[members]
        rows, entries = slices(indptr, parts)
        inverses = frozen(self.inverses[values], self.inverses.dtype)
        matrix = rows, frozen_index(indices[entries]), frozen(blocks[entries], blocks.dtype)
        return offsets, frozen_index(parts), starts, inverses, *matrix


def slices(starts: Int, chosen: Int) -> tuple[Int, Int]:
    """Concatenate chosen index ranges ``starts[i]:starts[i + 1]``, and return new offsets and all indices."""
    sizes = starts[chosen + 1] - starts[chosen]
    begin = np.concatenate(([0], np.cumsum(sizes)))
    return frozen_int(begin), frozen_int(np.repeat(starts[chosen] - begin[:-1], sizes) + np.arange(begin[-1]))


class _Factors:
    """Block factors L D Lᵀ of a matrix on patches."""

    def __init__(self, A: Any, patches: Patches, dtype: Any, some: bool) -> None:
        self.offsets, parts = _check_patches(A, patches, some)
        width = int(A.blocksize[0])
        ordered, starts, below = patch_orders(self.offsets, parts, *_pattern(A))
        self.parts, self.starts, self.below = frozen_index(ordered), frozen_int(starts), frozen_index(below)
        pivots, blocks = (np.empty((len(array), width, width), dtype) for array in (ordered, below))
        pattern = self.offsets, self.parts, self.starts, self.below
        factorise = patch_factors(width if width == _CUBICS else 0)
        bad_patch = factorise(*pattern, *_pattern(A), frozen(A.data, A.dtype), pivots, blocks)
        _require_definite(bad_patch, self.offsets, self.parts)
        self.pivots, self.blocks = (_without_tiny(array.reshape(-1)) for array in (pivots, blocks))

    @property
    def arrays(self) -> tuple[Int, Any, Int, Any, Any, Any]:
        return self.offsets, self.parts, self.starts, self.below, self.pivots, self.blocks


def _without_tiny(values: Real) -> Real:
    """Set tiny values to 0 in single precision, to avoid slow denormals."""
    if values.dtype == np.float32 and len(values):
        clear_tiny(values, values.dtype.type(_TINY * max(values.max(), -values.min())))
    return frozen(values, values.dtype)


def _check_patches(A: Any, patches: Patches, some: bool) -> tuple[Int, Any]:
    """Return offsets and parts of patches after a check that they cover all parts (or only ``some``)."""
    offsets, parts, n_parts = (
        frozen_int(patches.offsets),
        frozen_index(patches.parts),
        A.shape[0] // A.blocksize[0],
    )
    if len(parts) and (parts.min() < 0 or parts.max() >= n_parts):
        raise OptionError(f"patches contain part {parts.max()}, but the matrix has only {n_parts} blocks")
    missing = np.flatnonzero(np.bincount(parts, minlength=n_parts) == 0)
    if len(missing) and not some:
        raise OptionError(f"part {missing[0]} of {n_parts} is in no patch: it would not be smoothed")
    return offsets, parts


def _require_definite(failed: int, offsets: Int, parts: Any) -> None:
    if failed >= 0:
        members = sorted(parts[offsets[failed] : offsets[failed + 1]].tolist())
        raise np.linalg.LinAlgError(f"the matrix is not positive definite on the parts {members}")


class VertexPatches:
    """Multiplicative Schwarz: patch by patch, forward before the coarse correction, backward after.

    Parameters
    ----------
    A : (n, n) bsr
        Symmetric positive definite matrix in square blocks, one per part.
    patches : Patches
        Patches that cover every part.
    dtype : numpy dtype
        Precision of sweeps. Inverses and factors are computed in double precision.
    some : bool
        Allow parts outside patches. Their values stay unchanged, and their rows are ignored.

    Attributes
    ----------
    A : (n, n) bsr
        Matrix in the precision of the sweeps.

    Raises
    ------
    OptionError
        If a part is in no patch, or a patch contains an unknown part.
    LinAlgError
        If the matrix is not positive definite on a patch.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(3, 3)).tobsr((1, 1))
    >>> x, r = VertexPatches(A, Patches(np.array([0, 2, 4]), np.array([0, 1, 1, 2]))).before(np.ones(3))
    >>> x.round(3).tolist(), r.round(3).tolist()
    ([1.0, 1.667, 1.333], [0.667, 0.0, 0.0])
    """

    def __init__(self, A: Any, patches: Patches, dtype: Any = np.float64, *, some: bool = False) -> None:
        self.A = in_precision(A, dtype)
        width, blocks = int(A.blocksize[0]), frozen(self.A.data, dtype)
        if np.bincount(patches.parts, minlength=1).max() <= 1:  # disjoint patches
            groups = _Groups(A, patches, dtype, some)
            first, sweep = block_sweeps(width)
            self._first = partial(first, *groups.forwards)
            self._forwards, self._backwards = (
                partial(sweep, *arrays, order=1) for arrays in (groups.forwards, groups.backwards)
            )
        else:
            arrays = (*_Factors(A, patches, dtype, some).arrays, *_pattern(A), blocks.reshape(-1))
            sweep = partial(patch_sweep(width), *arrays)
            self._first, self._forwards, self._backwards = (partial(sweep, order=k) for k in (0, 1, -1))

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a sweep from zero, and the residual b − A x."""
        x, r = np.zeros(len(b), self.A.dtype), np.array(b, self.A.dtype)
        self._first(r, x)
        return x, r

    def after(self, b: Real, x: Real) -> Real:
        """Return x after a backward sweep. The given array is modified."""
        return self._swept(b, np.ascontiguousarray(x, dtype=self.A.dtype), self._backwards)

    def sweep(self, b: Real, x: Real, *, back: bool = False) -> Real:
        """Return x ``(n,)`` after a forward sweep through the patches, or a backward sweep if ``back``."""
        return self._swept(b, np.array(x, self.A.dtype), self._backwards if back else self._forwards)

    def _swept(self, b: Real, x: Real, again: Callable[..., None]) -> Real:
        again(np.require(b, self.A.dtype, ["C", "W"]), x)
        return x


class PatchSmoother:
    """Component of kind ``smoother``: forward and backward sweeps through the patches of a level."""

    uses_coarse: ClassVar[bool] = False

    def setup(self, level: MultigridLevel) -> Callable[[Float, Float], Float]:
        """Return the smoother of a level as a function ``smooth(b, x)``.

        Raises
        ------
        OptionError
            If the level has no patches, or its parts have unequal numbers of unknowns.
        LinAlgError
            If the matrix is not positive definite on a patch.
        """
        if level.patches is None:
            raise OptionError(
                "vertex_patches requires the patches of the level (level.patches), and the calling method "
                "provides none; agglo_core.multigrid.vertex_patches computes them from a mesh"
            )
        sizes = np.diff(level.block_offsets)
        if sizes.min() != sizes.max():
            raise OptionError(
                f"vertex_patches requires parts with equal numbers of unknowns; given {sizes.min()} to "
                f"{sizes.max()}"
            )
        width = int(sizes[0])
        sweeps = VertexPatches(sparse.bsr_array(level.A, blocksize=(width, width)), level.patches)
        return partial(_sweep_both_ways, sweeps, level.steps)


def _sweep_both_ways(sweeps: VertexPatches, steps: int, b: Float, x: Float) -> Float:
    for _ in range(steps):
        x = np.asarray(sweeps.sweep(b, sweeps.sweep(b, x), back=True), dtype=np.float64)
    return x


def _pattern(A: Any) -> tuple[Int, Any]:
    return frozen_int(A.indptr), frozen_index(A.indices)
