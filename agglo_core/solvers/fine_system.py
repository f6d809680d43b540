"""Linear system on the mesh (fine system): a discretised problem or a given linear system."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Lifting, Linear, Problem, Solution
from agglo_core.problems.choosing import discretisation_for
from agglo_core.problems.iteration_history import History
from agglo_core.problems.linear import general_system, require_cells, symmetric_system
from agglo_core.problems.residuals.row_scales import lifted, row_measure
from agglo_core.registry import Registry, default
from agglo_core.registry.construct import resolve
from agglo_core.registry.options import is_named, name_and_options, options_of
from agglo_core.solvers.condensation import Condensation
from agglo_core.solvers.residual_measure import ResidualMeasure
from agglo_core.solvers.scaling import factor_for, matrix_factor, unscaled, unscaled_matrix
from agglo_core.solvers.stopwatch import Stopwatch

_log = logging.getLogger("agglo")

CELLS_PER_PART: Final = 8
"""Cells per part on the first default level, and parts per part on the next. A larger value makes the set-up
cheaper and takes more iterations (benchmarks/solid_ratios.py --meshes solids)."""
_FEWEST: Final = 60
"""Smallest number of parts on the coarsest default level. A larger value leaves a larger system to the direct
solver, a smaller value adds levels (benchmarks/solid_ratios.py --meshes solids)."""


class FineSystem(NamedTuple):
    """Linear system on the mesh: matrix, right-hand side ``(n,)``, unknowns per cell, residual measure.

    The solver may have subtracted ``offset (n,)`` from the solution of A x = ``full``, so b = full − A
    offset. Vectors are ``factor`` times the problem's vectors, a power of two that avoids over- and underflow
    of squares, and 1 for moderate data. The matrix is ``matrix_factor`` times the problem's matrix, hence x
    is factor / matrix_factor times the problem's solution. ``sigma (n_faces,)`` is the jump penalty of
    discretised problems. ``meaning`` holds what interprets unknowns: discretisation, mesh and problem.
    ``penalty (n_faces,)`` is the jump penalty before it was scaled by directions of a tensor coefficient.
    ``means``, if given, maps x to the vector that is subtracted from it, because the problem determines x
    only up to constants.
    ``fixed`` are unknowns with the values of Dirichlet data, which take no load. ``condensed``, if given, is
    the whole system of the problem: the unknowns of this system are its outer unknowns.
    """

    A: Any
    b: Float
    width: int
    measure: ResidualMeasure
    full: Float
    offset: Float | None = None
    factor: float = 1.0
    sigma: Float | None = None
    meaning: tuple[Any, Mesh, Problem] | None = None
    matrix_factor: float = 1.0
    means: Callable[[Float], Float] | None = None
    penalty: Float | None = None
    fixed: Int | None = None
    condensed: Condensation | None = None

    def with_load(self, load: Float) -> FineSystem:
        """Return the system of a discretised problem with ``load (n,)`` added to the right-hand side.

        Raises
        ------
        OptionError
            For a load with another shape, values that are not finite, a linear system, or a problem whose
            solution is unique only up to a constant.
        """
        if self.meaning is None:
            raise OptionError(
                "a load can be added only to discretised problems: alter b of the linear system"
            )
        if self.means is not None:
            raise OptionError("no load can be added where the solution is unique only up to a constant")
        load = np.array(load, dtype=np.float64)
        shape = self.b.shape if self.condensed is None else self.condensed.b.shape
        if load.shape != shape or not np.isfinite(load).all():
            raise OptionError(f"load must contain {shape} finite numbers, given shape {load.shape}")
        condensed = self.condensed
        if self.fixed is not None:
            load[self.fixed if condensed is None else condensed.outer[self.fixed]] = 0.0
        if condensed is not None:
            before, condensed = condensed.load, condensed.with_load(load)
            load = condensed.load - before
        added = frozen_float(self.factor * load)
        b, full = frozen_float(self.b + added), frozen_float(self.full + added)
        measure = self.measure.with_load(added)
        if measure.rows is not None:
            measure = ResidualMeasure(b, rows=row_measure(self.A, b))
        return self._replace(b=b, full=full, measure=measure, condensed=condensed)

    def solution(
        self, history: History, operators: list[tuple[Any, Any]], watch: Stopwatch, tolerance: float
    ) -> Solution:
        """Build the solution for the given load from the history of the iteration without lifted data."""
        x = x_rest = self._solution_of_problem(history.x)
        lifting, full, A = None, unscaled(self.full, self.factor), unscaled_matrix(self.A, self.matrix_factor)
        if self.offset is not None:
            offset = self._solution_of_problem(self.offset)
            x, lifting = frozen_float(offset + x_rest), Lifting(offset, x_rest, unscaled(self.b, self.factor))
        if self.condensed is not None:
            x, A, full, lifting = self.condensed.recover(x), self.condensed.A, self.condensed.b, None
        if self.means is not None:
            means = self.means(x)
            x, full = frozen_float(x - means), frozen_float(full - A @ means)
            if lifting is not None:
                lifting = replace(lifting, offset=frozen_float(lifting.offset - means))
        discretisation, mesh, problem = self.meaning or (None, None, None)
        return Solution(
            x=x,
            A=A,
            b=full,
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
            discretisation=discretisation,
            mesh=mesh,
            problem=problem,
        )

    def preconditioner(self, M: LinearOperator) -> LinearOperator:
        """Rescale a preconditioner for the scaled matrix ``A`` to the problem's matrix.

        Raises
        ------
        OptionError
            If unknowns inside the cells were eliminated.
        """
        if self.condensed is not None:
            raise OptionError(
                "aspreconditioner is not available for a discretisation with unknowns inside cells: they are "
                "eliminated, and the preconditioner belongs to the others"
            )
        return M if self.matrix_factor == 1.0 else self.matrix_factor * M

    def _solution_of_problem(self, x: Float) -> Float:
        return unscaled(unscaled(x, self.factor), 1.0 / self.matrix_factor)


def discretisation(name: str, registry: Registry | None = None, **options: Any) -> Any:
    """Build a discretisation by name, or return None if no plugin offers the name.

    None is not an error here, because linear systems need no discretisation.

    Raises
    ------
    OptionError
        For invalid options.
    """
    known = default() if registry is None else registry
    try:
        target = resolve(known.record("discretisation", name))
    except PluginError as missing:
        _log.debug("%s", missing)
        return None
    return target(**options)


def chosen_discretisation(
    choice: Any, registry: Registry | None, degree: int, own: Mapping[str, Any], defaults: Mapping[str, Any]
) -> Any:
    """Return the discretisation that a solver's options describe.

    Parameters
    ----------
    choice : str, tuple or object
        Name, name with options, or an object, which is taken as it is.
    registry : Registry, optional
        Registry of names. Default: the program's.
    degree : int
        Degree of the polynomials, for discretisations with this option.
    own, defaults : mapping
        Options of the solver for ``polydg`` alone, and their defaults.

    Raises
    ------
    OptionError
        For invalid options, or options of ``polydg`` with another discretisation.
    PluginError
        For an unknown name other than ``polydg``, which linear systems do not need.
    """
    name, options = name_and_options("discretisation", choice) if is_named(choice) else ("", {})
    if name == "polydg":
        return discretisation(name, registry, **{"degree": degree, **own, **options})
    changed = [option for option, value in own.items() if value != defaults[option]]
    if changed:
        raise OptionError(f"{changed[0]} belongs to the discretisation polydg; given with {name or choice!r}")
    if not name:
        return choice
    known = default() if registry is None else registry
    record = known.record("discretisation", name)
    accepted = options_of(resolve(record))
    has_degree = accepted is None or any(option.name == "degree" for option in accepted)
    if has_degree or degree != 1:  # a degree that is not accepted must be refused
        options = {"degree": degree, **options}
    return known.assemble(record, options)


def has_convection(problem: Problem | None) -> bool:
    """Return True if a problem has convection, which makes its matrix nonsymmetric."""
    convection = getattr(problem, "convection", 0.0)
    return callable(convection) or bool(np.any(convection))


def may_be_nonsymmetric(problem: Problem | None) -> bool:
    """Return True for convection, and for linear systems with ``symmetric=False``."""
    return has_convection(problem) or not getattr(problem, "symmetric", True)


def require_symmetric_problem(problem: Problem, solver: str) -> None:
    """Raise OptionError for convection, and for linear systems with ``symmetric=False``."""
    if may_be_nonsymmetric(problem):
        cause = "has convection" if has_convection(problem) else "has symmetric=False"
        raise OptionError(
            f"the problem {cause}, so its matrix is not symmetric, but {solver} requires a symmetric "
            "matrix: use solver='direct' or solver='polydg_mg'"
        )


def fine_system(
    problem: Problem, hierarchy: Hierarchy, how: Any, *, nonsymmetric: bool = False
) -> FineSystem:
    """Return the linear system of a problem on a hierarchy's mesh.

    A linear system is taken as given. Any other problem is discretised if the discretisation accepts its
    kind: by ``how.fine_system(problem, mesh)`` if there is this method, else by ``how.assemble``
    (:func:`discretised_system`). Nonsymmetric matrices are refused unless ``nonsymmetric``.

    Raises
    ------
    OptionError
        If problem and hierarchy do not fit, cells of a linear system have unequal numbers of unknowns, or
        values are not finite. Further errors as :func:`~agglo_core.problems.linear.symmetric_system`.
    """
    if isinstance(problem, Linear):
        return _system_of_problem(problem, hierarchy.graph.n, nonsymmetric and not problem.symmetric)
    if how is None:
        raise OptionError(
            f"a problem of kind {problem.kind} must be discretised, but no installed plugin provides a "
            "discretisation: give a Linear problem, or install the plugin with the discretisation polydg"
        )
    how = discretisation_for(how, problem)
    if getattr(problem, "kind", None) not in how.accepts:
        raise OptionError(f"problem must be a Diffusion or a Linear, given {type(problem).__name__}")
    if not nonsymmetric:
        require_symmetric_problem(problem, "this solver")
    if not hasattr(how, "fine_system"):
        return discretised_system(problem, own_mesh(hierarchy), how)
    system: FineSystem = how.fine_system(problem, own_mesh(hierarchy))
    return system


def discretised_system(problem: Problem, mesh: Mesh, how: Any) -> FineSystem:
    """Return the system that any discretisation assembles, in the form that solvers require.

    ``how.fixed_unknowns(problem, mesh)``, if offered, are subtracted as an offset, and
    ``how.inner_unknowns(mesh)`` are eliminated (:class:`~agglo_core.solvers.condensation.Condensation`),
    unless the matrix may be nonsymmetric.
    ``how.means(problem, mesh)`` is subtracted from the solution.
    Residuals are measured as for linear systems.
    """
    # 1. Assemble, and eliminate unknowns inside the cells
    system = how.assemble(problem, mesh)
    inner = how.inner_unknowns(mesh) if hasattr(how, "inner_unknowns") else np.empty((0, 0), int)
    fixed = how.fixed_unknowns(problem, mesh) if hasattr(how, "fixed_unknowns") else np.empty(0, int)
    condensed, A, b = None, sparse.csr_array(system.A), system.b
    if inner.size and not may_be_nonsymmetric(problem):
        condensed = Condensation.of(A, b, inner)
        A, b, fixed = condensed.matrix, condensed.load, np.searchsorted(condensed.outer, fixed)
    # 2. Scale by powers of two
    factor, factor_of_matrix = factor_for(float(np.abs(b).max(initial=0.0))), matrix_factor(A)
    A, b = A if factor_of_matrix == 1.0 else factor_of_matrix * A, frozen_float(factor * b)
    # 3. Subtract the values of Dirichlet data
    offset, load = np.zeros(len(b)), np.array(b)
    offset[fixed], load[fixed] = b[fixed] / A.diagonal()[fixed], 0.0
    load = frozen_float(load)
    return FineSystem(
        A,
        load,
        1,
        ResidualMeasure(load, rows=row_measure(A, load)),
        b,
        frozen_float(offset) if offset.any() else None,
        factor,
        meaning=(how, mesh, problem),
        matrix_factor=factor_of_matrix,
        means=how.means(problem, mesh) if hasattr(how, "means") else None,
        fixed=frozen_int(fixed),
        condensed=condensed,
    )


def _system_of_problem(problem: Linear, n: int, general: bool) -> FineSystem:
    width = _width(problem, n)
    matrix, full = general_system(problem) if general else symmetric_system(problem)
    factor, factor_of_matrix = factor_for(float(np.abs(full).max(initial=0.0))), matrix_factor(matrix)
    matrix, b = matrix if factor_of_matrix == 1.0 else factor_of_matrix * matrix, frozen_float(factor * full)
    offset, load = (np.zeros(len(b)), b) if general else lifted(matrix, b)
    offset_or_none = offset if offset.any() else None
    measure = ResidualMeasure(load, rows=row_measure(matrix, load))
    return FineSystem(
        sparse.bsr_array(matrix, blocksize=(width, width)),
        load,
        width,
        measure,
        b,
        offset_or_none,
        factor,
        matrix_factor=factor_of_matrix,
    )


def _width(problem: Linear, n: int) -> int:
    """Return the number of unknowns per cell, equal in all ``n`` cells, or raise OptionError."""
    require_cells(problem, n)
    sizes = np.diff(problem.block_offsets)
    if sizes.min() != sizes.max() or sizes[0] == 0:
        raise OptionError(
            f"every cell must have the same number of unknowns; given {sizes.min()} to {sizes.max()}"
        )
    return int(sizes[0])


def own_mesh(hierarchy: Hierarchy) -> Mesh:
    """Return the hierarchy's mesh, or raise OptionError if graph and levels belong to another mesh."""
    mesh, measures = hierarchy.fine, hierarchy.graph.measures
    if mesh is None:
        raise OptionError(
            "a diffusion problem requires a mesh, but this hierarchy belongs to a graph without a mesh: "
            "agglomerate the Mesh instead"
        )
    if len(measures) != mesh.n_cells:
        raise OptionError(
            f"the hierarchy belongs to another mesh: its levels have {len(measures)} cells, but {mesh!r} "
            f"has {mesh.n_cells}"
        )
    cells = np.flatnonzero(~np.isclose(measures, mesh.cell_measures, rtol=1e-6, atol=0.0))
    if len(cells):
        raise OptionError(
            f"the hierarchy belongs to another mesh: cell {cells[0]} has measure {measures[cells[0]]:g} in "
            f"its graph, but {mesh.cell_measures[cells[0]]:g} in {mesh!r}"
        )
    return mesh


