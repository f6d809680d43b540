"""Schwarz smoothing on patches: exact solves in overlapping groups of parts, in turn or all at once.

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
from agglo_core.multigrid.kernels.patch_sweeps import patch_inverses, patch_sum, patch_sweep
from agglo_core.multigrid.matrices.block_matrix import in_precision
from agglo_core.multigrid.smoothers.spectrum import largest_eigenvalue
from agglo_core.multigrid.stack import Real
from agglo_core.problems import MultigridLevel, Patches

_TINY = 1e-22  # relative to the largest value: smaller values become 0 in single precision
_CUBICS = 10
"""Block size of cubics, where overlapping patches are most useful: factors are compiled for this size.

Other sizes share a kernel (benchmarks/solve.py).
"""


class _Inverses:
    """Inverses of a block matrix on patches, stored as lower triangles or in full."""

    def __init__(self, A: Any, patches: Patches, dtype: Any, *, half: bool, some: bool = False) -> None:
        self.offsets, self.parts = _check_patches(A, patches, some)
        self.width = int(A.blocksize[0])
        rows = np.diff(self.offsets) * self.width
        sizes = rows * (rows + 1) // 2 if half else rows**2
        self.starts = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
        values = np.empty(self.starts[-1], dtype)
        blocks = frozen(A.data, A.dtype)
        bad_patch = patch_inverses(
            self.offsets, self.parts, *_pattern(A), blocks, frozen_int(self.starts[:-1]), half, values
        )
        _require_definite(bad_patch, self.offsets, self.parts)
        self.values = frozen(values, dtype)

    @property
    def arrays(self) -> tuple[Int, Any, Int, Any]:
        return self.offsets, self.parts, self.starts, self.values


class _Groups:
    """Disjoint patches with inverses and matrix rows in patch order, for sweeps.

    Backward sweeps have separate arrays, so that memory is always read from the beginning.
    """

    def __init__(self, A: Any, patches: Patches, dtype: Any, some: bool) -> None:
        whole = _Inverses(A, patches, dtype, half=False, some=some)
        blocks, pattern = in_precision(A, dtype).data, _pattern(A)
        count = len(whole.offsets) - 1
        self.forwards, self.backwards = (
            _order_groups(whole, np.arange(count)[::step], *pattern, blocks) for step in (1, -1)
        )


def _order_groups(whole: _Inverses, groups: Int, indptr: Int, indices: Any, blocks: Real) -> tuple[Any, ...]:
    """Return groups in another order: offsets, parts, starts, inverses, and matrix rows (BSR)."""
    offsets, members = slices(whole.offsets, groups)
    starts, values = slices(whole.starts, groups)
    parts = whole.parts[members]
    rows, entries = slices(indptr, parts)
    inverses = frozen(whole.values[values], whole.values.dtype)
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


class AdditivePatches:
    """Additive Schwarz: the damped sum of all patch solutions, weighted by overlap.

    A part in m patches has the weight m^(−1/2) before and after each solve. The damping is 4 / (3 λ_max).
    Convergence is slower than with :class:`VertexPatches`, but independent of the patch order. Parameters,
    attributes and errors are those of :class:`VertexPatches`.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import AdditivePatches
    >>> from agglo_core.problems import Patches
    >>> patches = Patches(np.array([0, 2, 4]), np.array([0, 1, 1, 2]))
    >>> M = AdditivePatches(A.tobsr((2, 2)), patches)
    >>> M.before(np.ones(6))[0].shape
    (6,)
    """

    def __init__(self, A: Any, patches: Patches, dtype: Any = np.float64) -> None:
        self._inverses = _Inverses(A, patches, dtype, half=True)
        self.A = in_precision(A, dtype)
        shared = np.bincount(self._inverses.parts, minlength=A.shape[0] // A.blocksize[0])
        self._weights = frozen(1.0 / np.sqrt(shared), dtype)
        self._damping = self.A.dtype.type(4 / 3 / largest_eigenvalue(self.A, self._summed))

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` after a step from zero, and the residual b − A x."""
        x = self._damping * self._summed(b)
        return x, b - self.A @ x

    def after(self, b: Real, x: Real) -> Real:
        """Return x after another damped step."""
        better: Real = x + self._damping * self._summed(b - self.A @ x)
        return better

    def _summed(self, r: Real) -> Real:
        residual = frozen(r, self.A.dtype)
        added: Real = patch_sum(*self._inverses.arrays, self._weights, self._inverses.width, residual)
        return added


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
