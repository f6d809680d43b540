"""Points of faces in place of bubbles: their functions, the network between them, what they are good for."""

from __future__ import annotations

import numpy as np
import pytest
from random_diffusion import graded

from agglo_core import Hierarchy, Mesh, agglomerate, samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.auxiliary.conforming_space import ConformingSpace, conforming_space
from agglo_polydg_mg.auxiliary.nodal_traces import nodal_basis, nodal_network, on_nodes
from agglo_polydg_mg.forms.penalty import face_penalty
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid
from agglo_polydg_mg.space.basis import Basis

FRESH = (318204, 91177)
INNER = {2: [0.5], 3: [0.5 - 0.05**0.5, 0.5 + 0.05**0.5]}
"""Gauss–Lobatto points inside of 0..1."""


def space_on(mesh: Mesh, degree: int, *, natural: bool = False) -> ConformingSpace:
    outer = np.flatnonzero(mesh.face_cells[:, 1] < 0)
    sigma = face_penalty(mesh, degree, natural=outer if natural else None)
    return conforming_space(Basis(mesh, degree, True), sigma, np.ones(mesh.n_cells), orthogonal=False)


def places(space: ConformingSpace, mesh: Mesh, degree: int) -> np.ndarray:
    """Where each unknown lies ``(n, 2)``."""
    found = np.empty((space.n, 2))
    for f, (a, b) in enumerate(mesh.points[mesh.face_pairs]):
        for side in range(1 + (mesh.face_cells[f, 1] >= 0)):
            found[space.ends[f, side]] = a, b
        for k, t in enumerate(INNER[degree]):
            found[space.bubbles[f] + k] = (1 - t) * a + t * b
    return found


def uneven(n: int, ratio: float, seed: int, *, cut: bool = False) -> Mesh:
    """A graded mesh whose vertices were moved before it was drawn together; triangles if ``cut``."""
    rng = np.random.default_rng(seed)
    even = samples.squares(n)
    points, cells = even.points.copy(), even.boundary_loops.vertices.reshape(-1, 4)
    inside = ((points > 1e-9) & (points < 1 - 1e-9)).all(axis=1)
    points[inside] += rng.uniform(-0.2, 0.2, (int(inside.sum()), 2)) / n
    points[:, 0] = np.expm1(np.log(ratio) * points[:, 0]) / np.expm1(np.log(ratio))
    if cut:
        falling = rng.random(len(cells)) < 0.5
        halves = [np.where(falling[:, None], cells[:, a], cells[:, b]) for a, b in _HALVES]
        cells = np.concatenate(halves)
    return Mesh.from_polygons(points, cells)


_HALVES = (([0, 1, 2], [0, 1, 3]), ([0, 2, 3], [1, 2, 3]))


@pytest.mark.parametrize("degree", [2, 3])
def test_values_at_points_make_the_polynomial(degree: int) -> None:
    mesh = samples.squares(4)
    basis, space = Basis(mesh, degree, True), space_on(mesh, degree)
    assert on_nodes(space, mesh).all()
    x, y = places(space, mesh, degree).T
    found = space.prolongation() @ (nodal_basis(space, mesh) @ (x**degree - 2 * x * y + 1))
    wanted = basis.project(lambda at: at[:, 0] ** degree - 2 * at[:, 0] * at[:, 1] + 1)
    assert np.allclose(found, wanted, atol=2e-3 * np.abs(wanted).max())


def test_faces_between_unlike_unknowns_keep_their_bubbles() -> None:
    mesh = graded(8, 1e-4)
    space = space_on(mesh, 3)
    kept, T = ~on_nodes(space, mesh), nodal_basis(space, mesh).toarray()
    assert 0 < kept.sum() < mesh.n_faces
    for k in (0, 1):
        own = space.bubbles[kept] + k
        assert np.array_equal(T[own], np.eye(space.n)[own])
    assert np.array_equal(T[: space.n_vertices], np.eye(space.n)[: space.n_vertices])


@pytest.mark.parametrize("seed", FRESH)
@pytest.mark.parametrize("degree", [2, 3])
def test_the_network_draws_together(seed: int, degree: int) -> None:
    for mesh in (uneven(5, 1e3, seed), uneven(5, 1e3, seed, cut=True), samples.voronoi(12, seed=seed)):
        kappa = 10.0 ** np.random.default_rng(seed).uniform(-2, 2, mesh.n_cells)
        network = nodal_network(space_on(mesh, degree), mesh, kappa).toarray()
        assert np.array_equal(network, network.T)
        assert (network - np.diag(network.diagonal())).max() <= 0.0
        assert (network.sum(axis=1) >= -1e-9 * network.diagonal()).all()


@pytest.mark.parametrize("degree", [2, 3])
def test_the_network_has_the_energy_of_linear_functions(degree: int) -> None:
    """In both directions: the integral of a slope of 1 over the unit square."""
    mesh = samples.triangles(8)
    space = space_on(mesh, degree, natural=True)
    couplings = nodal_network(space, mesh, np.ones(mesh.n_cells)).tocoo()
    for u in places(space, mesh, degree).T:
        steps = u[couplings.row] - u[couplings.col]
        energy = -0.5 * (couplings.data * steps**2).sum()
        assert energy == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("seed", FRESH)
@pytest.mark.parametrize(("cut", "degree", "most"), [(True, 2, 30), (True, 3, 20), (False, 2, 26)])
def test_uneven_layers(seed: int, cut: bool, degree: int, most: int) -> None:
    mesh = uneven(22 if cut else 32, 1e6, seed, cut=cut)
    found = PolyDGMultigrid(degree).solve(
        Diffusion(source=8.0), Hierarchy(mesh, mesh.graph, [], [], nested=True)
    )
    assert found.converged
    assert found.iterations <= most


def test_layers_cut_in_triangles_take_no_more_iterations_on_finer_meshes() -> None:
    counts = []
    for n in (16, 32):
        square = graded(n, 1e-6)
        corners = square.boundary_loops.vertices.reshape(-1, 4)
        mesh = Mesh.from_polygons(
            square.points, np.concatenate((corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]))
        )
        found = PolyDGMultigrid(2).solve(
            Diffusion(source=8.0), Hierarchy(mesh, mesh.graph, [], [], nested=True)
        )
        counts.append(found.iterations)
    assert counts[1] <= min(16, counts[0] + 3)


@pytest.mark.parametrize("degree", [1, 2])
def test_given_agglomerates_take_as_few_iterations_on_layers(degree: int) -> None:
    mesh = graded(40, 1e-6)
    bare, given = Hierarchy(mesh, mesh.graph, [], [], nested=True), agglomerate(mesh, cells_per_part=[2, 16])
    counts = [PolyDGMultigrid(degree).solve(Diffusion(source=8.0), h).iterations for h in (bare, given)]
    assert counts[1] <= 1.3 * counts[0]