def chosen_levels(hierarchy: Hierarchy, levels: int | None = None) -> list[Int]:
    """Return the coarse-level labels that a multigrid method uses, finest first.

    Parameters
    ----------
    hierarchy : Hierarchy
    levels : int, optional
        Number of levels to use, counting the mesh. Default: all.

    Raises
    ------
    OptionError
        If there are fewer levels, or no level is coarser than the mesh.
    """
    most = len(hierarchy.levels) + 1
    if levels is not None and not 2 <= levels <= most:
        raise OptionError(
            f"levels must lie in 2..{most}, counting the mesh and the coarse levels; given {levels}"
        )
    coarse_labels, finer = [], hierarchy.graph.n
    for level, labels in enumerate(hierarchy.levels[: levels - 1 if levels else None]):
        parts = int(labels.max()) + 1
        if parts < finer:
            coarse_labels.append(labels)
            finer = parts
        else:
            _log.info(
                "level %d is skipped: its %d parts are not fewer than the %d of the finer level",
                level,
                parts,
                finer,
            )
    if not coarse_labels and hierarchy.graph.n > 1:  # a single cell needs no coarse level
        raise OptionError(
            f"no level of the hierarchy is coarser than its {hierarchy.graph.n} cells: agglomerate into "
            "fewer parts"
        )
    return coarse_labels


def default_levels(hierarchy: Hierarchy, count: int | None = None, first: int = CELLS_PER_PART) -> list[Int]:
    """Agglomerate the mesh of a hierarchy without levels for a multigrid method, finest level first.

    The first level has ``first`` cells per part, each further level an eighth of the parts, and the coarsest
    at least 60. Parts are split along the axes, without polish. ``count`` limits the number of levels,
    counting the mesh.
    """
    n, sizes = hierarchy.graph.n, list[int]()
    while n // (first * CELLS_PER_PART ** len(sizes)) >= _FEWEST:
        sizes.append(first * CELLS_PER_PART ** len(sizes))
    sizes = sizes[: None if count is None else count - 1]
    if not sizes:
        return []
    from agglo_core.agglomeration import agglomerate

    given = hierarchy.fine if hierarchy.fine is not None else hierarchy.graph
    coarse = agglomerate(given, bisector="coordinate", refiners=(), polish=False, cells_per_part=tuple(sizes))
    return list(coarse.levels)
