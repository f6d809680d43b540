"""Our sweeps through patches as a preconditioner of PETSc: solves in turn, where PCASM solves all at once.

On several ranks each sweeps through its own unknowns, and the ranks' corrections are added: the hybrid of
A. H. Baker, R. D. Falgout, T. V. Kolev, U. M. Yang, "Multigrid smoothers for ultraparallel computing", SIAM
J. Sci. Comput. 33 (2011). At the borders of ranks it goes up to twice too far, so Chebyshev's iteration,
which knows how far, takes sweeps there and back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, OptionError, Patches, frozen_int, multigrid
from agglo_petsc.petsc_matrices import rows_of

__all__ = ["LevelSweeps", "PatchSweeps", "own_patches", "require_width"]


class LevelSweeps:
    """The patches of a level on one rank, factorised again when its matrix has changed."""

    def __init__(self, patches: Patches | None, width: int) -> None:
        self._patches, self._width, self._state, self._sweeps = patches, width, (0, -1), None
        self.memory = 0

    def of(self, A: Any) -> Any:
        """The sweeps through the unknowns of this rank, None if it has none."""
        state = (A.handle, A.stateGet())
        if state != self._state:
            self._state = state
            self._sweeps = self._made(A) if A.getLocalSize()[0] else None
        return self._sweeps

    def _made(self, A: Any) -> Any:
        own, width = rows_of(A.getDiagonalBlock()), self._width
        first, last = (each // width for each in A.getOwnershipRange())
        blocks = sparse.bsr_array(own, blocksize=(width, width))
        blocks.sort_indices()
        sweeps = multigrid.VertexPatches(blocks, own_patches(self._patches, first, last))
        self.memory = multigrid.LevelStack(
            [multigrid.Level(blocks, frozen_int([0]), smoother=sweeps)], np.copy
        ).memory
        return sweeps


class PatchSweeps:
    """Context of a ``PC`` of type ``python``: a sweep forwards, one backwards, or both.

    Parameters
    ----------
    level : LevelSweeps
    order : {"forwards", "backwards", "both"}
        Backwards is the transpose of forwards: what smooths after the correction if the other one did before.
        Both are symmetric.
    """

    def __init__(self, level: LevelSweeps, order: str) -> None:
        self.level, self._order = level, order

    def setUp(self, pc: Any) -> None:  # PETSc's name
        """Factorise the patches, unless that has been done for this matrix."""
        self.level.of(pc.getOperators()[1])

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """Set y to the sweep from zero for the right-hand side x."""
        self._sweep(pc, x, y, self._order)

    def applyTranspose(self, pc: Any, x: Any, y: Any) -> None:  # PETSc's name
        """The same in the other order."""
        self._sweep(pc, x, y, _TRANSPOSED[self._order])

    def _sweep(self, pc: Any, x: Any, y: Any, order: str) -> None:
        sweeps = self.level.of(pc.getOperators()[1])
        if sweeps is None:
            return
        b: Float = np.array(x.getArray(readonly=True))
        start = np.zeros(len(b)) if order == "backwards" else sweeps.before(b)[0]
        y.setArray(start if order == "forwards" else sweeps.after(b, start))


_TRANSPOSED = {"forwards": "backwards", "backwards": "forwards", "both": "both"}


def own_patches(patches: Patches | None, first: int, last: int) -> Patches:
    """Patches cut down to the parts ``first:last`` of this rank, and counted from there.

    Parts that are in none, and all without patches, are patches of their own. Empty ones are left out.

    Examples
    --------
    >>> import numpy as np
    >>> cut = own_patches(Patches(np.array([0, 2, 4]), np.array([0, 1, 1, 2])), 1, 4)
    >>> cut.offsets.tolist(), cut.parts.tolist()
    ([0, 1, 3, 4], [0, 0, 1, 2])
    """
    offsets, parts = (np.zeros(1, np.int64),) * 2 if patches is None else (patches.offsets, patches.parts)
    parts = np.empty(0, np.int64) if patches is None else np.asarray(parts)
    group = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    inside = (parts >= first) & (parts < last)
    group, parts = group[inside], parts[inside] - first
    alone = np.flatnonzero(np.bincount(parts, minlength=last - first) == 0)
    sizes = np.bincount(group)
    sizes = np.concatenate((sizes[sizes > 0], np.ones(len(alone), np.int64)))
    return Patches(_starts(sizes), frozen_int(np.concatenate((parts, alone))))


def _starts(sizes: Any) -> Int:
    return frozen_int(np.concatenate(([0], np.cumsum(sizes))))


def require_width(width: int | None, smoother: str) -> int:
    """The unknowns of each part, or OptionError where they differ."""
    if width is None:
        raise OptionError(
            f"smoother {smoother!r} takes parts of one number of unknowns; theirs differ: take 'sor'"
        )
    return width
