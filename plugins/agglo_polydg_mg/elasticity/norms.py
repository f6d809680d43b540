"""Energy norm of vector functions, and norms of their errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from agglo_core.authoring import Elasticity, Float, Int, Mask, OptionError, frozen_float, frozen_int
from agglo_core.fields.errors import exact_gradient
from agglo_core.fields.rules import inside
from agglo_core.fields.values import sample
from agglo_polydg_mg.elasticity.forms import cell_blocks
from agglo_polydg_mg.elasticity.loads import elastic_boundary, vector_data
from agglo_polydg_mg.elasticity.material import Material, along, face_weights
from agglo_polydg_mg.elasticity.vectors import components, split
from agglo_polydg_mg.forms.face_quadrature import FaceRule, face_rule
from agglo_polydg_mg.forms.norms import shares_of_faces
from agglo_polydg_mg.space.basis import Basis

_FACES = 20_000  # per batch: limits the memory for the traces at their quadrature points


@dataclass(frozen=True, eq=False)
class ElasticNorm:
    """The energy norm of a discrete displacement, with its jumps to the boundary data.

    (∫ σ(u) : ε(u) + c |u|² + Σ_F σ_F ∫ [u]·Γ[u])^½, a sum of squares, hence exact to rounding.
    """

    basis: Basis
    problem: Elasticity
    material: Material
    sigma: Float

    def __call__(self, x: Float) -> float:
        """Return the norm of the function with coefficients ``x (n,)``."""
        u = np.reshape(x, (self.basis.mesh.n_cells, -1))
        energy = float(np.einsum("ci,cij,cj->", u, self._blocks, u, optimize=True))
        return float(np.sqrt(energy + jumps(self.basis, x, self._outside, self.material, self.sigma)))

    @cached_property
    def _blocks(self) -> Float:
        return cell_blocks(self.basis, self.material, self.problem.reactions(self.basis.mesh.n_cells))

    def _outside(self, rule: FaceRule) -> Float:
        boundary = elastic_boundary(self.basis.mesh, self.problem)
        return vector_data(self.basis.mesh, boundary, self.problem.displacement, rule, "displacement")


def jumps(basis: Basis, x: Float, outside: object, material: Material, sigma: Float) -> float:
    """Return Σ_F σ_F ∫ [u]·Γ[u] over inner faces and faces with displacements.

    ``outside`` returns the outer values ``(t, q, d)`` on the boundary pieces of a face rule.
    """
    mesh, total, u = basis.mesh, 0.0, split(basis, x)
    penalised = np.flatnonzero(sigma > 0.0)
    for first in range(0, len(penalised), _FACES):
        faces = frozen_int(penalised[first : first + _FACES])
        rule = face_rule(mesh, faces, basis.degree + 4)
        sides = mesh.face_cells[rule.faces]
        inner = sides[:, 1] >= 0
        jump = traces(basis, u, frozen_int(sides[:, 0]), rule.points)
        jump[inner] -= traces(basis, u, frozen_int(sides[inner, 1]), rule.points[inner])
        jump[~inner] -= outside(rule.part(~inner))  # type: ignore[operator]
        mean = face_weights(mesh, material, frozen_int(rule.faces)).mean
        stiff = along(sigma[rule.faces, None] * mean, rule.normals)
        total += float(np.einsum("tq,tqa,tab,tqb->", rule.weights, jump, stiff, jump, optimize=True))
    return total


def traces(basis: Basis, u: Float, cells: Int, points: Float) -> Float:
    """Evaluate the function ``u (n_cells, d, n_local)`` in ``cells (t,)`` at ``points (t, q, d)``."""
    return np.asarray(basis.values(cells, points) @ u[cells].transpose(0, 2, 1))


def elastic_errors(
    basis: Basis,
    x: Float,
    problem: Elasticity,
    material: Material,
    sigma: Float,
    chosen: Mask | None = None,
) -> tuple[float, float]:
    """Compute the L2 and energy norms of the error of a displacement against ``problem.exact``.

    The exact gradient comes from central differences. On ``chosen (n_cells,)`` cells only, each cell
    contributes half of its inner faces.

    Raises
    ------
    OptionError
        If the problem has no exact solution.
    """
    if problem.exact is None:
        raise OptionError("this problem has no exact solution to compare with")
    mesh, u = basis.mesh, split(basis, x)
    exact = components(problem.exact, mesh, "exact")
    l2 = energy = 0.0
    # 1. Integrals over the cells, in batches
    for batch in inside(mesh, 2 * basis.degree + 6):
        cells, points = batch.cells, batch.points + mesh.origin
        weights = batch.weights if chosen is None else batch.weights * chosen[cells]
        values, slope = basis.evaluate(u, cells, points), -basis.gradient(u, cells, points)
        for axis, component in enumerate(exact):
            assert callable(component)
            l2 += float(weights @ (sample(component, points, "exact") - values[:, axis]) ** 2)
            slope[:, axis] += exact_gradient(mesh, component, batch)
        strain = 0.5 * (slope + slope.transpose(0, 2, 1))
        density = 2.0 * material.mu[cells] * (strain**2).sum(axis=(1, 2))
        density += material.lame[cells] * np.trace(strain, axis1=1, axis2=2) ** 2
        energy += float(weights @ density)

    # 2. Jumps on faces
    def outside(rule: FaceRule) -> Float:
        points = rule.points.reshape(-1, mesh.dim) + mesh.origin
        values = [sample(each, points, "exact") for each in exact if callable(each)]
        return frozen_float(np.stack(values, axis=1).reshape(rule.points.shape))

    counted = sigma if chosen is None else frozen_float(sigma * shares_of_faces(mesh, chosen))
    energy += jumps(basis, x, outside, material, counted)
    return float(np.sqrt(l2)), float(np.sqrt(energy))
