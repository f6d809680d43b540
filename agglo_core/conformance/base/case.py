"""A case: one question to a component, that is one call with its arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Linear, MultigridLevel


@dataclass(frozen=True)
class Case:
    """One question: its name and the arguments, as the method of the kind takes them.

    A bisector is given ``(graph, seeds)``, for a direct partition ``(graph, seeds, target)``, a refiner
    ``(graph, labels, seeds, target)``, a fixer ``(graph, labels)``, a metric ``(mesh, labels)``, a solver
    ``(problem, hierarchy)``, a discretisation ``(problem, mesh)``, a format ``(mesh, suffix)``, a problem
    ``(mesh,)``, a smoother ``(level, b, x)``, a constraint ``(graph, labels)``, a section ``(mesh, runs)``, a
    sample nothing; a transfer ``(coarsening,)``, a coarse operator ``(coarsening, P)``, a coarse solver ``(A,
    b)``.
    """

    name: str
    given: tuple[Any, ...]

    @property
    def size(self) -> int | None:
        """How many values the answer has, if it is an array and the length is known."""
        first = self.given[0]
        if isinstance(first, MultigridLevel):
            return len(self.given[1])
        if isinstance(first, Mesh) and isinstance(self.given[-1], np.ndarray):
            return int(self.given[-1].max()) + 1
        return first.n if isinstance(first, Graph) else None

    @property
    def sort(self) -> str:
        """What may be refused as a whole: a sort of problem by a solver, otherwise this one question."""
        problem = self.given[0] if self.given else None
        if isinstance(problem, Mesh | Graph):
            return self.name
        if not isinstance(problem, Linear):
            return type(problem).__name__
        return "linear" if len(problem.b) < len(problem.block_offsets) else "linear, in blocks"
