"""The network that guides classical levels in flat cells, beside a slow twin, and what it is good for."""

from __future__ import annotations

import numpy as np
import pytest
from random_diffusion import graded

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space, directions
from agglo_polydg_mg.auxiliary.coupling_network import coupling_network
from agglo_polydg_mg.forms.penalty import face_penalty
from agglo_polydg_mg.solver.choose import choose
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid
from agglo_polydg_mg.space.basis import Basis

FRESH = (452602, 806487)


def network_on(mesh: Mesh, degree: int, kappa: np.ndarray) -> tuple[ConformingSpace, np.ndarray]:
    """The continuous space on a mesh, and its network."""
    space = conforming_space(Basis(mesh, degree, True), face_penalty(mesh, degree), kappa)
    return space, coupling_network(space, mesh, kappa).toarray()


def of_vertices_slowly(space: ConformingSpace, mesh: Mesh, kappa: np.ndarray) -> np.ndarray:
    """The part of vertices, face by face."""
    found = np.zeros((space.n, space.n))

    def join(i: int, j: int, weight: float) -> None:
        if weight > 0.0:
            difference = np.zeros(space.n)
            difference[i] += 1.0
            difference[j] -= 1.0
            found[:] += weight * np.outer(difference, difference)

    for f, (a, b) in enumerate(mesh.face_pairs):
        for side, c in enumerate(mesh.face_cells[f]):
            if c < 0:
                continue
            own = mesh.cell_faces[1][mesh.cell_faces[0][c] : mesh.cell_faces[0][c + 1]]
            weight = 2.0 * mesh.cell_measures[c] / (len(own) * mesh.face_measures[f] ** 2)
            if len(own) == 3:
                opposite = np.setdiff1d(mesh.face_pairs[own], (a, b))[0]
                u, v = mesh.points[[a, b]] - mesh.points[opposite]
                weight = 0.5 * (u @ v) / abs(u[0] * v[1] - u[1] * v[0])
            join(*space.ends[f, side], kappa[c] * weight)
        for k in range(2):
            if mesh.face_cells[f, 1] >= 0:
                join(*space.ends[f, :, k], 0.5 * space.jumps[f])
            else:
                found[space.ends[f, 0, k], space.ends[f, 0, k]] += 0.5 * space.jumps[f]
    return found[: space.n_vertices, : space.n_vertices]


def without_held(network: np.ndarray) -> np.ndarray:
    """No couplings of unknowns whose own cost is more than twice that of their couplings."""
    couplings = -(network - np.diag(network.diagonal())).sum(axis=1)
    held = network.diagonal() - couplings > 2.0 * couplings
    return np.where(held[:, None] | held, np.diag(network.diagonal()), network)


@pytest.mark.parametrize("seed", FRESH)
@pytest.mark.parametrize("degree", [1, 3])
def test_vertices_are_joined_along_faces(seed: int, degree: int) -> None:
    for mesh in (graded(6, 1e-3), samples.random_triangles(20, seed=seed), samples.voronoi(12, seed=seed)):
        kappa = 10.0 ** np.random.default_rng(seed).uniform(-2, 2, mesh.n_cells)
        space, network = network_on(mesh, degree, kappa)
        wanted = without_held(of_vertices_slowly(space, mesh, kappa))
        n = space.n_vertices
        assert np.allclose(network[:n, :n], wanted, rtol=1e-9, atol=1e-12 * wanted.max())
        assert np.abs(network[:n, n:]).max(initial=0.0) == 0.0
        assert np.array_equal(network, network.T)
        assert (network - np.diag(network.diagonal())).max() <= 0.0
        assert (network.sum(axis=1) >= -1e-9 * network.diagonal()).all()


def strip(n: int, flat: float) -> Mesh:
    """Cells of unit length, one above the other."""
    points = np.array([(x, flat * k) for k in range(n + 1) for x in (0.0, 1.0)])
    return Mesh.from_polygons(points, [[2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2] for k in range(n)])


def test_bubbles_of_a_chain_have_one_sign() -> None:
    """So that functions along it are the same on each of its faces."""
    mesh = strip(4, 1e-2)
    basis = Basis(mesh, 3, True)
    space = conforming_space(basis, face_penalty(mesh, 3), np.ones(4))
    x = np.zeros(space.n)
    long = np.flatnonzero(mesh.face_measures > 0.5)
    for k in (0, 1):
        x[:] = 0.0
        x[space.bubbles[long] + k] = 1.0
        u = basis.coefficients(space.prolongation() @ x)
        assert np.allclose(u, u[0], atol=1e-3 * np.abs(u).max())
        means = u @ basis.coefficients(basis.project(lambda at: np.ones(len(at))))[0]
        assert np.abs(means).max() < 1e-2 * np.linalg.norm(u, axis=1).max()  # orthogonal to constants
    assert (directions(mesh) @ (1.0, 0.618) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("ratio", [1e-3, 1e-6])
def test_as_few_iterations_on_finer_layers(degree: int, ratio: float) -> None:
    counts = []
    for n in (32, 64):
        mesh = graded(n, ratio)
        found = PolyDGMultigrid(degree).solve(
            Diffusion(source=8.0), Hierarchy(mesh, mesh.graph, [], [], nested=True)
        )
        assert found.converged
        counts.append(found.iterations)
    assert counts[1] <= 12
    assert counts[1] <= counts[0] + 3


def test_flat_cells_with_coefficients_that_jump() -> None:
    mesh = graded(32, 1e-6)
    kappa = 10.0 ** np.random.default_rng(31).uniform(-2, 2, mesh.n_cells)
    found = PolyDGMultigrid().solve(Diffusion(kappa, 8.0), Hierarchy(mesh, mesh.graph, [], [], nested=True))
    assert found.converged
    assert found.iterations <= 20


def test_layers_are_detected_by_the_cost_of_jumps() -> None:
    def layers(mesh: Mesh) -> bool:
        return choose(mesh, face_penalty(mesh, 1), np.ones(mesh.n_cells), 1).layers

    assert layers(graded(12, 1e-3))
    assert not layers(samples.squares(6))
    assert not layers(samples.triangles(6))
    assert not layers(samples.voronoi(60, seed=0))
