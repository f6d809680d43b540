"""Power-of-two scaling for right-hand sides and matrices, so that squares stay in range."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field

_MODERATE = 1e100  # sizes between 1e-100 and 1e100 need no scaling
_MODERATE_MATRIX = 1e10
"""Narrower than ``_MODERATE``, because levels may be in single precision."""
_DIGITS = 1e-10  # maximum relative loss when scaling back


def factor_for(size: float, moderate: float = _MODERATE) -> float:
    """Return a power of two that scales ``size`` to about 1, or 1 if the size is moderate."""
    if size == 0.0 or 1.0 / moderate <= size <= moderate:
        return 1.0
    return math.ldexp(1.0, max(-1000, min(1000, -math.frexp(size)[1])))


def matrix_factor(A: Any) -> float:
    """Return a power of two that scales the median diagonal entry to about 1, or 1 if moderate."""
    return factor_for(float(np.median(np.abs(A.diagonal()))), _MODERATE_MATRIX)


def unscaled_matrix(A: Any, factor: float) -> Any:
    """Return ``A / factor`` in double precision, or A itself for a factor of 1."""
    if factor == 1.0:
        return A
    return (A.astype(np.float64) if A.dtype == np.float32 else A) * (1.0 / factor)


def times(problem: Diffusion, factor: float) -> Diffusion:
    """Multiply source and boundary data, and so the solution, by a factor."""
    exact = problem.exact
    return replace(
        problem,
        source=_product(problem.source, factor),
        dirichlet={tag: _product(each, factor) for tag, each in problem.dirichlet.items()},
        neumann={tag: _product(each, factor) for tag, each in problem.neumann.items()},
        robin={tag: (alpha, _product(g, factor)) for tag, (alpha, g) in problem.robin.items()},
        exact=exact and (lambda points: factor * np.asarray(exact(points), float)),
    )


def data_size(mesh: Mesh, problem: Diffusion) -> float:
    """Return the largest absolute source or boundary value, with callables evaluated at centroids."""
    centres = mesh.face_centroids[mesh.face_cells[:, 1] < 0]
    robin = [g for _, g in problem.robin.values()]
    boundary = (*problem.dirichlet.values(), *problem.neumann.values(), *robin)
    return max((*_sizes([problem.source], mesh.cell_centroids), *_sizes(boundary, centres)), default=0.0)


def unscaled(x: Float, factor: float) -> Float:
    """Return ``x / factor``, or raise OptionError if floating-point numbers cannot hold the result."""
    result = x / factor
    if factor != 1.0 and np.abs(result * factor - x).max() > _DIGITS * np.abs(x).max():
        raise OptionError(
            f"the solution has magnitude {np.abs(result).max():.0e}, outside the range of floating-point "
            "numbers: give the data in other units"
        )
    return frozen_float(result)


def _product(field: Field, factor: float) -> Field:
    if callable(field):
        return lambda points: factor * np.asarray(field(points), float)
    scaled: Float = factor * np.asarray(field, float)
    return scaled if scaled.ndim else float(scaled)


def _sizes(fields: Iterable[Field], points: Float) -> list[float]:
    values = [each(points) if callable(each) else each for each in fields]
    return [float(np.abs(np.asarray(each, float)).max()) for each in values]
