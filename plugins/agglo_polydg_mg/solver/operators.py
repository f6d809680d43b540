"""The system on the mesh, and the spaces of the multigrid levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Diffusion,
    Float,
    Hierarchy,
    History,
    Int,
    Lifting,
    Linear,
    Mesh,
    MeshError,
    OptionError,
    Problem,
    Solution,
    System,
    frozen_float,
    frozen_int,
    multigrid,
    symmetric_system,
)
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.auxiliary.transfer import block_matrix, l2_projection
from agglo_polydg_mg.forms.unit_forms import UnitForms
from agglo_polydg_mg.polydg import PolyDG, corrections
from agglo_polydg_mg.solver.residual_measure import ResidualMeasure
from agglo_polydg_mg.solver.scaling import (
    data_size,
    factor_for,
    matrix_factor,
    times,
    unscaled,
    unscaled_matrix,
)
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.stopwatch import Stopwatch


class FineSystem(NamedTuple):
    """System on the mesh: matrix, right-hand side ``(n,)``, unknowns of a cell, measure of residuals.

    ``offset (n,)`` is what was taken out of the solution of A x = ``full``, if anything: b = full − A offset.
    All are ``factor`` times those of the problem, a power of two, 1 where no squares under- or overflow; the
    matrix is ``matrix_factor`` times that of the problem, and x the quotient of both times the solution.
    ``sigma (n_faces,)`` is the penalty of the jumps, of what is discretised here; ``meaning`` is what
    unknowns are, and on which mesh.
    """

    A: Any
    b: Float
    width: int
    measure: ResidualMeasure
    full: Float
    offset: Float | None = None
    factor: float = 1.0
    sigma: Float | None = None
    meaning: tuple[PolyDG, Mesh] | None = None
    matrix_factor: float = 1.0

    def solution(
        self, history: History, operators: list[tuple[Any, Any]], watch: Stopwatch, tolerance: float
    ) -> Solution:
        """The solution of A x = full that a history on A x = b leads to; ``watch`` has timed its phases."""
        x = rest = self._solution_of_problem(history.x)
        lifting = None
        if self.offset is not None:
            offset = self._solution_of_problem(self.offset)
            x, lifting = frozen_float(offset + rest), Lifting(offset, rest, unscaled(self.b, self.factor))
        how, mesh = self.meaning or (None, None)
        return Solution(
            x=x,
            A=unscaled_matrix(self.A, self.matrix_factor),
            b=unscaled(self.full, self.factor),
            operators=[(unscaled_matrix(A, self.matrix_factor), P) for A, P in operators],
            residuals=frozen_float(history.residuals / self.factor),
            converged=history.converged,
            reason=history.reason,
            iterations=history.iterations,
            seconds=watch.wall,
            cpu_seconds=watch.cpu,
            energy_error=history.energy_error,
            tests=history.tests,
            energy_errors=history.energy_errors,
            tolerance=tolerance,
            lifting=lifting,
            backward_error=history.backward_error,
            rounding_limited=history.ended == "rounding",
            discretisation=how,
            mesh=mesh,
        )

    def preconditioner(self, M: LinearOperator) -> LinearOperator:
        """The preconditioner for the matrix of the problem that one for ``A`` is."""
        return M if self.matrix_factor == 1.0 else self.matrix_factor * M

    def _solution_of_problem(self, x: Float) -> Float:
        return unscaled(unscaled(x, self.factor), 1.0 / self.matrix_factor)


@dataclass(frozen=True, eq=False)
class LevelSpaces:
    """System of the mesh, and the spaces of the coarse levels, finest first.

    Attributes
    ----------
    fine : FineSystem
    system : System
        The same, as compositions of multigrid parts take it.
    injected : list of sparse
        Coarse functions on the next finer level: as they are, or their L2 projections where levels do not
        nest.
    rediscretised : list of callables, optional
        Each makes the matrix of a coarse level; None for a linear system.
    """

    fine: FineSystem
    system: System
    injected: list[Any]
    rediscretised: list[Callable[[], Any]] | None = None


def fine_system(
    problem: Problem,
    hierarchy: Hierarchy,
    how: PolyDG,
    basis: Basis | None = None,
    units: UnitForms | None = None,
) -> FineSystem:
    """The system on the mesh.

    A diffusion problem is discretised on the mesh of the hierarchy, with ``basis`` and ``units`` of an
    earlier one if they are given; a linear system is taken as it is.

    Raises
    ------
    OptionError
        If problem and hierarchy do not fit, cells of a linear system have unequal numbers of unknowns, or
        values are not finite; as :func:`~agglo_polydg_mg.forms.assembly.discretise` and
        :func:`~agglo_core.problems.real_system.symmetric_system`.
    """
    if isinstance(problem, Diffusion):
        mesh = own_mesh(hierarchy)
        return _discretised(problem, mesh, how, basis or how.basis(mesh), units)
    if isinstance(problem, Linear):
        return _given(problem, hierarchy.graph.n)
    raise OptionError(f"a problem is a Diffusion or a Linear, given {type(problem).__name__}")


def _discretised(
    problem: Diffusion, mesh: Mesh, how: PolyDG, basis: Basis, units: UnitForms | None
) -> FineSystem:
    system, load, offset, sigma = how.lifted(problem, mesh, basis, units)
    factor = factor_for(float(np.abs(load).max()) or data_size(mesh, problem))
    if factor != 1.0:
        problem = times(problem, factor)
        system, load, offset, sigma = how.lifted(problem, mesh, basis, units)
    if not (_finite(system.b) and _finite(system.A.data)):
        raise OptionError("matrix or right-hand side hold values that are not finite")
    measure, width = how.residual_measure(problem, mesh, load, basis), int(system.block_offsets[1])
    offset_or_none = offset if offset.any() else None
    return FineSystem(system.A, load, width, measure, system.b, offset_or_none, factor, sigma, (how, mesh))


def _finite(values: Float) -> bool:
    """Whether all values are; their squares need not be, but if these are that is faster to tell."""
    flat = values.ravel()
    with np.errstate(over="ignore"):  # the square may, though no entry does
        return bool(np.isfinite(flat @ flat) or np.isfinite(flat).all())


def _given(problem: Linear, n: int) -> FineSystem:
    width = _width(problem, n)
    matrix, full = symmetric_system(problem)
    factor, factor_of_matrix = factor_for(float(np.abs(full).max(initial=0.0))), matrix_factor(matrix)
    matrix, b = matrix if factor_of_matrix == 1.0 else factor_of_matrix * matrix, frozen_float(factor * full)
    offset, load = multigrid.lifted(matrix, b)
    offset_or_none = offset if offset.any() else None
    measure = ResidualMeasure(load, rows=multigrid.row_measure(matrix, load))
    return FineSystem(
        block_matrix(matrix, width),
        load,
        width,
        measure,
        b,
        offset_or_none,
        factor,
        matrix_factor=factor_of_matrix,
    )


def own_mesh(hierarchy: Hierarchy) -> Mesh:
    """The mesh of a hierarchy, whose graph and levels must be of that mesh."""
    mesh, measures = hierarchy.fine, hierarchy.graph.measures
    if mesh is None:
        raise OptionError("a diffusion problem needs a mesh; this hierarchy belongs to a bare graph")
    if len(measures) != mesh.n_cells:
        raise OptionError(
            f"the hierarchy belongs to another mesh: its levels have {len(measures)} cells, {mesh!r} has "
            f"{mesh.n_cells}"
        )
    other = np.flatnonzero(~np.isclose(measures, mesh.cell_measures, rtol=1e-6, atol=0.0))
    if len(other):
        raise OptionError(
            f"the hierarchy belongs to another mesh: in its graph cell {other[0]} has the area "
            f"{measures[other[0]]:g}, in {mesh!r} {mesh.cell_measures[other[0]]:g}"
        )
    return mesh


def _width(problem: Linear, n: int) -> int:
    """Unknowns of each of the ``n`` cells."""
    sizes = np.diff(problem.block_offsets)
    if len(sizes) != n:
        raise OptionError(f"the system has unknowns in {len(sizes)} cells, the hierarchy {n} cells")
    if sizes.min() != sizes.max() or sizes[0] == 0:
        raise OptionError(
            f"every cell must have the same number of unknowns; given {sizes.min()} to {sizes.max()}"
        )
    return int(sizes[0])


def level_spaces(problem: Problem, hierarchy: Hierarchy, labels: Sequence[Int], how: PolyDG) -> LevelSpaces:
    """A problem on all levels: its system on the mesh, and the spaces of the coarse levels.

    Parameters
    ----------
    labels : sequence of (n_cells,) int
        Of the coarse levels, finest first. Of a diffusion problem coarse unknowns are polynomials on the
        agglomerates, of a linear system constants, one for each unknown of a cell.

    Raises
    ------
    OptionError
        As :func:`fine_system`.
    MeshError
        For a mesh of cells that overlap themselves; what rediscretises for agglomerates that do.
    """
    fine = fine_system(problem, hierarchy, how)
    offsets = frozen_int(np.arange(0, fine.A.shape[0] + 1, fine.width))
    if isinstance(problem, Linear):
        near_null = None if problem.near_null is None else _columns(problem.near_null)
        system = System.trusted(fine.A, fine.b, offsets, hierarchy.fine, near_null)
        return LevelSpaces(fine, system, _constant_prolongations(hierarchy, labels, fine.width))
    mesh = own_mesh(hierarchy)
    meshes = [mesh.coarsen(each) for each in labels]
    bases = [how.basis(each) for each in (mesh, *meshes)]
    constant = frozen_float(bases[0].project(lambda points: np.ones(len(points)))[:, None])
    system = System.trusted(fine.A, fine.b, offsets, mesh, constant)
    rediscretised = [
        partial(_coarse_matrix, how, problem, mesh, *each) for each in zip(labels, meshes, strict=True)
    ]
    return LevelSpaces(fine, system, _polydg_prolongations(bases, labels), rediscretised)


def _columns(vectors: Any) -> Float:
    found = np.asarray(vectors, np.float64)
    return frozen_float(found if found.ndim == 2 else found[:, None])


def _coarse_matrix(how: PolyDG, problem: Problem, mesh: Mesh, labels: Int, coarse: Mesh) -> Any:
    try:
        return how.assemble(corrections(problem, mesh, labels), coarse).A
    except MeshError as error:  # a mesh whose cells overlap a little works on its own cells
        raise MeshError(
            f"on the level of {coarse.n_cells} agglomerates: {error} (operators='inherited', or "
            "coarse_operator='galerkin', does not need it)"
        ) from error


def _polydg_prolongations(bases: Sequence[Basis], labels: Sequence[Int]) -> list[Any]:
    P = []
    for level, coarse in enumerate(labels):
        nested = multigrid.parents(labels[level - 1], coarse) if level else coarse
        if nested is not None:
            P.append(project_between(bases[level], bases[level + 1], nested))
            continue
        down = [project_between(bases[0], bases[at], labels[at - 1]) for at in (level, level + 1)]
        P.append(l2_projection(down[0], down[1], bases[0].mass(), bases[0].n_local))
    return P


def _constant_prolongations(hierarchy: Hierarchy, labels: Sequence[Int], width: int) -> list[Any]:
    P = []
    mass = sparse.diags_array(np.repeat(hierarchy.graph.measures, width)).tocsr()
    for level, coarse in enumerate(labels):
        nested = multigrid.parents(labels[level - 1], coarse) if level else coarse
        if nested is not None:
            P.append(multigrid.injection(nested, width))
        else:
            down = [multigrid.injection(each, width) for each in labels[level - 1 : level + 1]]
            P.append(l2_projection(down[0], down[1], mass, width))
    return P
