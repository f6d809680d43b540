"""Linear systems for the default solver: variable block sizes, several right-hand sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.multigrid import is_classical, stack_of_system
from agglo_core.multigrid.krylov.pcg import pcg_columns
from agglo_core.problems import Linear, Solution, System
from agglo_core.problems.iteration_history import History, joint_outcome, unsolved, worst_column
from agglo_core.problems.linear import require_cells
from agglo_core.problems.residuals.sizes import two_norm
from agglo_core.progress import Notify
from agglo_core.solvers.advice import Kind, advice_of_components, advice_of_multigrid
from agglo_core.solvers.fine_system import FineSystem, chosen_levels
from agglo_core.solvers.scaling import factor_for, matrix_factor, unscaled, unscaled_matrix
from agglo_core.solvers.stopwatch import Stopwatch

_MANY = 60
"""Iterations from which components are examined (:func:`~agglo_core.solvers.advice.advice_of_components`)."""


class LinearTask:
    """Linear system for multigrid, with its unknowns in the cells of a hierarchy.

    Scalar systems (one unknown per cell, at most one near-null vector with positive entries) use classical
    coarsening of the matrix. With the recipe ``"agglomerates"`` they use one classical step, then the
    agglomerates of the hierarchy. Other systems use smoothed aggregation by the agglomerates as far as these
    suit the matrix, or by aggregates from the matrix graph. Blocks correspond to the cells with unknowns.
    Without a hierarchy, blocks belong to no cells, and all levels come from the matrix.

    Raises
    ------
    OptionError
        For a diffusion recipe, blocks that do not match the hierarchy's cells, or invalid systems
        (see :class:`~agglo_core.problems.System`).
    """

    def __init__(
        self,
        problem: Linear,
        hierarchy: Hierarchy | None,
        count: int | None = None,
        recipe: str = "auto",
        cycle: str = "auto",
        precision: str = "auto",
    ) -> None:
        if recipe not in ("auto", "agglomerates"):
            raise OptionError(
                f"recipe {recipe!r} is for diffusion problems; for linear systems use auto or agglomerates"
            )
        offsets = np.asarray(problem.block_offsets)
        cells = len(offsets) - 1 if hierarchy is None else hierarchy.graph.n
        self._cells: int | None = None if hierarchy is None else cells
        plane = hierarchy is not None and hierarchy.fine is not None and hierarchy.fine.dim == 2
        require_cells(problem, cells)
        # Cells without unknowns have no block.
        block_cells = np.flatnonzero(np.diff(offsets) != 0)
        self._equal = len(block_cells) == cells and len(set(np.diff(offsets).tolist())) == 1
        system = System(
            problem.A,
            problem.b,
            np.append(offsets[block_cells], offsets[-1]),
            None,
            _columns(problem.near_null),
            problem.symmetric,
        )
        self._kind: Kind = "linear" if not plane else "plane" if system.width == 1 else "plane blocks"
        # Scale the matrix by a power of two, so that squares neither over- nor underflow.
        self.system, self._given, self._matrix_factor = system, system.A, matrix_factor(system.A)
        if self._matrix_factor != 1.0:
            parts = system.b, system.block_offsets, None, system.near_null
            self.system = System.trusted(self._matrix_factor * system.A, *parts)
        if recipe == "agglomerates" and not (hierarchy is not None and hierarchy.levels):
            raise OptionError(
                "recipe 'agglomerates' requires a hierarchy with levels, and this one has none: solve on "
                "agglo.agglomerate(mesh, n_parts=…)"
            )
        # Labels of coarse levels, renumbered without the cells that have no unknowns.
        self._classical = is_classical(self.system)
        labelled = recipe == "agglomerates" or not self._classical
        self._labels = (
            [_renumber_labels(array[block_cells]) for array in _levels(hierarchy, count)]
            if labelled and hierarchy is not None
            else []
        )
        self.cycle: Any = "V" if cycle == "auto" else cycle
        self.dtype: Any = np.float32 if precision == "single" else np.float64
        # Scale each right-hand side by an own power of two.
        whole = self.system.b.reshape(self.system.n, -1)
        self._factors = [factor_for(float(np.abs(array).max())) for array in whole.T]
        self._b = frozen_float(whole * np.array(self._factors))
        self._doubled = self._components = ""

    @property
    def A(self) -> Any:
        """Matrix ``(n, n)``, scaled by a power of two."""
        return self.system.A

    @property
    def columns(self) -> list[Float]:
        """List of right-hand sides ``(n,)``, each scaled by a power of two."""
        return list(self._b.T)

    @property
    def choice(self) -> str:
        """Text that describes coarsening, cycle and precision."""
        aggregates = "agglomerates" if self._labels else "the graph of the matrix"
        method = f"smoothed aggregation by {aggregates}"
        if self._classical:
            method = "a classical step, then " + method if self._labels else "classical coarsening"
        return f"{method}, {self.cycle}-cycle, {np.dtype(self.dtype).name}" + self._doubled

    @property
    def advice(self) -> str:
        """Advice to use ``direct`` if faster, for cells of equal size only."""
        if not self._equal or self._components:
            return self._components
        return advice_of_multigrid(self.system.A, self._kind, self._b.shape[1])

    @property
    def single(self) -> bool:
        """Return True if cycles run in single precision."""
        return bool(self.dtype == np.float32)

    def use_double(self) -> None:
        """Switch to double precision."""
        if self.single:
            self.dtype, self._doubled = np.float64, "; double precision took over"

    def renew_plan(self) -> None:
        """Do nothing, because linear systems have a single solution strategy (plan)."""

    def change_method(self) -> bool:
        """Switch to double precision, or return False if cycles already run in double precision."""
        single = self.single
        self.use_double()
        return single

    def stack(self) -> Any:
        """Build the levels, or raise LinAlgError for a block that is not positive definite."""
        return stack_of_system(self.system, self._labels, self.dtype)

    def preconditioner(self, M: LinearOperator) -> LinearOperator:
        """Rescale a cycle for the scaled matrix to a preconditioner for the problem's matrix."""
        return M if self._matrix_factor == 1.0 else self._matrix_factor * M

    def parts(self, stack: Any) -> tuple[int | None, ...]:
        """Cell count on the finest level, and None on coarser levels, which may come from the matrix."""
        return self._cells, *(None for _ in stack.levels[1:])

    def iterate(
        self,
        M: LinearOperator,
        tolerance: float,
        most: int,
        before: Sequence[History] | None,
        notify: Notify,
        pace: float | None = None,
    ) -> list[History]:
        """Run conjugate gradients for each right-hand side from its last iterate. Return all histories."""
        histories = list(before or ())
        todo = [j for j in range(self._b.shape[1]) if not (histories and histories[j].final)]
        start = np.stack([histories[j].x for j in todo], axis=1) if histories else None
        new = pcg_columns(
            self.system.A,
            self._b[:, todo],
            M,
            start,
            tolerance=tolerance,
            most=most,
            stop="both",
            probe=False,
            pace=pace,
            notify=notify,
        )
        width = self.system.width
        if width in (2, 3) and any(each.iterations >= _MANY and each.ended != "rounding" for each in new):
            self._components = advice_of_components(self.system.A, M, width)
        if not histories:
            return list(new)
        for j, history in zip(todo, new, strict=True):
            histories[j] = history
        return histories

    def given_back(self, solution: Solution) -> Solution:
        """Return the solution unchanged, because the unknowns are not renumbered."""
        return solution

    def unsolved(self, reason: str) -> list[History]:
        """Return a history for each right-hand side of an iteration that could not start."""
        return [unsolved(each, reason) for each in self._b.T]

    def solution(
        self,
        histories: Sequence[History],
        operators: list[tuple[Any, Any]],
        watch: Stopwatch,
        tolerance: float,
    ) -> Solution:
        """Build the solution from the histories of all right-hand sides.

        Columns are as in :class:`~agglo_core.problems.Solution`.
        """
        # Scale x back, column by column.
        back = 1.0 / self._matrix_factor
        columns = [unscaled(unscaled(h.x, f), back) for h, f in zip(histories, self._factors, strict=True)]
        # Report residuals and reason of the worst column.
        last, outcome = worst_column(histories), joint_outcome(histories)
        residuals = np.array(outcome["residuals"])
        if not histories[last].converged:  # the last entry was updated, not computed from x
            residuals[-1] = two_norm(self._b[:, last] - self.system.A @ histories[last].x)
        outcome["residuals"] = frozen_float(residuals / self._factors[last])
        return Solution(
            x=frozen_float(np.stack(columns, axis=1).reshape(self.system.b.shape)),
            A=self._given,
            b=self.system.b,
            operators=[(unscaled_matrix(A, self._matrix_factor), P) for A, P in operators],
            seconds=watch.wall,
            cpu_seconds=watch.cpu,
            tolerance=tolerance,
            columns=self._unscaled_histories(histories, columns) if self.system.b.ndim == 2 else (),
            **outcome,
        )

    def _unscaled_histories(
        self, histories: Sequence[History], columns: Sequence[Float]
    ) -> tuple[History, ...]:
        """Return the histories of the given right-hand sides, with their solutions ``columns``."""
        return tuple(
            replace(history, x=x, residuals=frozen_float(history.residuals / factor))
            for history, x, factor in zip(histories, columns, self._factors, strict=True)
        )


