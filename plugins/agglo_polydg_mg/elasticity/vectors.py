"""Vector functions on a mesh: their components and rigid motions.

Unknowns are ordered by cell, in a cell by component: component a of cell c has the coefficients
``x.reshape(n_cells, d, n_local)[c, a]``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from agglo_core.authoring import Field, Float, Mesh, OptionError, VectorField, frozen_float
from agglo_polydg_mg.space.basis import Basis


def components(field: VectorField, mesh: Mesh, name: str) -> list[Field]:
    """Return the components of a vector field, each a number, ``(n,)`` cell values or a callable.

    Raises
    ------
    OptionError
        For another shape; a callable's values are checked when it is called.
    """
    dim, n = mesh.dim, mesh.n_cells
    if callable(field):
        return [_component(field, axis, dim, name) for axis in range(dim)]
    values = frozen_float(field)
    if values.shape not in ((dim,), (n, dim)):
        raise OptionError(
            f"{name} has shape {values.shape}: expected ({dim},) or ({n}, {dim}) values, or a callable"
        )
    return [values[axis] if values.ndim == 1 else frozen_float(values[:, axis]) for axis in range(dim)]


def _component(field: Callable[[Float], Any], axis: int, dim: int, name: str) -> Field:
    def component(points: Float) -> Float:
        values = np.asarray(field(points), float)
        if values.shape not in ((dim,), (len(points), dim)):
            raise OptionError(
                f"{name} returned shape {values.shape} for {len(points)} points, not (q, {dim})"
            )
        return np.asarray(values[..., axis])

    return component


def split(basis: Basis, x: Float) -> Float:
    """Return the coefficients ``(n_cells, d, n_local)`` of the vector function ``x (d n,)``."""
    dim = basis.mesh.dim
    if np.shape(x) != (dim * basis.n,):
        raise OptionError(
            f"the vector has shape {np.shape(x)}, but this space has ({dim * basis.n},) unknowns"
        )
    return np.reshape(x, (basis.mesh.n_cells, dim, basis.n_local))


def vector_blocks(blocks: Float, dim: int) -> Float:
    """Return cell matrices ``(n, d m, d m)`` that apply ``blocks (n, m, m)`` to each component."""
    n, m, _ = blocks.shape
    repeated = np.eye(dim)[None, :, None, :, None] * blocks[:, None, :, None, :]
    return frozen_float(repeated.reshape(n, dim * m, dim * m))


def joined(basis: Basis, parts: Sequence[Float]) -> Float:
    """Return the vector function ``(d n,)`` with the given components, the reverse of :func:`split`."""
    return frozen_float(np.stack([np.reshape(x, (-1, basis.n_local)) for x in parts], axis=1).ravel())


def coordinates(basis: Basis) -> Float:
    """Return the coordinates x_i as discrete functions ``(n_cells, d, m)``, exact for every degree.

    They are relative to the mesh centre, and divided by half the largest extent of the mesh.
    """
    mesh, dim = basis.mesh, basis.mesh.dim
    low, high = mesh.local_points.min(axis=0), mesh.local_points.max(axis=0)
    # x_i = centre_i + Σ_a (∂x_i / ∂x̂_a) x̂_a, with 1 = √2 L₀ and x̂ = √⅔ L₁(x̂) along each axis
    found = np.zeros((mesh.n_cells, dim, basis.n_local))
    constant = 2.0 ** (0.5 * dim) / basis.scale
    found[:, :, 0] = (basis.centres - 0.5 * (low + high)) * constant[:, None]
    slope = np.linalg.inv(basis.directions).transpose(0, 2, 1)  # ∂x_i / ∂x̂_a
    found[:, :, 1 : dim + 1] = slope * (constant / np.sqrt(3.0))[:, None, None]
    return np.asarray(found / (0.5 * (high - low).max()))


def rigid_motions(basis: Basis) -> Float:
    """Return the translations and rotations ``(d n, d (d + 1) / 2)``, exact for every degree.

    Rotations are about the mesh centre, scaled to the size of the translations.
    """
    dim, n_cells = basis.mesh.dim, basis.mesh.n_cells
    one = basis.constants(np.ones(n_cells)).reshape(n_cells, 1, -1)
    values = np.concatenate((one, coordinates(basis)), axis=1).transpose(0, 2, 1)
    return motions_of(values.reshape(-1, dim + 1), basis.n_local)


def motions_of(values: Float, width: int = 1) -> Float:
    """Return translations and rotations ``(d n, k)`` from the unknowns ``values (n, 1 + d)`` of 1 and x.

    The components alternate after each ``width`` unknowns.
    """
    one, x = values[:, 0].reshape(-1, width), values[:, 1:].T.reshape(values.shape[1] - 1, -1, width)
    dim = len(x)
    motions = np.zeros((dim * (dim + 1) // 2, len(one), dim, width))
    for axis in range(dim):
        motions[axis, :, axis] = one
    for k, (first, second) in enumerate(combinations(range(dim), 2)):
        motions[dim + k, :, first], motions[dim + k, :, second] = -x[second], x[first]
    return frozen_float(motions.reshape(len(motions), -1).T)
