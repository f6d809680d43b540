"""Multigrid for a matrix: levels built once, for repeated solves and as a preconditioner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.multigrid.coarsening.aggregation import aggregation_stack, blockwise
from agglo_core.multigrid.coarsening.classical import classical_stack
from agglo_core.multigrid.coarsening.near_null import smoothed_near_null
from agglo_core.multigrid.cycle import Kind, cycle
from agglo_core.multigrid.krylov.pcg import pcg, pcg_columns
from agglo_core.multigrid.stack import Level, LevelStack
from agglo_core.problems import Solution, System
from agglo_core.problems.iteration_history import History, joint_outcome
from agglo_core.problems.multigrid_level import LevelTable
from agglo_core.problems.real_arrays import real_array
from agglo_core.suggestions import suggest_keywords


@suggest_keywords()
def build_levels(
    A: Any,
    hierarchy: Hierarchy | None = None,
    *,
    block_offsets: ArrayLike | None = None,
    near_null: ArrayLike | None = None,
) -> SystemLevels:
    """Build algebraic multigrid levels for a symmetric positive definite matrix.

    For scalar systems (one unknown per block, no near-null vector except a positive vector), levels are
    classical (Ruge and Stüben). Otherwise they come from smoothed aggregation.

    Parameters
    ----------
    A : (n, n) sparse
    hierarchy : Hierarchy, optional
        Hierarchy with agglomerates to use as aggregates, where block c holds the unknowns of cell c. By
        default, aggregates come from the matrix graph.
    block_offsets : (blocks + 1,) int or int, optional
        Block c has the unknowns ``block_offsets[c]:block_offsets[c + 1]``. A whole number is the size of
        all blocks. Default: with a hierarchy n / n_cells unknowns per block, otherwise the blocks of a BSR
        matrix, or single unknowns.
    near_null : (n, m) float, optional
        Near-null vectors of A, such as rigid motions. Default: constants.

    Raises
    ------
    OptionError
        If A is not square, symmetric and finite with a positive diagonal, or other arguments do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(2000, 2000))
    >>> levels = agglo.build_levels(A)
    >>> levels
    level  unknowns  entries  smoother
        0      2000     5998  CoarseFirst
        1      1000     2998  CoarseFirst
        2       500     1498  direct
    >>> solution = levels.solve(np.ones(2000), tolerance=1e-10)
    >>> solution.converged, bool(np.allclose(A @ solution.x, 1.0))
    (True, True)
    """
    n = np.shape(A)[0] if np.ndim(A) == 2 else 0
    if hierarchy is not None and not isinstance(hierarchy, Hierarchy):
        raise OptionError(
            f"the hierarchy must be a Hierarchy, given {type(hierarchy).__name__}; for a mesh or graph pass "
            "agglomerate(mesh, …)"
        )
    if hierarchy is not None and block_offsets is None:
        cells = hierarchy.graph.n
        if n % cells:
            raise OptionError(
                f"block_offsets are required: {n} unknowns cannot be divided equally among {cells} cells"
            )
        block_offsets = np.arange(cells + 1) * (n // cells)
    mesh, labels = (None, ()) if hierarchy is None else (hierarchy.fine, hierarchy.levels)
    system = System(A, np.zeros(n), block_offsets, mesh, near_null)  # type: ignore[arg-type]  # it checks them
    try:
        return SystemLevels(system, stack_of_system(system, labels))
    except np.linalg.LinAlgError as failure:
        raise OptionError(f"cannot build levels for this matrix: {failure}") from failure


def is_classical(system: System) -> bool:
    """Return True if classical coarsening can represent the near-null vectors of a system.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import is_classical
    >>> from agglo_core.problems import System
    >>> A = np.diag([2.0, 2.0])
    >>> is_classical(System(A, np.zeros(2))), is_classical(System(A, np.zeros(2), np.array([0, 2])))
    (True, False)
    """
    near = system.near_null
    positive = near is None or (near.shape[1] == 1 and bool((near > 0.0).all()))
    return system.width == 1 and positive


def stack_of_system(system: System, labels: Sequence[Int] = (), dtype: Any = np.float64) -> LevelStack:
    """Build the levels of a linear system: classical, or by aggregation for blocks and near-null vectors.

    Parameters
    ----------
    system : System
    labels : sequence of (blocks,) int
        Agglomerates to use as aggregates, finest first.
    dtype : numpy dtype
        Precision of the cycles.

    Raises
    ------
    LinAlgError
        If a block is not positive definite.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid import stack_of_system
    >>> from agglo_core.problems import System
    >>> stack_of_system(System(np.diag(np.full(4, 2.0)), np.zeros(4)))
    level  unknowns  entries  smoother
        0         4        4  direct
    """
    A, near_null = sparse.csr_array(system.A), system.near_null
    if is_classical(system):
        return classical_stack(A, labels=labels or None, near_null=near_null, dtype=dtype)
    if near_null is not None or system.width != 1:
        near_null = smoothed_near_null(system.A, system.block_offsets, near_null)
    return aggregation_stack(
        A,
        labels=labels or None,
        near_null=near_null,
        block_offsets=system.block_offsets,
        dtype=dtype,
        smoother=blockwise,
    )


@dataclass(frozen=True, eq=False, repr=False)
class SystemLevels:
    """Multigrid levels of a matrix, for repeated solves and as a preconditioner.

    Attributes
    ----------
    system : System
        Matrix with blocks and near-null vectors, and right-hand side 0.
    stack : LevelStack

    Examples
    --------
    >>> from scipy.sparse.linalg import cg
    >>> mesh = agglo.samples.squares(32)
    >>> A = agglo.Linear.example(mesh).A
    >>> levels = agglo.build_levels(A, agglo.agglomerate(mesh, n_parts=(256, 64)))
    >>> x, failed = cg(A, np.ones(mesh.n_cells), M=levels.aspreconditioner(), rtol=1e-8)
    >>> failed
    0
    """

    system: System
    stack: LevelStack

    @property
    def levels(self) -> Sequence[Level]:
        """Levels, finest first, with the matrix ``A``, the prolongation ``P`` and the smoother of each."""
        return self.stack.levels

    @property
    def operator_complexity(self) -> float:
        """Matrix entries of all levels divided by those of the finest level."""
        return self.stack.operator_complexity

    @property
    def grid_complexity(self) -> float:
        """Unknowns of all levels divided by those of the finest level."""
        return self.stack.grid_complexity

    @property
    def table(self) -> LevelTable:
        """Table of unknowns, matrix entries and smoother per level."""
        return self.stack.table

    def __repr__(self) -> str:
        return repr(self.table)

    def aspreconditioner(self, kind: Kind = "V") -> LinearOperator:
        """Return a multigrid cycle ``(n, n)`` of kind "V", "W", "F" or "K". V and W are symmetric."""
        return cycle(self.stack, kind)

    @suggest_keywords()
    def solve(
        self, b: ArrayLike, x0: Float | None = None, *, tolerance: float = 1e-8, max_iterations: int = 300
    ) -> Solution:
        """Solve A x = b by conjugate gradients, preconditioned by a V-cycle.

        Parameters
        ----------
        b : (n,) or (n, k) float
            One or several right-hand sides. The columns are iterated together, each until it has converged.
        x0 : (n,) or (n, k) float, optional
            Initial iterate. Default: 0.
        tolerance : float
            Tolerance of residual and energy error, see :func:`agglo_core.multigrid.pcg`.
        max_iterations : int

        Returns
        -------
        Solution
            Solution with the last iterate, converged or not. For several right-hand sides, ``columns`` has
            the outcome of each.

        Raises
        ------
        OptionError
            For a right-hand side or initial iterate that does not fit or is not finite.

        Examples
        --------
        >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(2000, 2000))
        >>> solution = agglo.build_levels(A).solve(np.eye(2000, 3))
        >>> solution.x.shape, [column.converged for column in solution.columns]
        ((2000, 3), [True, True, True])
        """
        A, right = self.system.A, frozen_float(real_array("b", b))
        iteration: dict[str, Any] = {"tolerance": tolerance, "most": max_iterations, "stop": "both"}
        histories: tuple[History, ...]
        if right.ndim == 2:
            histories = pcg_columns(A, right, self.aspreconditioner(), x0, **iteration)
            x = np.stack([history.x for history in histories], axis=1)
        else:
            histories = (pcg(A, right, self.aspreconditioner(), x0, **iteration),)
            x = histories[0].x
        return Solution(
            x=frozen_float(x),
            A=A,
            b=right,
            operators=self.stack.operators,
            seconds={},
            operator_complexity=self.operator_complexity,
            grid_complexity=self.grid_complexity,
            tolerance=tolerance,
            columns=histories if right.ndim == 2 else (),
            **joint_outcome(histories),
        )