class DiscretisedTask(LinearTask):
    """Discretised problem whose levels come from the matrix alone, as for unknowns at vertices and edges."""

    def __init__(self, fine: FineSystem, cycle: str = "auto", precision: str = "auto") -> None:
        super().__init__(Linear(fine.A, fine.b), None, None, "auto", cycle, precision)
        self._fine = fine

    def preconditioner(self, M: LinearOperator) -> LinearOperator:
        """Rescale a cycle to a preconditioner for the problem's matrix."""
        return self._fine.preconditioner(super().preconditioner(M))

    def solution(
        self,
        histories: Sequence[History],
        operators: list[tuple[Any, Any]],
        watch: Stopwatch,
        tolerance: float,
    ) -> Solution:
        """Build the solution of the discretised problem."""
        solved = super().solution(histories, operators, watch, tolerance)
        history = replace(histories[0], x=solved.x, residuals=solved.residuals)
        return self._fine.solution(history, solved.operators, watch, tolerance)


def _columns(near_null: Any) -> Any:
    return near_null if near_null is None or np.ndim(near_null) != 1 else np.asarray(near_null)[:, None]


def _levels(hierarchy: Hierarchy, count: int | None) -> list[Int]:
    return chosen_levels(hierarchy, count) if hierarchy.levels else []


def _renumber_labels(labels: Int) -> Int:
    return frozen_int(np.unique(labels, return_inverse=True)[1])
