"""Multiplicative patch smoothing as a PETSc preconditioner, whereas PETSc's PCASM is additive.

On several ranks the sweep reorders the sweep on one rank: first all ranks concurrently sweep through the
patches that touch no other rank, then adjacent ranks take turns at the borders. Therefore the sweep needs
no damping, and takes about as many iterations on any number of ranks.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from agglo_core.authoring import Float, OptionError, Patches, frozen_int, multigrid
from agglo_petsc.matrices import rows_of
from agglo_petsc.messages import agree
from agglo_petsc.ranks.border_plan import border_plan, in_blocks

_TAG = 7412  # tag for messages within a sweep
# Number of immediate tests for a message, then seconds between tests. More tests or shorter pauses receive it
# earlier, but take processor time from other ranks on the same core (benchmarks/petsc.py on several ranks).
_TRIES, _PAUSE = 100, 2e-5


class _RankSweeps:
    """Multiplicative smoothing over the patches of a distributed matrix, on one rank.

    All methods are collective.
    """

    def __init__(self, A: Any, patches: Patches | None, width: int) -> None:
        self._comm, self._width = A.getComm().tompi4py(), width
        rows = in_blocks(rows_of(A), width)
        starts = frozen_int(np.asarray(A.getOwnershipRanges()) // width)
        agree(A.getComm(), _range_fault(patches, int(starts[-1])))
        self._plan = plan = border_plan(self._comm, rows, starts, patches)
        wrong, self._inner, self._outer = "", None, None
        try:
            if len(plan.inner):
                diagonal_block = in_blocks(rows_of(A.getDiagonalBlock()), width)
                self._inner = multigrid.VertexPatches(diagonal_block, plan.inner, some=True)
            if len(plan.outer):
                self._outer = multigrid.VertexPatches(plan.rows, plan.outer, some=True)
        except np.linalg.LinAlgError as error:
            wrong = str(error)
        agree(A.getComm(), wrong)
        self.memory = sum(_memory(sweeps) for sweeps in (self._inner, self._outer) if sweeps is not None)

    def forwards(self, b: Float) -> Float:
        """Return the result of one sweep with initial guess zero for a right-hand side ``(n_own,)``."""
        x: Float = np.zeros(len(b)) if self._inner is None else np.asarray(self._inner.before(b)[0], float)
        return self._through_borders(b, x, back=False)[: len(b)]

    def backwards(self, b: Float) -> Float:
        """Return the result of the transposed sweep, which visits the patches in reverse order."""
        x = self._through_borders(b, np.zeros(len(b)), back=True)[: len(b)]
        return x if self._inner is None else np.asarray(self._inner.after(b, x), np.float64)

    def _through_borders(self, b: Float, x: Float, *, back: bool) -> Float:
        """Sweep through the patches shared between ranks, and return x on own parts and ghosts."""
        plan, comm, n = self._plan, self._comm, self._width
        if comm.size == 1:
            return x
        # 1. Exchange b and x on the copies
        b_and_x = np.zeros((2, plan.rows.shape[0] // n, n))
        b_and_x[:, : len(b) // n] = b.reshape(-1, n), x.reshape(-1, n)
        requests = [
            comm.Isend(np.ascontiguousarray(b_and_x[:, item]), rank, _TAG)
            for rank, item in plan.copied.items()
        ]
        for rank, item in plan.copies.items():
            b_and_x[:, item] = self._received(rank, (2, len(item), n))
        # 2. Receive the updates of ranks with earlier turns
        x_local, own_colour = b_and_x[1], plan.colours[comm.rank]
        turns = sorted(plan.senders, key=lambda rank: (plan.colours[rank], rank), reverse=back)
        before = [
            rank for rank in turns if (plan.colours[rank] > own_colour) == back and self._outer is not None
        ]
        for rank in before:
            x_local[plan.senders[rank]] = self._received(rank, (len(plan.senders[rank]), n))
        # 3. Sweep, and send the changes
        if self._outer is not None:
            x_local[:] = self._outer.sweep(b_and_x[0].ravel(), x_local.ravel(), back=back).reshape(-1, n)
            requests += [comm.Isend(x_local[item], rank, _TAG) for rank, item in plan.receivers.items()]
        # 4. Receive the updates of ranks with later turns
        for rank in turns:
            if rank not in before:
                x_local[plan.senders[rank]] = self._received(rank, (len(plan.senders[rank]), n))
        for item in requests:
            item.Wait()
        better: Float = x_local.ravel()
        return better

    def _received(self, rank: int, shape: tuple[int, ...]) -> Float:
        buffer = np.empty(shape)
        request, tries = self._comm.Irecv(buffer, rank, _TAG), 0
        while not request.Test():  # MPI's own wait would keep the processor busy
            time.sleep(0.0 if tries < _TRIES else _PAUSE)
            tries += 1
        return buffer


def _range_fault(patches: Patches | None, parts: int) -> str:
    """Return an error message if part numbers in patches are out of range, otherwise an empty text."""
    given = np.empty(0, np.int64) if patches is None else np.asarray(patches.parts)
    least, most = int(given.min(initial=0)), int(given.max(initial=-1))
    return (
        f"patches contain parts {least} to {most}, but there are {parts}"
        if least < 0 or most >= parts
        else ""
    )


def _memory(sweeps: Any) -> int:
    level = multigrid.Level(sweeps.A, frozen_int([0]), smoother=sweeps)
    return int(multigrid.LevelStack([level], np.copy).memory)


class LevelSweeps:
    """Patch smoother of one multigrid level on one rank, factorised again when the matrix changes."""

    def __init__(self, patches: Patches | None, width: int) -> None:
        self._patches, self._width = patches, width
        self._state: tuple[int, int] = (0, -1)
        self._sweeps: _RankSweeps | None = None

    @property
    def memory(self) -> int:
        """Memory of factors and matrices on this rank, in bytes."""
        return 0 if self._sweeps is None else self._sweeps.memory

    def of(self, A: Any) -> _RankSweeps:
        """Return the factorised patches of this rank for the matrix. Collective."""
        state = (A.handle, A.stateGet())
        if self._sweeps is None or state != self._state:
            self._sweeps, self._state = _RankSweeps(A, self._patches, self._width), state
        return self._sweeps


class PatchSweeps:
    """PETSc preconditioner (``PC`` of type ``python``) that applies one forward or backward patch sweep.

    Parameters
    ----------
    level : LevelSweeps
    backwards : bool
        Run the transposed sweep, for smoothing after the coarse correction if the forward sweep runs
        before.
    """

    def __init__(self, level: LevelSweeps, *, backwards: bool) -> None:
        self.level, self._backwards = level, backwards

    def setUp(self, pc: Any) -> None:  # PETSc's name
        """Factorise the patches, unless already done for this matrix."""
        self.level.of(pc.getOperators()[1])

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """Set y to the result of one sweep with initial guess zero for the right-hand side x."""
        self._sweep(pc, x, y, backwards=self._backwards)

    def applyTranspose(self, pc: Any, x: Any, y: Any) -> None:  # PETSc's name
        """Set y to the result of one reversed sweep with initial guess zero for the right-hand side x."""
        self._sweep(pc, x, y, backwards=not self._backwards)

    def _sweep(self, pc: Any, x: Any, y: Any, *, backwards: bool) -> None:
        sweeps = self.level.of(pc.getOperators()[1])
        b: Float = np.array(x.getArray(readonly=True))
        y.setArray(sweeps.backwards(b) if backwards else sweeps.forwards(b))


def require_width(width: int | None, smoother: str) -> int:
    """Return the number of unknowns per part, or raise OptionError if it differs between parts."""
    if width is None:
        raise OptionError(f"smoother {smoother!r} needs equally many unknowns in all parts; use 'sor'")
    return width
