"""Solver that keeps the laws of solvers: two-point fluxes and preconditioned conjugate gradients."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, splu

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field, Linear, Problem, Solution


class TwoPointFlux:
    """Finite volume solver with one unknown per cell and two-point fluxes.

    The flux through a face is the difference between two cell values, divided by their distance. The system
    is solved by conjugate gradients with an additive two-level preconditioner: the diagonal, plus an exact
    solve on the first coarse level.

    Parameters
    ----------
    tolerance : float
        Residual tolerance relative to the right-hand side.
    most : int
        Maximum number of iterations.
    """

    def __init__(self, tolerance: float = 1e-10, most: int = 300) -> None:
        self.tolerance, self.most = tolerance, most

    def solve(self, problem: Problem, hierarchy: Hierarchy) -> Solution:
        """Solve a diffusion problem or a linear system, and return the solution with its residual history.

        ``converged`` compares the true residual with the tolerance.
        """
        start = time.perf_counter()
        A, b, cells = _system(problem, hierarchy)
        M, P, coarse = _preconditioner(A, cells, hierarchy)
        x, residuals = self._iterate(A, b, M)
        # Judge the true residual, not the residual updated in the iteration.
        true = float(np.linalg.norm(b - A @ x))
        residuals[-1] = true
        converged = true <= 10 * self.tolerance * float(np.linalg.norm(b))
        return Solution(
            x=frozen_float(x),
            A=A,
            b=b,
            operators=[(A, P), (coarse, None)],
            residuals=frozen_float(residuals),
            converged=bool(converged),
            reason="tolerance met"
            if converged
            else f"residual {true:.1e} after {len(residuals) - 1} iterations",
            iterations=len(residuals) - 1,
            seconds={"solve": time.perf_counter() - start},
        )

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """Return the symmetric two-level preconditioner for the matrix of a problem."""
        A, _, cells = _system(problem, hierarchy)
        return _preconditioner(A, cells, hierarchy)[0]

    def _iterate(self, A: Any, b: Float, M: LinearOperator) -> tuple[Float, list[float]]:
        # Preconditioned conjugate gradients from x = 0.
        x, r = np.zeros(len(b)), b.copy()
        residuals, p, rho = [float(np.linalg.norm(r))], np.zeros(len(b)), 1.0
        least = self.tolerance * residuals[0]
        while residuals[-1] > least and len(residuals) <= self.most:
            z = M @ r
            # Search direction p, made A-conjugate to the previous direction.
            rho, before = float(r @ z), rho
            p = z + (rho / before if len(residuals) > 1 else 0.0) * p
            # Exact line search along p; stop at a breakdown.
            curvature = float(p @ (A @ p))
            if not (rho and curvature and np.isfinite(rho / curvature)):
                break
            step = rho / curvature
            x, r = x + step * p, r - step * (A @ p)
            residuals.append(float(np.linalg.norm(r)))
        return x, residuals


def _system(problem: Problem, hierarchy: Hierarchy) -> tuple[Any, Float, Int]:
    """Return matrix, right-hand side, and the cell index of each unknown."""
    if isinstance(problem, Linear):
        sizes = np.diff(problem.block_offsets)
        return sparse.csr_array(problem.A), problem.b, np.repeat(np.arange(len(sizes)), sizes)
    if not isinstance(problem, Diffusion):
        raise OptionError(f"expected a Diffusion or Linear problem, given {type(problem).__name__}")
    if hierarchy.fine is None:
        raise ValueError("diffusion needs a mesh, but this hierarchy belongs to a graph without a mesh")
    if callable(problem.convection) or np.any(problem.convection):
        raise OptionError("the problem has convection, but this solver requires a symmetric matrix")
    A, b = _fluxes(problem, hierarchy.fine)
    return A, b, np.arange(len(b))


def _fluxes(problem: Diffusion, mesh: Mesh) -> tuple[Any, Float]:
    # Cell values of coefficient and source.
    kappa, of_cells = _tensors(problem.kappa, mesh), (problem.source, problem.reaction)
    source, reaction = (_sample(field, mesh.cell_centroids) for field in of_cells)
    # Resistance between face centre and cell centre, for both sides of each face.
    first = np.add.reduceat(mesh.local_points[mesh.face_vertices], mesh.face_offsets[:-1], axis=0)
    middle = first / np.diff(mesh.face_offsets)[:, None]
    resistances = [
        np.abs(((middle - mesh.local_centroids[c]) * mesh.face_normals).sum(axis=1))
        / np.einsum("fi,fij,fj->f", mesh.face_normals, kappa[c], mesh.face_normals)
        for c in mesh.face_cells.T
    ]
    # Transmissibility of inner faces: resistances in series.
    owner, neighbour = mesh.face_cells.T
    inner = neighbour >= 0
    links = mesh.face_measures[inner] / (resistances[0] + resistances[1])[inner]
    edge, n = ~inner, mesh.n_cells
    A = sparse.coo_array((links, (owner[inner], neighbour[inner])), shape=(n, n)).tocsr()
    A = A + A.T
    # Dirichlet faces act as links to a known value, Neumann faces add their flux.
    walls, b = mesh.cell_measures * reaction, mesh.cell_measures * source
    values, natural = _boundary(problem, mesh, mesh.origin + middle)
    dirichlet = edge & np.isfinite(values)
    weight = mesh.face_measures[dirichlet] / resistances[0][dirichlet]
    walls += np.bincount(owner[dirichlet], weight, n)
    b = b + np.bincount(owner[dirichlet], weight * values[dirichlet], n)
    b = b + np.bincount(owner[edge], (mesh.face_measures * natural)[edge], n)
    # Robin faces: α in series with the cell resistance.
    tags = mesh.face_tags.get(problem.boundary, np.zeros(mesh.n_faces, np.int64))
    for tag, (alpha, g) in problem.robin.items():
        faces = np.flatnonzero(edge & (tags == tag))
        alphas, data = (_sample(field, (mesh.origin + middle)[faces]) for field in (alpha, g))
        weight = mesh.face_measures[faces] / (1.0 + alphas * resistances[0][faces])
        walls += np.bincount(owner[faces], weight * alphas, n)
        b = b + np.bincount(owner[faces], weight * data, n)
    return sparse.csr_array(sparse.diags_array(A.sum(axis=1) + walls) - A), frozen_float(b)


def _boundary(problem: Diffusion, mesh: Mesh, middle: Float) -> tuple[Float, Float]:
    """Return Dirichlet values per face (NaN elsewhere) and Neumann fluxes per face (0 elsewhere)."""
    tags = mesh.face_tags.get(problem.boundary, np.zeros(mesh.n_faces, np.int64))
    values = np.full(mesh.n_faces, np.nan if problem.dirichlet or problem.robin else 0.0)
    natural = np.zeros(mesh.n_faces)
    for target, data in ((values, problem.dirichlet), (natural, problem.neumann)):
        for tag, field in data.items():
            target[tags == tag] = _sample(field, middle[tags == tag])
    return values, natural


def _tensors(kappa: Any, mesh: Mesh) -> Float:
    """Return the coefficient of each cell as a tensor ``(n_cells, d, d)``."""
    values = np.asarray(kappa(mesh.cell_centroids) if callable(kappa) else kappa, float)
    tensors = values if values.ndim >= 2 else np.multiply.outer(values, np.eye(mesh.dim))
    return frozen_float(np.broadcast_to(tensors, (mesh.n_cells, mesh.dim, mesh.dim)))


def _sample(field: Field, points: Float) -> Float:
    values = field(points) if callable(field) else field
    return np.broadcast_to(np.asarray(values, dtype=float), (len(points),))


def _preconditioner(A: Any, cells: Int, hierarchy: Hierarchy) -> tuple[LinearOperator, Any, Any]:
    """Return the preconditioner D⁻¹ + P (Pᵀ A P)⁻¹ Pᵀ, and the matrices P and Pᵀ A P.

    P is constant on agglomerates, for each unknown of a cell.
    """
    # Column of each unknown: agglomerate times width, plus the position in its cell.
    inject = hierarchy.prolongation(0)
    local = np.arange(len(cells)) - np.searchsorted(cells, cells)
    width = int(local.max()) + 1
    shape = (len(cells), inject.shape[1] * width)
    columns = hierarchy.levels[0][cells] * width + local
    P = sparse.csr_array((np.ones(len(cells)), (np.arange(len(cells)), columns)), shape=shape)
    # A small shift keeps the factorisation regular for singular problems.
    coarse = sparse.csc_array(P.T @ A @ P)
    diagonal = A.diagonal()
    shifted = coarse + sparse.diags_array(np.full(shape[1], 1e-12 * diagonal.max()))
    solve = splu(sparse.csc_array(shifted)).solve

    def apply(r: Float) -> Float:
        return np.asarray(r / diagonal + P @ solve(P.T @ r))

    return LinearOperator(A.shape, matvec=apply, rmatvec=apply, dtype=np.float64), P, coarse
