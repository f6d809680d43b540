"""Finite-volume and truss matrices with extreme coefficients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import Delaunay

from agglo_core.mesh import Mesh


def two_point_flux(mesh: Mesh, kappa: np.ndarray, dirichlet: bool = True) -> sparse.csr_array:
    """Return the two-point flux matrix with harmonic means of kappa.

    The boundary condition is zero Dirichlet or zero flux.
    """
    inner = mesh.face_cells[:, 1] >= 0
    a, b = mesh.face_cells[inner].T
    distance = np.linalg.norm(mesh.cell_centroids[a] - mesh.cell_centroids[b], axis=1)
    t = mesh.face_measures[inner] / distance * 2.0 * kappa[a] * kappa[b] / (kappa[a] + kappa[b])
    own = mesh.face_cells[~inner, 0]
    out = 2.0 * mesh.face_measures[~inner] * kappa[own] / np.sqrt(mesh.cell_measures[own])
    n = mesh.n_cells
    diagonal = np.bincount(a, t, n) + np.bincount(b, t, n) + dirichlet * np.bincount(own, out, n)
    entries = np.concatenate((-t, -t, diagonal))
    at = (np.concatenate((a, b, np.arange(n))), np.concatenate((b, a, np.arange(n))))
    return sparse.csr_array(sparse.coo_array((entries, at), shape=(n, n)))


def upwind_flux(mesh: Mesh, peclet: float, velocity: Callable[[np.ndarray], np.ndarray]) -> sparse.csr_array:
    """Return the two-point flux matrix for −∇·(κ∇u) + ∇·(b u) with upwind values of u.

    Dirichlet data are zero. The mean cell size divided by κ is ``peclet``.
    """
    kappa = float(mesh.cell_measures.mean()) ** (1 / mesh.dim) / peclet
    flows = (velocity(mesh.face_centroids) * mesh.face_normals).sum(axis=1) * mesh.face_measures
    first, second = mesh.face_cells.T
    n, inner = mesh.n_cells, second >= 0
    out, into = np.maximum(flows, 0.0), np.minimum(flows, 0.0)
    rows = np.concatenate((first, first[inner], second[inner], second[inner]))
    columns = np.concatenate((first, second[inner], first[inner], second[inner]))
    entries = np.concatenate((out, into[inner], -out[inner], -into[inner]))
    diffusion = two_point_flux(mesh, np.full(n, kappa))
    return sparse.csr_array(diffusion + sparse.csr_array((entries, (rows, columns)), shape=(n, n)))


def two_valued(n: int, seed: int, share: float = 0.5) -> np.ndarray:
    """Return values of 1 or 1e6 at random."""
    return np.where(np.random.default_rng(seed).random(n) < share, 1e6, 1.0)


def truss(n: int, seed: int) -> tuple[sparse.csr_array, np.ndarray]:
    """Return the stiffness matrix of a free random 2-D truss, and its three rigid motions."""
    points = np.random.default_rng(seed).random((n, 2))
    # Bars: the edges of a Delaunay triangulation.
    corners = Delaunay(points).simplices
    bars = np.unique(np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
    along = points[bars[:, 1]] - points[bars[:, 0]]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    m = len(bars)
    # Elongation of each bar as a matrix G on the displacements.
    columns = np.stack((2 * bars[:, 0], 2 * bars[:, 0] + 1, 2 * bars[:, 1], 2 * bars[:, 1] + 1), axis=1)
    G = sparse.csr_array(
        (np.concatenate((-along, along), axis=1).ravel(), columns.ravel(), 4 * np.arange(m + 1)),
        shape=(m, 2 * n),
    )
    A = G.T @ sparse.diags_array(1.0 / length) @ G
    # Two translations and a rotation.
    x, y = points.T
    zero, one = np.zeros(n), np.ones(n)
    motions = (np.stack((one, zero), axis=1), np.stack((zero, one), axis=1), np.stack((-y, x), axis=1))
    return sparse.csr_array(A), np.stack([each.ravel() for each in motions], axis=1)


def five_points(n: int, x: float, y: float) -> sparse.csr_array:
    """Return the five-point matrix on n × n points, with a coefficient per direction."""
    line = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    one = sparse.eye_array(n)
    return sparse.csr_array(x * sparse.kron(one, line) + y * sparse.kron(line, one))


def nearly_incompressible(n: int, ratio: float) -> sparse.csr_array:
    """Return −Δu − ratio · ∇ div u for u with two components on n × n points, by differences."""
    line, one = sparse.diags_array([-1.0, 1.0], offsets=[-1, 0], shape=(n, n)), sparse.eye_array(n)
    divergence = sparse.hstack((sparse.kron(one, line), sparse.kron(line, one)))
    laplacian = five_points(n, 1.0, 1.0)
    A = sparse.csr_array(sparse.block_diag((laplacian, laplacian)) + ratio * divergence.T @ divergence)
    interleaved = np.arange(2 * n * n).reshape(2, -1).T.ravel()
    return sparse.csr_array(A[interleaved][:, interleaved])


def bilinear_elements(widths: np.ndarray, heights: np.ndarray) -> sparse.csr_array:
    """Return the Q1 matrix for −Δ with zero boundary values on a grid of columns and rows."""

    def line(steps: np.ndarray, own: np.ndarray, other: np.ndarray) -> sparse.dia_array:
        inner = (other[1:-1], own[:-1] + own[1:], other[1:-1])
        return sparse.diags_array(inner, offsets=[-1, 0, 1], shape=(len(steps) - 1,) * 2)

    (K, M), (L, N) = ((line(h, 1.0 / h, -1.0 / h), line(h, h / 3.0, h / 6.0)) for h in (widths, heights))
    return sparse.csr_array(sparse.kron(N, K) + sparse.kron(L, M))


def linear_elements(mesh: Mesh) -> tuple[sparse.csr_array, np.ndarray]:
    """Return the P1 matrix for −Δ with zero boundary values, and the indices of inner points."""
    corners = mesh.boundary_loops.vertices.reshape(-1, 3)
    # Element matrices from the edge vectors.
    at = mesh.points[corners]
    edge = np.roll(at, 1, axis=1) - np.roll(at, 2, axis=1)
    area = 0.5 * np.abs(edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])
    local = np.einsum("tid,tjd->tij", edge, edge) / (4.0 * area)[:, None, None]
    place = (np.repeat(corners, 3, axis=1).ravel(), np.tile(corners, (1, 3)).ravel())
    n = len(mesh.points)
    A = sparse.csr_array(sparse.coo_array((local.ravel(), place), shape=(n, n)))
    # Restrict to inner points.
    outer = mesh.face_cells[:, 1] < 0
    inner = np.setdiff1d(np.arange(n), mesh.face_vertices.reshape(-1, 2)[outer])
    return sparse.csr_array(A[inner][:, inner]), inner


def iterations(A: sparse.csr_array, M: LinearOperator, b: np.ndarray | None = None, tol: float = 1e-8) -> int:
    """Return the number of conjugate gradient iterations, which must converge up to a factor of 100."""
    b = np.ones(A.shape[0]) if b is None else b
    seen: list[int] = []
    x, failed = cg(A, b, rtol=tol, maxiter=300, M=M, callback=lambda _: seen.append(0))
    assert not failed
    assert np.linalg.norm(b - A @ x) <= 100 * tol * np.linalg.norm(b)
    return len(seen)
