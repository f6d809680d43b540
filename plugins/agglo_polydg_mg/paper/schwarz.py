"""The paper's smoother component: conjugate gradients preconditioned by additive Schwarz."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, MultigridLevel, Registry, Smoother, frozen_float, multigrid
from agglo_core.registry.attribution import Member
from agglo_polydg_mg.auxiliary.transfer import diagonal_blocks

Solve = Callable[[Float], Float]
"""Map from a right-hand side or residual ``(n,)`` to a solution or correction ``(n,)``."""
Smooth = Callable[[Float, Float], Float]
"""Map from ``(b, x)`` to a better x."""
SmootherMaker = Callable[[Any, Solve, Solve | None, int], Smooth]
"""Factory for smoothers from matrix, local solve, correction by the next level, number of steps."""


def pcg_steps(A: Any, b: Float, x: Float, precondition: Solve, steps: int) -> Float:
    """Take a few steps of preconditioned conjugate gradients from x, and return the iterate ``(n,)``.

    Raises
    ------
    LinAlgError
        If matrix or preconditioner prove not to be positive definite.
    """
    # 1. Residual and first direction
    r = b - A @ x if x.any() else b
    if not r.any():
        return x
    z = precondition(r)
    p, rho = z, float(r @ z)
    # 2. Steps: minimise along p, update residual and direction
    for step in range(steps):
        Ap = A @ p
        curvature = float(p @ Ap)
        if rho == 0.0:
            break
        if not (rho > 0.0 and curvature > 0.0):
            raise np.linalg.LinAlgError("the matrix or its preconditioner is not positive definite")
        alpha = rho / curvature
        x, r = x + alpha * p, r - alpha * Ap
        if step + 1 < steps:
            z = precondition(r)
            rho, before = float(r @ z), rho
            p = z + (rho / before) * p
    return x


def block_jacobi(A: Any, width: int) -> Solve:
    """Return an exact solver for each cell's diagonal block in a matrix.

    Raises
    ------
    LinAlgError
        If a block is singular.
    """
    inverses = frozen_float(np.linalg.inv(diagonal_blocks(A, width)))
    return partial(_equal_blocks, inverses)


def _equal_blocks(inverses: Float, r: Float) -> Float:
    return np.asarray((inverses @ r.reshape(len(inverses), -1, 1)).ravel())


def local_solve(A: Any, block_offsets: Int) -> Solve:
    """Return an exact solver for the diagonal blocks of a matrix, with any block sizes.

    Block k covers the unknowns ``block_offsets[k]:block_offsets[k + 1]``.

    Raises
    ------
    LinAlgError
        If a block is singular.
    """
    # 1. Equal sizes: a single stack
    sizes = np.diff(block_offsets)
    if len(sizes) and sizes.min() == sizes.max() > 0:
        return block_jacobi(A, int(sizes[0]))
    # 2. Entries inside the diagonal blocks
    entries = sparse.coo_array(A)
    row, column = entries.coords
    block = np.repeat(np.arange(len(sizes)), sizes)
    inside = block[row] == block[column]
    row, column, values = row[inside], column[inside], entries.data[inside]
    # 3. Invert the blocks, one stack per size
    groups = []
    for size in np.unique(sizes[sizes > 0]).tolist():
        equal_blocks = np.flatnonzero(sizes == size)
        place = np.full(len(sizes), -1)
        place[equal_blocks] = np.arange(len(equal_blocks))
        in_group = place[block[row]] >= 0
        k, first = place[block[row[in_group]]], block_offsets[block[row[in_group]]]
        blocks = np.zeros((len(equal_blocks), size, size))
        np.add.at(blocks, (k, row[in_group] - first, column[in_group] - first), values[in_group])
        groups.append((block_offsets[equal_blocks, None] + np.arange(size), np.linalg.inv(blocks)))

    return partial(_solve_blocks, groups)


def _solve_blocks(groups: Sequence[tuple[Int, Float]], r: Float) -> Float:
    x = np.zeros(len(r))
    for unknowns, inverses in groups:
        x[unknowns] = (inverses @ r[unknowns][:, :, None])[:, :, 0]
    return x


def schwarz(A: Any, local: Solve, coarse: Solve | None, steps: int) -> Smooth:
    """Return the paper's smoother: conjugate gradients preconditioned by additive Schwarz.

    Parameters
    ----------
    A : sparse
    local : callable
        Solves on the subdomains, here the cells; see :func:`block_jacobi`.
    coarse : callable, optional
        Adds the correction by the next level.
    steps : int
        Step count.

    Notes
    -----
    The steps depend on ``b`` and ``x``: the smoother is nonlinear.
    """
    return partial(_steps, A, partial(_add_corrections, local, coarse), steps)


def _add_corrections(local: Solve, coarse: Solve | None, r: Float) -> Float:
    return local(r) if coarse is None else local(r) + coarse(r)


def _steps(A: Any, precondition: Solve, steps: int, b: Float, x: Float) -> Float:
    return pcg_steps(A, b, x, precondition, steps)


class Schwarz:
    """Smooth by conjugate gradients with additive Schwarz, restarted in each call (the paper's smoother).

    Local blocks and the correction by the next level belong to the inherited matrices, as in the
    paper's experiments. The steps depend on ``b`` and ``x``: the smoother is nonlinear.
    """

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return the smoothing step ``smooth(b, x)`` on a multigrid level.

        Raises
        ------
        LinAlgError
            If a block is singular.
        """
        return _Made(schwarz).setup(level)


@dataclass(frozen=True)
class _Made:
    """Smoother made by a function of matrix, local solve, correction by the next level, and steps."""

    maker: SmootherMaker

    def setup(self, level: MultigridLevel) -> Smooth:
        local = local_solve(level.inherited, level.block_offsets)
        return self.maker(level.A, local, level.coarse, level.steps)


_OWN = MappingProxyType({"schwarz": Schwarz, **multigrid.SMOOTHERS})
"""Smoothers found without a registry."""


def smoother_of(given: Any, registry: Registry | None = None) -> Member:
    """Return the smoother given by a component name, a smoother object, or a factory function.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
        A callable takes the arguments of :func:`~agglo_polydg_mg.paper.schwarz.schwarz`.
    registry : Registry, optional
        Registry for names; by default the installed plugins.

    Raises
    ------
    OptionError
        For any other value, or an unknown name.
    PluginError
        If the component cannot be used.
    """
    if callable(given) and not isinstance(given, Smoother | type):
        return Member(_Made(given), f"smoother {getattr(given, '__name__', type(given).__name__)}")
    return multigrid.part("smoother", given, _OWN, registry)
