"""Our sweeps through patches as a preconditioner of PETSc: solves in turn, where PCASM solves all at once.

On several ranks the sweep is that of one rank in another order: through the patches at the borders the ranks
that touch one another go in turn, through the others all at once. Ranks of the first turn begin with their
borders, while the others go through their inner patches, and the other way round after that. So it needs no
damping, and takes about as many iterations on any number of ranks.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from agglo_core.authoring import Float, OptionError, Patches, frozen_int, multigrid
from agglo_petsc.border_plan import border_plan, in_blocks
from agglo_petsc.petsc_matrices import agree, rows_of

__all__ = ["LevelSweeps", "PatchSweeps", "require_width"]

_TAG = 7412  # of messages within a sweep
_TRIES, _PAUSE = 100, 2e-5  # looks at whether a message has come, before there are seconds between them


class _RankSweeps:
    """The sweeps of one rank through the patches of a matrix; all of it is collective."""

    def __init__(self, A: Any, patches: Patches | None, width: int) -> None:
        self._comm, self._width = A.getComm().tompi4py(), width
        own = in_blocks(rows_of(A), width)
        starts = frozen_int(np.asarray(A.getOwnershipRanges()) // width)
        agree(A.getComm(), _beyond(patches, int(starts[-1])))
        self._plan = plan = border_plan(self._comm, own, starts, patches)
        wrong, self._inner, self._outer = "", None, None
        try:
            if len(plan.inner):
                beside = in_blocks(rows_of(A.getDiagonalBlock()), width)
                self._inner = multigrid.VertexPatches(beside, plan.inner, some=True)
            if len(plan.outer):
                self._outer = multigrid.VertexPatches(plan.rows, plan.outer, some=True)
        except np.linalg.LinAlgError as error:
            wrong = str(error)
        agree(A.getComm(), wrong)
        self.memory = sum(_memory(each) for each in (self._inner, self._outer) if each is not None)

    def forwards(self, b: Float) -> Float:
        """The sweep from zero for a right-hand side ``(n_own,)``."""
        return self._swept(b, back=False)

    def backwards(self, b: Float) -> Float:
        """Its transpose: the same in the opposite order."""
        return self._swept(b, back=True)

    def _swept(self, b: Float, *, back: bool) -> Float:
        if self._comm.size == 1:
            return self._inside(b, None, back=back)
        plan, n = self._plan, self._width
        sent = [self._comm.Isend(b.reshape(-1, n)[each], rank, _TAG) for rank, each in plan.copied.items()]
        inner_first = (plan.colours[self._comm.rank] > 0) != back
        x: Float = self._inside(b, None, back=back) if inner_first else np.zeros(len(b))
        border, own = np.zeros((2, plan.rows.shape[0] // n, n)), x.reshape(-1, n)
        border[:, plan.places] = b.reshape(-1, n)[plan.own], own[plan.own]
        for rank, each in plan.copies.items():
            border[0, each] = self._received(rank, (len(each), n))
        later, told = self._own_turn(*border, back=back)
        own[plan.own] = border[1, plan.places]
        if not inner_first:
            own = self._inside(b, x, back=back).reshape(-1, n)
        self._receive(later, border[1])
        own[plan.shared] = border[1, plan.shared_places]
        for request in sent + told:
            request.Wait()
        return own.ravel()

    def _inside(self, b: Float, x: Float | None, *, back: bool) -> Float:
        """x ``(n_own,)``, or zero, after a sweep through the patches inside."""
        if self._inner is None:
            return np.zeros(len(b)) if x is None else x
        if x is None and not back:
            return np.asarray(self._inner.before(b)[0], np.float64)
        start = np.zeros(len(b)) if x is None else x
        return np.asarray(self._inner.after(b, start) if back else self._inner.sweep(b, start), np.float64)

    def _own_turn(self, b: Float, x: Float, *, back: bool) -> tuple[list[int], list[Any]]:
        """Change x on the border in its turn; ranks whose turn is later, and what was sent."""
        plan = self._plan
        mine = plan.colours[self._comm.rank]
        turns = sorted(plan.tellers, key=lambda rank: (plan.colours[rank], rank), reverse=back)
        if self._outer is None:
            return turns, []
        before = [rank for rank in turns if (plan.colours[rank] > mine) == back]
        self._receive(before, x)
        x[:] = self._outer.sweep(b.ravel(), x.ravel(), back=back).reshape(x.shape)
        told = [self._comm.Isend(x[each], rank, _TAG) for rank, each in plan.told.items()]
        return [rank for rank in turns if rank not in before], told

    def _receive(self, ranks: list[int], x: Float) -> None:
        """Put what these ranks have changed into x on the border."""
        for rank in ranks:
            each = self._plan.tellers[rank]
            x[each] = self._received(rank, (len(each), self._width))

    def _received(self, rank: int, shape: tuple[int, ...]) -> Float:
        found = np.empty(shape)
        request, tries = self._comm.Irecv(found, rank, _TAG), 0
        while not request.Test():  # MPI itself waits in a loop, without leaving the processor to others
            time.sleep(0.0 if tries < _TRIES else _PAUSE)
            tries += 1
        return found


def _beyond(patches: Patches | None, parts: int) -> str:
    """What is wrong with the parts of patches; empty if nothing is."""
    given = np.empty(0, np.int64) if patches is None else np.asarray(patches.parts)
    least, most = int(given.min(initial=0)), int(given.max(initial=-1))
    return f"patches hold parts {least} to {most}; there are {parts}" if least < 0 or most >= parts else ""


def _memory(sweeps: Any) -> int:
    level = multigrid.Level(sweeps.A, frozen_int([0]), smoother=sweeps)
    return int(multigrid.LevelStack([level], np.copy).memory)


class LevelSweeps:
    """The patches of a level on one rank, factorised again when its matrix has changed."""

    def __init__(self, patches: Patches | None, width: int) -> None:
        self._patches, self._width = patches, width
        self._state: tuple[int, int] = (0, -1)
        self._sweeps: _RankSweeps | None = None

    @property
    def memory(self) -> int:
        """Bytes of factors and matrices on this rank."""
        return 0 if self._sweeps is None else self._sweeps.memory

    def of(self, A: Any) -> _RankSweeps:
        """The sweeps through the patches of this rank; collective."""
        state = (A.handle, A.stateGet())
        if self._sweeps is None or state != self._state:
            self._sweeps, self._state = _RankSweeps(A, self._patches, self._width), state
        return self._sweeps


class PatchSweeps:
    """Context of a ``PC`` of type ``python``: a sweep forwards, or backwards.

    Parameters
    ----------
    level : LevelSweeps
    backwards : bool
        Backwards is the transpose of forwards: what smooths after the correction if the other one did before.
    """

    def __init__(self, level: LevelSweeps, *, backwards: bool) -> None:
        self.level, self._backwards = level, backwards

    def setUp(self, pc: Any) -> None:  # PETSc's name
        """Factorise the patches, unless that has been done for this matrix."""
        self.level.of(pc.getOperators()[1])

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """Set y to the sweep from zero for the right-hand side x."""
        self._sweep(pc, x, y, backwards=self._backwards)

    def applyTranspose(self, pc: Any, x: Any, y: Any) -> None:  # PETSc's name
        """The same in the other order."""
        self._sweep(pc, x, y, backwards=not self._backwards)

    def _sweep(self, pc: Any, x: Any, y: Any, *, backwards: bool) -> None:
        sweeps = self.level.of(pc.getOperators()[1])
        b: Float = np.array(x.getArray(readonly=True))
        y.setArray(sweeps.backwards(b) if backwards else sweeps.forwards(b))


def require_width(width: int | None, smoother: str) -> int:
    """The unknowns of each part, or OptionError where they differ."""
    if width is None:
        raise OptionError(
            f"smoother {smoother!r} takes parts of one number of unknowns; theirs differ: take 'sor'"
        )
    return width
