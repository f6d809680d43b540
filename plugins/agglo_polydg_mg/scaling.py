"""Right-hand sides whose squares are beyond what floating-point numbers hold, brought near 1."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Mesh, OptionError, frozen_float

__all__ = ["data_size", "factor_for", "times", "unscaled"]

_MODERATE = 1e100
_DIGITS = 1e-10


def factor_for(size: float) -> float:
    """A power of two that brings numbers of a size near 1; 1 itself if their squares do no harm."""
    if size == 0.0 or 1.0 / _MODERATE <= size <= _MODERATE:
        return 1.0
    return math.ldexp(1.0, max(-1000, min(1000, -math.frexp(size)[1])))


def times(problem: Diffusion, factor: float) -> Diffusion:
    """The problem whose solution is that many times the solution of the given one."""
    return replace(
        problem,
        source=_product(problem.source, factor),
        dirichlet={tag: _product(each, factor) for tag, each in problem.dirichlet.items()},
        neumann={tag: _product(each, factor) for tag, each in problem.neumann.items()},
        exact=None if problem.exact is None else _product(problem.exact, factor),
    )


def data_size(mesh: Mesh, problem: Diffusion) -> float:
    """Largest value of source and boundary data, callables taken at centroids of cells and faces."""
    centres = mesh.face_centroids[mesh.face_cells[:, 1] < 0]
    boundary = (*problem.dirichlet.values(), *problem.neumann.values())
    return max((*_sizes([problem.source], mesh.cell_centroids), *_sizes(boundary, centres)), default=0.0)


def unscaled(x: Float, factor: float) -> Float:
    """``x / factor``; OptionError if that is out of the range of floating-point numbers."""
    result = x / factor
    if factor != 1.0 and np.abs(result * factor - x).max() > _DIGITS * np.abs(x).max():
        raise OptionError(
            f"the solution is of size {np.abs(result).max():.0e}, beyond what floating-point numbers hold: "
            "give the data in other units"
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
