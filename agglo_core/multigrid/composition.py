"""Multigrid methods composed of named components: transfer, coarse operator, smoother, coarse solver."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.multigrid.coarse_operators import Galerkin, Rediscretised
from agglo_core.multigrid.coarse_solve import Dense, Elimination, SparseLU
from agglo_core.multigrid.coarsening.transfers import Aggregation, Injection, SmoothedInjection, parents
from agglo_core.multigrid.matrices.block_matrix import in_blocks
from agglo_core.multigrid.matrices.galerkin import galerkin, injection
from agglo_core.multigrid.named_parts import part
from agglo_core.multigrid.smoothers.adapted import adapted
from agglo_core.multigrid.smoothers.level_smoothers import SMOOTHERS, BlockJacobi, Chebyshev, GaussSeidel
from agglo_core.multigrid.smoothers.patches import vertex_patches
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack, Real, Solve
from agglo_core.problems import Coarsening, CoarseSpace, MultigridLevel, System
from agglo_core.progress import Notify, ignore_progress
from agglo_core.registry import Registry
from agglo_core.registry.attribution import Member, attributed

_TRANSFERS: Final[Mapping[str, Callable[[], Any]]] = MappingProxyType(
    {"injection": Injection, "smoothed": SmoothedInjection, "aggregation": Aggregation}
)
_COARSE_OPERATORS: Final[Mapping[str, Callable[[], Any]]] = MappingProxyType(
    {"galerkin": Galerkin, "rediscretised": Rediscretised}
)
_COARSE_SOLVERS: Final[Mapping[str, Callable[[], Any]]] = MappingProxyType(
    {"elimination": Elimination, "dense": Dense, "lu": SparseLU}
)


class Composition:
    """Multigrid method composed of four components, each given by name, as object, or as function.

    Parameters
    ----------
    transfer : "smoothed", "injection", "aggregation", or a component of kind ``transfer``
        Representation of coarse unknowns on the finer level: coarse functions, smoothed or unchanged, or
        smoothed near-null vectors on agglomerates.
    coarse_operator : "galerkin", "rediscretised", or a component of kind ``coarse_operator``
        Matrices of coarse levels: Pᵀ A P, or rediscretisation on the agglomerates.
    smoother : "gauss_seidel", "block_jacobi", "chebyshev", or a component of kind ``smoother``
    coarse_solver : "elimination", "dense", "lu", or a component of kind ``coarse_solver``
        Solver for the coarsest level, and for smoothers that add the next coarse correction.
    registry : Registry, optional
        Registry of names. Default: the installed plugins.

    Attributes
    ----------
    transfer, coarse_operator, smoother, coarse_solver : Member
        The components (``tool``) with their titles in errors.
    title : str
        Description of the parts.

    Raises
    ------
    OptionError
        For an unknown name, or an object that is not a component.
    PluginError
        For an unusable component.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import Composition, cycle, pcg
    >>> from agglo_core.problems import System
    >>> A = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(64, 64))
    >>> system = System(A, np.ones(64))
    >>> stack = Composition(smoother="chebyshev").stack(system, [np.arange(64) // 4, np.arange(64) // 16])
    >>> [level.A.shape[0] for level in stack.levels]
    [64, 16, 4]
    >>> pcg(system.A, system.b, cycle(stack, "W")).converged
    True
    """

    def __init__(
        self,
        transfer: Any = "smoothed",
        coarse_operator: Any = "galerkin",
        smoother: Any = "gauss_seidel",
        coarse_solver: Any = "elimination",
        *,
        registry: Registry | None = None,
    ) -> None:
        self.transfer = part("transfer", transfer, _TRANSFERS, registry)
        self.coarse_operator = part("coarse_operator", coarse_operator, _COARSE_OPERATORS, registry)
        self.smoother = part("smoother", smoother, SMOOTHERS, registry)
        self.coarse_solver = part("coarse_solver", coarse_solver, _COARSE_SOLVERS, registry)
        given = (transfer, coarse_operator, smoother, coarse_solver)
        kinds = ("transfer", "coarse_operator", "smoother", "coarse_solver")
        self.title = ", ".join(map(_title, kinds, given))

    @property
    def galerkin(self) -> bool:
        """Return True if coarse matrices are Pᵀ A P."""
        return isinstance(self.coarse_operator.tool, Galerkin)

    def stack(
        self,
        system: System,
        labels: Sequence[Int],
        *,
        injected: Sequence[Any] | None = None,
        rediscretised: Sequence[Callable[[], Any]] | None = None,
        steps: int = 1,
        corrections: bool = True,
        notify: Notify = ignore_progress,
    ) -> LevelStack:
        """Build the multigrid levels of a linear system on agglomerates, for cycles in double precision.

        Parameters
        ----------
        system : System
            System. With a mesh, smoothers receive each level's patches.
        labels : sequence of (n_blocks,) int
            Agglomerate per block (cell) on the coarse levels, finest first.
        injected : sequence of (n, m) sparse, optional
            Coarse functions on the next finer level, finest first, from a discretisation. Default: the
            unknowns of a part are copied to its children.
        rediscretised : sequence of callables, optional
            Functions that return the coarse matrices.
        steps : int
            Smoothing steps before and after the coarse correction.
        corrections : bool
            Provide coarse corrections to smoothers that use them.
        notify : callable, optional
            Receives the set-up progress.

        Raises
        ------
        OptionError
            For parts that do not fit each other or the system.
        PluginError
            For a result of a part that violates its protocol.
        LinAlgError
            If a matrix is not positive definite. The message names the level.
        """
        level_labels = _check_level_lists(labels, system.n_blocks, injected, rediscretised)
        offsets, near_null = system.block_offsets, system.near_null
        A = inherited = in_blocks(system.A, offsets)
        parts = frozen_int(np.arange(system.n_blocks))
        levels: list[Level] = []
        for k, coarse in enumerate(level_labels):
            notify(k / (len(level_labels) + 1), f"level {k}")
            # Coarse space, coarse matrix, and the inherited matrix Pᵀ A P.
            parent_of = parents(parts, coarse)
            inject = _injection(parent_of, offsets) if injected is None else injected[k]
            rediscretise = None if rediscretised is None else rediscretised[k]
            step = Coarsening(A, offsets, parts, coarse, parent_of, near_null, inject, rediscretise)
            try:
                space = self._space(step)
                A_next, blocks = self._matrix(step, space), _require_offsets(space.block_offsets)
                is_galerkin = self.galerkin and inherited is A
                inherited_next = A_next if is_galerkin else in_blocks(galerkin(inherited, space.P), blocks)
                # Smoother, with the coarse correction and patches if needed.
                has_correction = corrections and getattr(self.smoother.tool, "uses_coarse", True)
                correction = _correction(space.P, self._solver(inherited_next)) if has_correction else None
                patches = None if system.mesh is None else vertex_patches(system.mesh, parts if k else None)
                level = MultigridLevel(A, inherited, offsets, parts, space.P, correction, steps, patches)
                levels.append(Level(A, offsets, space.P, self._smoother(level), parts, patches))
            except np.linalg.LinAlgError as error:
                raise np.linalg.LinAlgError(f"level {k}: {error}") from error
            A, inherited, offsets, parts, near_null = A_next, inherited_next, blocks, coarse, space.near_null
        levels.append(Level(A, offsets, labels=parts))
        return LevelStack(levels, self._solver(A))

    def _space(self, step: Coarsening) -> CoarseSpace:
        """Compute the coarse space by the transfer, and check its prolongation and block offsets."""
        with _attribute_errors(self.transfer):
            made = self.transfer.tool.prolongation(step)
            space = made if isinstance(made, CoarseSpace) else CoarseSpace(made)
            P = _check_matrix("prolongation", space.P, (step.A.shape[0], None))
            parts, m, offsets = int(step.coarse_labels.max()) + 1, P.shape[1], space.block_offsets
            if offsets is None:
                if m == 0 or m % parts:
                    raise PluginError(
                        f"P has {m} columns for {parts} parts: return a CoarseSpace with block_offsets "
                        "that assign the columns to parts"
                    )
                offsets = frozen_int(np.arange(parts + 1) * (m // parts))
            fits = np.shape(offsets) == (parts + 1,) and offsets[0] == 0 and offsets[-1] == m
            if not fits or (np.diff(offsets) < 0).any():
                raise PluginError(f"block_offsets must increase from 0 to {m} and have {parts + 1} entries")
        return CoarseSpace(P, frozen_int(offsets), space.near_null)

    def _matrix(self, step: Coarsening, space: CoarseSpace) -> Any:
        """Compute the coarse matrix by the coarse operator, check it, and convert it to blocks."""
        m = space.P.shape[1]
        with _attribute_errors(self.coarse_operator):
            made = self.coarse_operator.tool.coarse_matrix(step, space.P)
            return in_blocks(
                _check_matrix("coarse_matrix", made, (m, m)), _require_offsets(space.block_offsets)
            )

    def _smoother(self, level: MultigridLevel) -> LevelSmoother:
        tool = self.smoother.tool
        if isinstance(tool, GaussSeidel | BlockJacobi | Chebyshev):
            return tool.setup(level)
        return adapted(tool, level, self.smoother.title, partial(_attribute_errors, self.smoother))

    def _solver(self, A: Any) -> Solve:
        tool = self.coarse_solver.tool
        if isinstance(tool, Elimination | Dense | SparseLU):
            return tool.solver_for(A)
        with _attribute_errors(self.coarse_solver):
            solve = tool.solver_for(A)
            if not callable(solve):
                raise PluginError(f"solver_for returned {solve!r:.60}, expected a function of b")

        return partial(_solution, self.coarse_solver, solve)


def _solution(member: Member, solve: Solve, b: Real) -> Real:
    """Solve with a coarse-level solver, and raise PluginError for a result of wrong shape or type."""
    with _attribute_errors(member):
        x: Real = np.asarray(solve(b))
        if x.shape != b.shape or x.dtype.kind != "f":
            raise PluginError(
                f"the solver returned shape {x.shape} of {x.dtype}, expected {b.shape} of float64"
            )
    return x


def _title(kind: str, choice: Any) -> str:
    if isinstance(choice, Member):
        return choice.title
    name = choice[0] if type(choice) is tuple else choice
    object_name = getattr(choice, "__name__", type(choice).__name__)
    return f"{kind} {name if isinstance(name, str) else object_name}"


def _attribute_errors(member: Member) -> Any:
    """Return a context manager that adds a component's name to exceptions, except to those of agglo."""
    return attributed(member.title, spare=(AggloError, np.linalg.LinAlgError))


def _check_level_lists(labels: Sequence[Int], n: int, *sequences: Sequence[Any] | None) -> list[Int]:
    arrays = [frozen_int(array) for array in labels]
    for k, array in enumerate(arrays):
        if array.shape != (n,) or array.min() < 0:
            raise OptionError(f"labels[{k}] must be {n} numbers, 0 or more, one for each block of the system")
    for name, sequence in zip(("injected", "rediscretised"), sequences, strict=True):
        if sequence is not None and len(sequence) != len(arrays):
            raise OptionError(f"{name} must be given for each of {len(arrays)} levels; given {len(sequence)}")
    return arrays


def _injection(parent_of: Int | None, offsets: Int) -> Any:
    """Return the default prolongation by injection, or None if block sizes vary or levels are not nested."""
    sizes = np.diff(offsets)
    return None if parent_of is None or sizes.min() != sizes.max() else injection(parent_of, int(sizes[0]))


def _correction(P: Any, solve: Solve) -> Callable[[Float], Float]:
    """Return the coarse correction P B⁻¹ Pᵀ as a function, with ``solve`` for B⁻¹."""
    return partial(_apply_correction, P, solve, sparse.csr_array(P.T))


def _apply_correction(P: Any, solve: Solve, PT: Any, r: Float) -> Float:
    return np.asarray(P @ solve(PT @ r))


def _check_matrix(title: str, result: Any, shape: tuple[int, int | None]) -> Any:
    """Check shape and values of the matrix from a component, and return it in CSR or BSR format.

    None in the shape stands for any column count.
    """
    rows, columns = shape
    fits = sparse.issparse(result) and result.dtype.kind in "fiu" and result.shape[0] == rows
    if not fits or columns not in (None, result.shape[1]):
        summary = f"{result.shape} of {result.dtype}" if sparse.issparse(result) else f"{result!r:.60}"
        expected_shape = f"({rows}, {'m' if columns is None else columns})"
        raise PluginError(f"{title} returned {summary}, expected a sparse matrix {expected_shape} of floats")
    matrix = result if result.format in ("bsr", "csr") else sparse.csr_array(result)
    if not np.isfinite(matrix.data).all():
        raise PluginError(f"{title} returned values that are not finite")
    return matrix


def _require_offsets(offsets: Int | None) -> Int:
    assert offsets is not None  # made with the space
    return offsets
