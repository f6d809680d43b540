"""Linear systems for the default solver whose matrix need not be symmetric."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.multigrid import flow_stack, gcr, row_measure
from agglo_core.problems import Linear
from agglo_core.problems.iteration_history import History
from agglo_core.progress import Notify
from agglo_core.solvers.linear_task import LinearTask
from agglo_core.solvers.residual_measure import ResidualMeasure

_ACCEPTED = (("recipe", ("auto",)), ("cycle", ("auto", "V", "W", "F")), ("precision", ("auto", "double")))


class GeneralTask(LinearTask):
    """Linear system with ``symmetric=False`` for multigrid, with levels along the flow.

    The levels are those of :func:`~agglo_core.multigrid.flow_stack`. They come from the matrix alone.

    Raises
    ------
    OptionError
        For a recipe, cycle or precision for symmetric matrices alone. See also :class:`LinearTask`.
    """

    def __init__(
        self,
        problem: Linear,
        hierarchy: Hierarchy | None,
        recipe: str = "auto",
        cycle: str = "auto",
        precision: str = "auto",
    ) -> None:
        for (name, accepted), given in zip(_ACCEPTED, (recipe, cycle, precision), strict=True):
            if given not in accepted:
                raise OptionError(
                    f"{name} {given!r} requires a symmetric matrix, but the system has symmetric=False: use "
                    f"one of {', '.join(accepted)}"
                )
        super().__init__(problem, hierarchy)
        self.cycle = "W" if cycle == "auto" else cycle
        self._failed = False

    @property
    def choice(self) -> str:
        """Text that describes coarsening and cycle."""
        return f"pairs of strong couplings, blocks downstream, {self.cycle}-cycle, float64 (symmetric=False)"

    @property
    def advice(self) -> str:
        """Advice to use ``direct`` where multigrid has failed."""
        return "multigrid does not suit this matrix: use the solver direct" if self._failed else ""

    def stack(self) -> Any:
        """Build the levels, or raise LinAlgError for a singular block."""
        try:
            return flow_stack(self.system)
        except np.linalg.LinAlgError as error:
            raise np.linalg.LinAlgError(f"{error}; use the solver direct") from None

    def iterate(
        self,
        M: LinearOperator,
        tolerance: float,
        most: int,
        before: Sequence[History] | None,
        notify: Notify,
        pace: float | None = None,
    ) -> list[History]:
        """Run :func:`~agglo_core.multigrid.gcr` for each right-hand side, and return all histories."""
        histories = list(before or ())
        for j, b in enumerate(self.columns):
            earlier = histories[j] if before else None
            if earlier is not None and earlier.final:
                continue
            history = gcr(
                self.A,
                b,
                M.matvec,
                None if earlier is None else earlier.x,
                tolerance=tolerance,
                most=most,
                pace=pace,
                measure=ResidualMeasure(b, rows=row_measure(self.A, b)),
                notify=notify,
            )
            histories[j : j + 1] = [history]
        self._failed = not all(each.converged for each in histories)
        return histories
