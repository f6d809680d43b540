"""Renumber cells along a space-filling curve during a solve if neighbours have distant indices.

Neighbours far apart in memory cost about half the time of large solves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Elasticity,
    Float,
    Hierarchy,
    Index,
    Int,
    Lifting,
    Mesh,
    Solution,
    frozen_float,
    frozen_int,
    solvers,
)
from agglo_core.graph.ordering import curve_order
from agglo_core.problems.solution import Deferred

FEW: Final = {2: 10_000, 3: 3_000}
"""Number of cells, by dimension, up to which any order is fast enough (benchmarks/solve.py)."""
_SCATTERED: Final = 4.0
"""Limit for the mean number difference of neighbours over √n, in 3-D n^⅔: about 0.5 for rows or curves.

A larger value leaves more meshes in their own order, a smaller one renumbers meshes that gain little
(benchmarks/solve.py).
"""


@dataclass(frozen=True, eq=False)
class Numbering:
    """Cell numbering used during a solve.

    Attributes
    ----------
    hierarchy : Hierarchy
        Mesh and levels in this numbering.
    cells : (n_cells,) int, optional
        The user's number for each cell; None if the user's numbering is kept.
    """

    hierarchy: Hierarchy
    cells: Int | None = None

    @property
    def mesh(self) -> Mesh:
        """The hierarchy's mesh, in this numbering."""
        assert self.hierarchy.fine is not None  # numbering_for excludes bare graphs
        return self.hierarchy.fine

    @cached_property
    def _places(self) -> Int:
        """Number in this numbering for each of the user's cells."""
        assert self.cells is not None
        return frozen_int(np.argsort(self.cells))

    @property
    def remark(self) -> str:
        """Note for the user on the renumbering."""
        return "" if self.cells is None else "; cells renumbered along a curve, as their order is scattered"

    def problem(self, problem: Any) -> Any:
        """Return the diffusion or elasticity problem with cell values in this numbering."""
        if self.cells is None:
            return problem
        if isinstance(problem, Elasticity):
            fields = ("young", "poisson", "lame_lambda", "lame_mu", "reaction", "force")
            data = {name: self._taken(getattr(problem, name)) for name in fields}
            data |= {name: self._all_taken(getattr(problem, name)) for name in ("displacement", "traction")}
            return replace(problem, **data)
        return replace(
            problem,
            kappa=self._taken(problem.kappa),
            source=self._taken(problem.source),
            reaction=self._taken(problem.reaction),
            convection=self._taken(problem.convection),
            dirichlet=self._all_taken(problem.dirichlet),
            neumann=self._all_taken(problem.neumann),
            robin={tag: (self._taken(alpha), self._taken(g)) for tag, (alpha, g) in problem.robin.items()},
        )

    def _all_taken(self, data: Mapping[int, Any]) -> Mapping[int, Any]:
        return {tag: self._taken(field) for tag, field in data.items()}

    def _taken(self, field: Any) -> Any:
        """Reorder cell values to this numbering, and return anything else unchanged.

        Invalid data pass unchanged too: later checks refuse them.
        """
        if field is None or callable(field) or self.cells is None:
            return field
        try:
            values = np.asarray(field, dtype=float)
        except (TypeError, ValueError):
            return field
        by_cell = values.ndim > 0 and len(values) == len(self.cells)  # vectors and tensors, too
        return values[self.cells] if by_cell else field

    def solution(self, solution: Solution) -> Solution:
        """Convert a solution to the user's numbering.

        Its matrices are computed on first access.
        """
        if self.cells is None:
            return solution
        rows = self._rows(len(solution.x))
        lifting = solution.lifting
        if lifting is not None:
            lifting = Lifting(
                *(_take_rows(values, rows) for values in (lifting.offset, lifting.rest, lifting.load))
            )
        A, (finest, P), *coarser = solution.A, *solution.operators
        user_matrix = Deferred(partial(_matrix, A, self.cells))
        levels_of = user_matrix if finest is A else Deferred(partial(_matrix, finest, self.cells))
        operators: Any = Deferred(partial(_operators, levels_of, P, rows, coarser))
        return replace(
            solution,
            x=_take_rows(solution.x, rows),
            b=_take_rows(solution.b, rows),
            A=user_matrix,
            operators=operators,
            lifting=lifting,
        )

    def load(self, load: Float) -> Float:
        """Convert a vector ``(n,)`` of the user's numbering to this numbering."""
        if self.cells is None:
            return load
        own = np.empty_like(load)
        own[self._rows(len(load))] = load
        return frozen_float(own)

    def operator(self, M: LinearOperator) -> LinearOperator:
        """Convert an operator to one on vectors in the user's numbering."""
        if self.cells is None:
            return M
        rows = self._rows(M.shape[0])
        back = np.argsort(rows)

        def applied(x: Any) -> Any:
            return (M @ np.asarray(x).ravel()[back])[rows]

        return LinearOperator(M.shape, matvec=applied, rmatvec=applied, dtype=M.dtype)

    def _rows(self, n: int) -> Int:
        """Return the index in this numbering for each of the user's ``n`` unknowns."""
        width = n // len(self._places)
        first = width * self._places
        return frozen_int((first[:, None] + np.arange(width)).ravel())


def numbering_for(hierarchy: Hierarchy) -> Numbering:
    """Return the cell numbering in which to solve on a hierarchy.

    The user's numbering is kept if it is not scattered or the cells are few.

    Raises
    ------
    OptionError
        If the hierarchy belongs to another mesh.
    """
    mesh, graph = hierarchy.fine, hierarchy.graph
    if mesh is None or graph.n < FEW[mesh.dim] or not _is_scattered(graph.indptr, graph.indices, mesh.dim):
        return Numbering(hierarchy)
    cells = curve_order(graph.centroids)
    there = solvers.own_mesh(hierarchy).renumbered(cells)
    levels = [labels[cells] for labels in hierarchy.levels]
    return Numbering(replace(hierarchy, fine=there, graph=there.graph, levels=levels), cells)


def _is_scattered(indptr: Int, indices: Index, dim: int) -> bool:
    """Return True if neighbouring cells have distant indices on average."""
    n = len(indptr) - 1
    distances = np.abs(indices - np.repeat(np.arange(n, dtype=np.int32), np.diff(indptr)))
    return bool(distances.mean() > _SCATTERED * n ** (1 - 1 / dim)) if len(distances) else False


def _take_rows(values: Float, rows: Int) -> Float:
    return frozen_float(values.take(rows))


def _matrix(A: sparse.bsr_array, cells: Int) -> sparse.bsr_array:
    """Convert a cell block matrix to the user's numbering."""
    n, width = len(cells), A.blocksize[0]
    places = sparse.csr_array((np.arange(len(A.indices)), A.indices, A.indptr), shape=(n, n))
    back = np.argsort(cells)
    places = places[back][:, back]
    places.sort_indices()
    taken = A.data.take(places.data, axis=0), places.indices, places.indptr
    return sparse.bsr_array(taken, shape=A.shape, blocksize=(width, width))


def _operators(A: Deferred, P: Any, rows: Int, coarser: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Return matrices and prolongations of the levels, the finest in the user's numbering."""
    return [(A.value, None if P is None else sparse.csr_array(P)[rows]), *coarser]
