"""The paper's smoother, conjugate gradients preconditioned by additive Schwarz, and the component of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Member, MultigridLevel, Registry, Smoother, multigrid
from agglo_polydg_mg.auxiliary.transfer import diagonal_blocks

Solve = Callable[[Float], Float]
"""Maps a right-hand side or residual ``(n,)`` to a solution or correction ``(n,)``."""
Smooth = Callable[[Float, Float], Float]
"""Maps ``(b, x)`` to a better x."""
SmootherMaker = Callable[[Any, Solve, Solve | None, int], Smooth]
"""Makes a smoother from matrix, solve in the parts, correction of the next level, number of steps."""


def pcg_steps(A: Any, b: Float, x: Float, precondition: Solve, steps: int) -> Float:
    """``x (n,)`` after some steps of preconditioned conjugate gradients, restarted.

    Raises
    ------
    LinAlgError
        If matrix or preconditioner turn out not to be positive definite.
    """
    r = b - A @ x if x.any() else b
    if not r.any():
        return x
    z = precondition(r)
    p, rho = z, float(r @ z)
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
    """Exact solve with the diagonal blocks of each cell.

    Raises
    ------
    LinAlgError
        If a block is singular.
    """
    inverses = np.linalg.inv(diagonal_blocks(A, width))
    return partial(_equal_blocks, inverses)


def _equal_blocks(inverses: Float, r: Float) -> Float:
    return np.asarray((inverses @ r.reshape(len(inverses), -1, 1)).ravel())


def local_solve(A: Any, block_offsets: Int) -> Solve:
    """Exact solve with the diagonal blocks ``block_offsets[k]:block_offsets[k + 1]`` of any sizes.

    Raises
    ------
    LinAlgError
        If a block is singular.
    """
    sizes = np.diff(block_offsets)
    if len(sizes) and sizes.min() == sizes.max() > 0:
        return block_jacobi(A, int(sizes[0]))
    entries = sparse.coo_array(A)
    row, column = entries.coords
    block = np.repeat(np.arange(len(sizes)), sizes)
    inside = block[row] == block[column]
    row, column, values = row[inside], column[inside], entries.data[inside]
    groups = []
    for size in np.unique(sizes[sizes > 0]).tolist():
        chosen = np.flatnonzero(sizes == size)
        place = np.full(len(sizes), -1)
        place[chosen] = np.arange(len(chosen))
        here = place[block[row]] >= 0
        k, first = place[block[row[here]]], block_offsets[block[row[here]]]
        blocks = np.zeros((len(chosen), size, size))
        np.add.at(blocks, (k, row[here] - first, column[here] - first), values[here])
        groups.append((block_offsets[chosen, None] + np.arange(size), np.linalg.inv(blocks)))

    return partial(_grouped_blocks, groups)


def _grouped_blocks(groups: Sequence[tuple[Int, Float]], r: Float) -> Float:
    x = np.zeros(len(r))
    for unknowns, inverses in groups:
        x[unknowns] = (inverses @ r[unknowns][:, :, None])[:, :, 0]
    return x


def schwarz(A: Any, local: Solve, coarse: Solve | None, steps: int) -> Smooth:
    """The paper's smoother: ``steps`` of conjugate gradients, preconditioned by additive Schwarz.

    Parameters
    ----------
    A : sparse
    local : callable
        Solves in the subdomains, here the cells; see :func:`block_jacobi`.
    coarse : callable, optional
        Adds the correction of the next level.
    steps : int

    Notes
    -----
    What the steps do depends on ``b`` and ``x``: the smoother is nonlinear.
    """
    return partial(_steps, A, partial(_added, local, coarse), steps)


def _added(local: Solve, coarse: Solve | None, r: Float) -> Float:
    return local(r) if coarse is None else local(r) + coarse(r)


def _steps(A: Any, precondition: Solve, steps: int, b: Float, x: Float) -> Float:
    return pcg_steps(A, b, x, precondition, steps)


class Schwarz:
    """The paper's smoother: conjugate gradients preconditioned by additive Schwarz, restarted in each call.

    Blocks of the parts and the correction of the next level belong to the inherited matrices, as in the
    paper's experiments. What the steps do depends on ``b`` and ``x``: the smoother is nonlinear.
    """

    def setup(self, level: MultigridLevel) -> Smooth:
        """Return ``smooth(b, x)``; LinAlgError if a block is singular."""
        return _Made(schwarz).setup(level)


@dataclass(frozen=True)
class _Made:
    """The smoother a function makes from matrix, local solve, correction of the next level and steps."""

    maker: SmootherMaker

    def setup(self, level: MultigridLevel) -> Smooth:
        local = local_solve(level.inherited, level.block_offsets)
        return self.maker(level.A, local, level.coarse, level.steps)


_OWN = MappingProxyType({"schwarz": Schwarz, **multigrid.SMOOTHERS})
"""Names that need no registry."""


def smoother_of(given: Any, registry: Registry | None = None) -> Member:
    """A smoother, from the name of its component, the smoother itself, or the function that makes it.

    Parameters
    ----------
    given : str, object with ``setup``, or callable
        A callable has the arguments of :func:`~agglo_polydg_mg.paper.schwarz.schwarz`.
    registry : Registry, optional
        Where names are looked up; by default the installed plugins.

    Raises
    ------
    OptionError
        If it is none of these, or no smoother has the name.
    PluginError
        If the component cannot be used.
    """
    if callable(given) and not isinstance(given, Smoother | type):
        return Member(_Made(given), f"smoother {getattr(given, '__name__', type(given).__name__)}")
    return multigrid.part("smoother", given, _OWN, registry)
