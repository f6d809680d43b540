"""Norms of the error of a solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, OptionError, frozen_int
from agglo_polydg_mg.assembly import face_coefficients, positive
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.boundary import boundary_faces
from agglo_polydg_mg.penalty import face_penalty
from agglo_polydg_mg.quadrature import Batch, face_points, gauss, inside, sample

__all__ = ["Errors", "errors"]

_STEP = 1e-4  # of the box's half side: differences of fourth order are then exact to about 1e-12
_FACES = 20_000  # taken at once


class Errors(NamedTuple):
    """Norms of u − u_h: ``l2``, ``h1`` = ‖∇(u − u_h)‖ cell by cell, and

    ``dg`` = (‖√κ ∇(u − u_h)‖² + Σ_F γσ ‖[u − u_h]‖²)^½, the jumps over Dirichlet faces included.
    """

    l2: float
    h1: float
    dg: float


def errors(
    basis: Basis,
    x: Float,
    problem: Diffusion,
    *,
    gradient: Callable[[Float], Float] | None = None,
    penalty: float = 10.0,
) -> Errors:
    """Error of the function with coefficients ``x (n,)`` against ``problem.exact``.

    Parameters
    ----------
    basis : Basis
    x : (n,) float
    problem : Diffusion
        Its ``exact`` solution must be continuous across faces.
    gradient : callable of points ``(q, 2)`` returning ``(q, 2)``, optional
        Of the exact solution; by default its central differences over a ten-thousandth of the box.
    penalty : float
        Constant C of the penalty, which the DG norm contains.

    Raises
    ------
    OptionError
        If the problem has no exact solution; as :func:`~agglo_polydg_mg.assembly.discretise`.
    """
    exact = problem.exact
    if exact is None:
        raise OptionError("this problem has no exact solution to compare with")
    kappa = positive(basis.mesh, problem.kappa)
    natural = boundary_faces(basis.mesh, problem).natural
    sigma = face_penalty(basis.mesh, basis.degree, penalty, natural)
    coefficients = basis.coefficients(x)
    sums = np.zeros(3)
    for batch in inside(basis.mesh, 2 * basis.degree + 6):
        cells, points = batch.cells, batch.points + basis.mesh.origin
        e = sample(exact, points, "exact") - basis.evaluate(x, cells, points)
        slopes = _differences(basis, exact, batch) if gradient is None else np.asarray(gradient(points))
        slopes = slopes - np.einsum("qdk,qk->qd", basis.gradients(cells, batch.points), coefficients[cells])
        square = batch.weights * (slopes**2).sum(axis=1)
        here = sample(kappa, points, "kappa") if callable(kappa) else np.asarray(kappa)[cells]
        sums += batch.weights @ e**2, square.sum(), here @ square
    sums[2] += _jumps(basis, x, exact, kappa, sigma)
    return Errors(*np.sqrt(sums).tolist())


def _differences(basis: Basis, exact: Callable[[Float], Float], batch: Batch) -> Float:
    """Gradient ``(q, 2)`` of a callable by central differences of fourth order."""
    steps = _STEP * basis.boxes[batch.cells, 2:]
    result = np.empty_like(steps)
    for axis in range(2):
        h = np.zeros_like(steps)
        h[:, axis] = steps[:, axis]
        at = [sample(exact, batch.points + k * h + basis.mesh.origin, "exact") for k in (-2, -1, 1, 2)]
        result[:, axis] = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * steps[:, axis])
    return result


def _jumps(basis: Basis, x: Float, exact: Callable[[Float], Float], kappa: Field, sigma: Float) -> float:
    """Σ_F γσ ‖[u − u_h]‖² over interior and Dirichlet faces."""
    mesh, n, total = basis.mesh, basis.degree + 4, 0.0
    on_faces, weights = face_coefficients(mesh, kappa, n), gauss(n)[1]
    chosen = np.flatnonzero(sigma > 0)
    for first in range(0, len(chosen), _FACES):
        faces = frozen_int(chosen[first : first + _FACES])
        points = face_points(mesh, faces, n)
        inner, both = mesh.face_cells[faces, 1] >= 0, on_faces[faces]
        outside = sample(exact, points[~inner].reshape(-1, 2) + mesh.origin, "exact").reshape(-1, n)
        jump = _traces(basis, x, mesh.face_cells[faces, 0], points)
        jump[inner] -= _traces(basis, x, mesh.face_cells[faces[inner], 1], points[inner])
        jump[~inner] -= outside
        harmonic = 2 * both[:, 0] * (both[:, 1] / both.sum(axis=1))  # κ itself where both sides agree
        scaled = (sigma * mesh.face_measures)[faces, None] * harmonic
        total += float((0.5 * weights * scaled * jump**2).sum())
    return total


def _traces(basis: Basis, x: Float, cells: Int, points: Float) -> Float:
    """Values ``(f, q)`` of the function in ``cells (f,)`` at ``points (f, q, 2)``."""
    flat = points.reshape(-1, 2) + basis.mesh.origin
    return basis.evaluate(x, np.repeat(cells, points.shape[1]), flat).reshape(points.shape[:2])
