"""Test case: the arguments of a single call to a component."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import Linear, MultigridLevel, Solution


@dataclass(frozen=True)
class Case:
    """Test case: a name, the arguments of one call to a component, and the code that makes drawn arguments.

    ``mesh`` is the mesh of a drawn graph, if its cells are the nodes in their order. ``options`` are those of
    the component for this call.

    ================  =================================
    kind              arguments
    ================  =================================
    bisector          ``(graph, seeds)``
    direct partition  ``(graph, seeds, target)``
    refiner           ``(graph, labels, seeds, target)``
    fixer             ``(graph, labels)``
    metric            ``(mesh, labels)``
    solver            ``(problem, hierarchy)``
    discretisation    ``(problem, mesh)``
    estimator         ``(solution,)``
    format            ``(mesh, suffix)``
    sample            none
    problem           ``(mesh,)``
    smoother          ``(level, b, x)``
    transfer          ``(coarsening,)``
    coarse operator   ``(coarsening, P)``
    coarse solver     ``(A, b)``
    constraint        ``(mesh, labels)``
    section           ``(mesh, runs)``
    ================  =================================
    """

    name: str
    given: tuple[Any, ...] = field(repr=False)
    code: str = ""
    mesh: Mesh | None = field(default=None, repr=False)
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name of the test case with its options."""
        return self.name + "".join(f" with {name}={value!r}" for name, value in self.options.items())

    @property
    def size(self) -> int | None:
        """Expected length of the component's result, or None if unknown or not an array."""
        first = self.given[0]
        if isinstance(first, Mesh) and isinstance(self.given[-1], np.ndarray):
            return int(self.given[-1].max()) + 1
        if isinstance(first, MultigridLevel) or sparse.issparse(first):
            return len(self.given[-1])
        if isinstance(first, Solution):
            return first.mesh.n_cells if first.mesh else None
        return first.n if isinstance(first, Graph) else None

    @property
    def sort(self) -> str:
        """Category of the test case, which a component may refuse as a whole.

        A component that refuses the first case of a category may refuse all its cases. Problems are grouped
        by class, linear systems also by block size. Any other case is a category by itself.
        """
        problem = self.given[0] if self.given else None
        if isinstance(problem, Mesh | Graph):
            return self.name
        if not isinstance(problem, Linear):
            return type(problem).__name__
        return "linear" if len(problem.b) < len(problem.block_offsets) else "linear, in blocks"
