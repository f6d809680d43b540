"""Diffusion problems as the default solver takes them: the system, its levels, one right-hand side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import Diffusion, Hierarchy, History, OptionError, Solution, Tell, pcg
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.operators import fine_system
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.recipes import Plan, Wishes, levels_by_default, plan_for
from agglo_polydg_mg.stationary import unsolved

__all__ = ["DiffusionTask"]


class DiffusionTask:
    """A diffusion problem discretised on the mesh of a hierarchy.

    Raises
    ------
    OptionError, MeshError
        As :func:`~agglo_polydg_mg.operators.fine_system`.
    """

    def __init__(
        self, problem: Diffusion, hierarchy: Hierarchy, how: PolyDG, wishes: Wishes, count: int | None
    ) -> None:
        self.problem, self.hierarchy, self.count = problem, hierarchy, count
        self.fine = fine_system(problem, hierarchy, how)
        if hierarchy.fine is None:
            raise OptionError("a diffusion problem needs a mesh; this hierarchy belongs to a bare graph")
        self.basis = Basis(hierarchy.fine, how.degree, how.scaled_basis)
        self.plan: Plan = plan_for(problem, self.fine, self.basis, wishes)

    @property
    def A(self) -> Any:
        """The matrix ``(n, n)``."""
        return self.fine.A

    @property
    def choice(self) -> str:
        """Which levels, and why."""
        return self.plan.reason

    @property
    def cycle(self) -> str:
        """Kind of the cycle."""
        return self.plan.cycle

    @property
    def single(self) -> bool:
        """Whether cycles are in single precision."""
        return bool(self.plan.dtype == np.float32)

    def in_double(self) -> None:
        """Go on in double precision."""
        if self.single:
            reason = f"{self.plan.reason}; double precision took over"
            self.plan = replace(self.plan, dtype=np.float64, reason=reason)

    def stack(self) -> Any:
        """The levels; LinAlgError if a matrix is not positive definite."""
        labels = levels_by_default(self.hierarchy, self.count)
        return self.plan.stack(self.problem, self.fine, self.basis, labels)

    def parts(self, stack: Any) -> tuple[int | None, ...]:
        """Agglomerates of each level; None of a level with unknowns at vertices."""
        below, cells = stack.levels[1:], self.hierarchy.graph.n
        if self.plan.recipe != "patches":
            return cells, *(None for _ in below)
        return cells, *(int(each.labels.max()) + 1 for each in below)

    def iterate(
        self, M: LinearOperator, tolerance: float, most: int, before: Sequence[History] | None, tell: Tell
    ) -> list[History]:
        """Conjugate gradients, from where others ended if there are any: the history of the only column."""
        measure = self.fine.measure
        found = pcg(
            self.fine.A,
            self.fine.b,
            M,
            before[0].x if before else None,
            tolerance=tolerance,
            most=most,
            stop="both",
            probe=False,
            measure=measure,
            energy=measure.energy,
            tell=tell,
        )
        return [found]

    def unsolved(self, reason: str) -> list[History]:
        """The history of an iteration that could not start."""
        return [unsolved(self.fine.b, reason)]

    def solution(
        self, histories: Sequence[History], operators: list[tuple[Any, Any]], seconds: Mapping[str, float]
    ) -> Solution:
        """The solution that histories lead to."""
        return self.fine.solution(histories[0], operators, seconds)
