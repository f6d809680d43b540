"""Schwarz smoothing on patches: exact solves in overlapping groups of parts, in turn or all at once.

Cell by cell smoothing cannot move the continuous part of an error of discontinuous polynomials; patches
around vertices can. J. Schöberl, J. M. Melenk, C. Pechstein, S. Zaglmayr, "Additive Schwarz
preconditioning for p-version triangular and tetrahedral finite elements", IMA J. Numer. Anal. 28 (2008).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.kernels.block_sweeps import UNROLLED
from agglo_core.kernels.group_sweeps import group_sweeps
from agglo_core.kernels.patch_sweeps import patch_borders, patch_inverses, patch_sum, patch_sweep
from agglo_core.multigrid.block_matrix import in_precision
from agglo_core.multigrid.spectrum import largest_eigenvalue
from agglo_core.multigrid.stack import Real
from agglo_core.problems import MultigridLevel, Patches

__all__ = ["AdditivePatches", "PatchSmoother", "VertexPatches"]

_CUBICS = 10
"""Unknowns of a cell at degree 3, where overlapping patches serve most: their sweep is compiled for it."""


class _Inverses:
    """Patches of a matrix in blocks, and the inverse of the matrix on each: its lower half, or all of it."""

    def __init__(self, A: Any, patches: Patches, dtype: Any, half: bool) -> None:
        self.offsets, self.parts = frozen_int(patches.offsets), frozen_index(patches.parts)
        self.width = int(A.blocksize[0])
        self._check(A.shape[0] // self.width)
        rows = np.diff(self.offsets) * self.width
        sizes = rows * (rows + 1) // 2 if half else rows**2
        self.starts = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
        values = np.empty(self.starts[-1], dtype)
        blocks = frozen(A.data, A.dtype)
        failed = patch_inverses(
            self.offsets, self.parts, *_pattern(A), blocks, frozen_int(self.starts[:-1]), half, values
        )
        if failed >= 0:
            members = self.parts[self.offsets[failed] : self.offsets[failed + 1]].tolist()
            raise np.linalg.LinAlgError(f"the matrix is not positive definite on the parts {members}")
        self.values = frozen(values, dtype)

    def _check(self, n_parts: int) -> None:
        if len(self.parts) and (self.parts.min() < 0 or self.parts.max() >= n_parts):
            raise OptionError(f"patches hold part {self.parts.max()}; the matrix has blocks for {n_parts}")
        missing = np.flatnonzero(np.bincount(self.parts, minlength=n_parts) == 0)
        if len(missing):
            raise OptionError(f"part {missing[0]} of {n_parts} is in no patch: it would not be smoothed")

    @property
    def arrays(self) -> tuple[Int, Any, Int, Any]:
        return self.offsets, self.parts, self.starts, self.values


class VertexPatches:
    """Multiplicative Schwarz: solves patch by patch, forwards before the coarse correction, backwards after.

    Parameters
    ----------
    A : (n, n) bsr
        Symmetric and positive definite, in square blocks, one for each part.
    patches : Patches
        Every part must be in one.
    dtype : numpy dtype
        Precision of sweeps; inverses are computed in double precision.

    Attributes
    ----------
    A : (n, n) bsr
        The matrix in the precision of the sweeps.

    Raises
    ------
    OptionError
        If a part is in no patch, or a patch holds a part that the matrix lacks.
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

    def __init__(self, A: Any, patches: Patches, dtype: Any = np.float64) -> None:
        self._apart = len(patches.parts) == A.shape[0] // A.blocksize[0]  # patches do not overlap
        own = self._inverses = _Inverses(A, patches, dtype, half=not self._apart)
        self.A = in_precision(A, dtype)
        if self._apart:
            self._kernels = group_sweeps(own.width if own.width <= UNROLLED else 0)
            self._rows = (frozen_int(A.indptr), frozen_index(A.indices), frozen(self.A.data, dtype))
            return
        starts, known, blocks, columns = patch_borders(own.offsets, own.parts, *_pattern(A))
        self._starts, self._known = frozen_int(starts), frozen_int(known)
        self._columns, self._border = frozen_index(columns), frozen(self.A.data[blocks].swapaxes(1, 2), dtype)
        self._sweep = patch_sweep(own.width if own.width == _CUBICS else 0)

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` of a sweep from zero, and the residual b − A x."""
        if self._apart:
            x, r = np.zeros(len(b), self.A.dtype), np.array(b, self.A.dtype)
            self._kernels[0](*self._inverses.arrays, *self._rows, r, x)
            return x, r
        x = self._overlapping(b, np.zeros_like(b), self._known, back=False)
        return x, b - self.A @ x

    def after(self, b: Real, x: Real) -> Real:
        """Return x after a sweep backwards."""
        return self.sweep(b, x, back=True)

    def sweep(self, b: Real, x: Real, *, back: bool = False) -> Real:
        """Return x ``(n,)`` after a sweep through the patches, the last first if ``back``."""
        if not self._apart:
            return self._overlapping(b, x, frozen_int(self._starts[1:]), back)
        x = np.array(x, self.A.dtype)
        order = -1 if back else 1
        self._kernels[1](*self._inverses.arrays, *self._rows, frozen(b, self.A.dtype), x, order)
        return x

    def _overlapping(self, b: Real, x: Real, stops: Int, back: bool) -> Real:
        given = (frozen(each, self.A.dtype) for each in (b, x))
        border = self._starts, stops, self._columns, self._border
        swept: Real = self._sweep(*self._inverses.arrays, *border, *given, back)
        return swept


class AdditivePatches:
    """Additive Schwarz: the sum of the solutions on all patches, weighted by their overlap and damped.

    A part that m patches share has the weight m^(−1/2) before and after each solve; damping is
    4 / (3 λ_max). Slower to converge than :class:`VertexPatches`, the same in any order of the patches.
    Parameters, attributes and errors are the same.
    """

    def __init__(self, A: Any, patches: Patches, dtype: Any = np.float64) -> None:
        self._inverses = _Inverses(A, patches, dtype, half=True)
        self.A = in_precision(A, dtype)
        shared = np.bincount(self._inverses.parts, minlength=A.shape[0] // A.blocksize[0])
        self._weights = frozen(1.0 / np.sqrt(shared), dtype)
        self._damping = self.A.dtype.type(4 / 3 / largest_eigenvalue(self.A, self._summed))

    def before(self, b: Real) -> tuple[Real, Real]:
        """Return x ``(n,)`` of a step from zero, and the residual b − A x."""
        x = self._damping * self._summed(b)
        return x, b - self.A @ x

    def after(self, b: Real, x: Real) -> Real:
        """Return x after another step."""
        better: Real = x + self._damping * self._summed(b - self.A @ x)
        return better

    def _summed(self, r: Real) -> Real:
        residual = frozen(r, self.A.dtype)
        added: Real = patch_sum(*self._inverses.arrays, self._weights, self._inverses.width, residual)
        return added


class PatchSmoother:
    """A component of kind ``smoother``: sweeps forwards and backwards through the patches of a level."""

    uses_coarse: ClassVar[bool] = False

    def setup(self, level: MultigridLevel) -> Callable[[Float, Float], Float]:
        """Return ``smooth(b, x)``.

        Raises
        ------
        OptionError
            If the level comes without patches, or its parts have unequal numbers of unknowns.
        LinAlgError
            If the matrix is not positive definite on a patch.
        """
        if level.patches is None:
            raise OptionError(
                "vertex_patches needs the patches of the level, and the method that calls it gives none "
                "(level.patches, as agglo_core.multigrid.vertex_patches finds them on a mesh)"
            )
        sizes = np.diff(level.block_offsets)
        if sizes.min() != sizes.max():
            raise OptionError(
                f"vertex_patches takes parts of one number of unknowns; given {sizes.min()} to {sizes.max()}"
            )
        width = int(sizes[0])
        sweeps = VertexPatches(sparse.bsr_array(level.A, blocksize=(width, width)), level.patches)

        def smooth(b: Float, x: Float) -> Float:
            for _ in range(level.steps):
                x = np.asarray(sweeps.sweep(b, sweeps.sweep(b, x), back=True), dtype=np.float64)
            return x

        return smooth


def _pattern(A: Any) -> tuple[Int, Any]:
    return frozen_int(A.indptr), frozen_index(A.indices)
