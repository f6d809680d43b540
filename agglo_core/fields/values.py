"""Values of coefficients and data on cells and at points, checked."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import AggloError, MeshError, OptionError


def per_cell(field: float | Float, n: int, name: str) -> Float:
    """Convert a number or an array of cell values to finite cell values ``(n,)``.

    Raises
    ------
    OptionError
        For anything else; the message names the field.
    """
    try:
        values = frozen_float(field)
    except MeshError as error:
        raise OptionError(
            f"{name} must be a number, ({n},) values or a callable; given {field!r:.60} ({error})"
        ) from None
    if values.shape not in ((), (n,)):
        raise OptionError(f"{name} has shape {values.shape}: expected a number, ({n},) values or a callable")
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        where = f" in cell {bad[0]}" if values.ndim else ""
        raise OptionError(f"{name} must be finite: it is {values.flat[bad[0]]}{where}")
    return np.broadcast_to(values, (n,))


def sample(field: Callable[[Float], Float], points: Float, name: str, shape: tuple[int, ...] = ()) -> Float:
    """Evaluate a callable at ``points (q, d)`` in user coordinates, and check the values ``(q, *shape)``.

    Raises
    ------
    OptionError
        If the callable fails, or its values are not numbers, have another shape, or are not finite.
    """
    try:
        returned = field(points)
    except AggloError:
        raise
    except Exception as error:  # a user's callable may raise any exception
        raise OptionError(
            f"{name} failed for {len(points)} points of shape {points.shape}: {type(error).__name__}: {error}"
        ) from error
    try:
        values = frozen_float(returned)
    except MeshError as error:
        raise OptionError(f"{name} did not return real numbers for {len(points)} points: {error}") from None
    if values.shape not in (shape, (len(points), *shape)):
        expected = len(points), *shape
        raise OptionError(
            f"{name} returned shape {values.shape} for {len(points)} points, expected {expected}"
        )
    finite = np.isfinite(values)
    if not finite.all():
        at = points[np.argwhere(~finite)[0, 0]].tolist() if values.shape != shape else "all points"
        raise OptionError(f"{name} must be finite: it is {values[~finite][0]} at {at}")
    return np.broadcast_to(values, (len(points), *shape))


def central_differences(field: Callable[[Float], Float], points: Float, steps: Float) -> Float:
    """Return the gradients ``(q, d)`` of a callable at ``points (q, d)`` by fourth-order differences.

    Parameters
    ----------
    field : callable
        Maps ``q`` points to values ``(q,)``.
    points : (q, d) float
    steps : (q, d) float
        Step lengths along the axes. With 1e-4 of the cell size, differences are exact to about 1e-12
        (benchmarks/constants.py).
    """
    result = np.empty_like(steps)
    for axis, unit in enumerate(np.eye(points.shape[1])):
        h = steps * unit
        far, near = (field(points + k * h) - field(points - k * h) for k in (2, 1))
        result[:, axis] = (8.0 * near - far) / (12.0 * steps[:, axis])
    return result
