"""Upwind form of convection b·∇u: the part of the matrix that is not symmetric.

Σ_K ∫ (b·∇u) v − Σ_K ∫ (b·n)(u − u⁻) v over the inflow boundary of each cell, with the value u⁻ of the
neighbour, or Dirichlet data g (F. Brezzi, L. D. Marini, E. Süli, M3AS 14, 2004).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Diffusion, Float, Int, Mesh, OptionError, frozen_float, frozen_int
from agglo_core.fields.boundary import BoundaryParts
from agglo_core.fields.coefficients import velocity
from agglo_core.fields.rules import batches, inside
from agglo_polydg_mg.forms.boundary import rule_of, sum_per_cell
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule
from agglo_polydg_mg.space.basis import Basis

_NUMBERS: Final = 4_000_000  # numbers in an array of products at quadrature points


def add_convection(basis: Basis, problem: Diffusion, boundary: BoundaryParts, blocks: Float) -> None:
    """Add the upwind form to the matrix ``blocks`` of :attr:`.Basis.pattern`."""
    b = velocity(basis.mesh, problem.convection)
    if b is None:
        return
    if len(boundary.floating):
        raise OptionError(
            f"the component of cell {boundary.floating[0]} has convection, but no boundary face with "
            "Dirichlet data, no reaction and no Robin data with positive alpha: give a Dirichlet value for "
            "one of its boundary tags"
        )
    _add_cells(basis, b, blocks)
    _add_faces(basis, b, boundary, blocks)


def inflow_load(basis: Basis, problem: Diffusion, boundary: BoundaryParts) -> Callable[[Float], Float] | None:
    """Return the map from Dirichlet data g ``(t, q)`` to −∫ (b·n) g v over the inflow ``(n_cells, n_local)``.

    None without convection.
    """
    mesh, b = basis.mesh, velocity(basis.mesh, problem.convection)
    if b is None:
        return None
    rule = rule_of(basis, boundary.dirichlet)
    owner = mesh.face_cells[rule.faces, 0]
    weights = rule.weights * np.maximum(-normal_speed(mesh, b, rule), 0.0)
    tests = basis.values(owner, rule.points)
    return lambda g: sum_per_cell(basis, owner, weights * g, tests)


def mean_speed(mesh: Mesh, convection: Any) -> Float | float:
    """Return |b| at the centroid of each cell ``(n_cells,)``, or 0 without convection."""
    b = velocity(mesh, convection)
    if b is None:
        return 0.0
    return frozen_float(np.linalg.norm(b(mesh.cell_centroids) if callable(b) else b, axis=1))


def face_flows(mesh: Mesh, convection: Any) -> Float:
    """Return |face| b·n at the centroid of each face ``(n_faces,)``, outward of the face's first cell."""
    b = velocity(mesh, convection)
    if b is None:
        return frozen_float(np.zeros(mesh.n_faces))
    if callable(b):
        values = b(mesh.face_centroids)
    else:
        owner, other = mesh.face_cells.T
        values = 0.5 * (b[owner] + b[np.where(other < 0, owner, other)])
    return frozen_float((values * mesh.face_normals).sum(axis=1) * mesh.face_measures)


def _add_cells(basis: Basis, b: Any, blocks: Float) -> None:
    """Add ∫ (b·∇φ_j) φ_i to the diagonal blocks."""
    mesh, m, places = basis.mesh, basis.n_local, basis.pattern[2]
    for batch in inside(mesh, 2 * basis.degree + 3):
        cells = batch.cells
        speed = b(batch.points + mesh.origin) if callable(b) else b[cells]
        ends = batch.offsets
        for first, last in batches(ends, _NUMBERS // m**2):
            part = slice(ends[first], ends[last])
            points, own = batch.points[part], cells[part]
            slopes = np.einsum("qd,qdk->qk", speed[part], basis.gradients(own, points))
            values = basis.values(own, points) * batch.weights[part, None]
            sums = np.add.reduceat(values[:, :, None] * slopes[:, None], ends[first:last] - ends[first])
            blocks[places[batch.first + first : batch.first + last]] += sums


def _add_faces(basis: Basis, b: Any, boundary: BoundaryParts, blocks: Float) -> None:
    """Add the jumps over inflow boundaries of cells, in batches of faces."""
    mesh, m = basis.mesh, basis.n_local
    inner = mesh.face_cells[:, 1] >= 0
    chosen = np.union1d(np.flatnonzero(inner), boundary.dirichlet)
    batch = max(1, _NUMBERS // (4 * m * (m + basis.degree + 2)))
    for first in range(0, len(chosen), batch):
        rule = face_rule(mesh, frozen_int(chosen[first : first + batch]), basis.degree + 2)
        speed, cells = normal_speed(mesh, b, rule), mesh.face_cells[rule.faces]
        beyond = cells[:, 1] >= 0
        traces = [basis.values(side, rule.points) for side in (cells[:, 0], np.maximum(cells[:, 1], 0))]
        # Side k is inside, 1 − k beyond its inflow boundary
        for k, strength in ((0, np.maximum(-speed, 0.0)), (1, np.maximum(speed, 0.0))):
            weights = rule.weights * strength
            if k == 1:
                weights = weights * beyond[:, None]
            own = np.einsum("tq,tqi,tqj->tij", weights, traces[k], traces[k], optimize=True)
            np.add.at(blocks, _places(basis, rule.faces, k, k), own)
            weights = weights[beyond]
            other = np.einsum(
                "tq,tqi,tqj->tij", weights, traces[k][beyond], traces[1 - k][beyond], optimize=True
            )
            np.add.at(blocks, _places(basis, frozen_int(rule.faces[beyond]), k, 1 - k), -other)


def _places(basis: Basis, faces: Int, row: int, column: int) -> Any:
    """Return block positions for owner (0) or neighbour (1) as row and column of each face."""
    slots = basis.pattern[3]
    if basis.mesh.dim == 2:
        return slots[faces, row, column]
    sides = basis.sides.of_faces[faces]
    turned = (basis.mesh.face_cells[faces, 0] != basis.sides.cells[sides, 0]).astype(int)
    return slots[sides, np.abs(row - turned), np.abs(column - turned)]


def normal_speed(mesh: Mesh, b: Any, rule: FaceRule) -> Float:
    """Return b·n ``(t, q)`` outward from the owners, with the mean of cell values on both sides."""
    if callable(b):
        values = b(rule.points.reshape(-1, mesh.dim) + mesh.origin).reshape(rule.points.shape)
        return np.asarray(np.einsum("tqd,td->tq", values, rule.normals))
    owner, other = mesh.face_cells[rule.faces].T
    mean = 0.5 * (b[owner] + b[np.where(other < 0, owner, other)])
    speed = (mean * rule.normals).sum(axis=1)
    return np.repeat(speed[:, None], rule.points.shape[1], axis=1)
