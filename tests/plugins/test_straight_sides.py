"""Sides of agglomerates that several edges make up: one side to the sharp penalty, and the same energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Diffusion, Mesh, samples
from agglo_core.registry import default
from agglo_polydg_mg.forms.sides import with_straight_sides

FINE = {
    "voronoi": samples.voronoi(300, seed=1),
    "squares": samples.squares(12),
    "triangles": samples.random_triangles(150, seed=2),
}


def coarse(name: str) -> Mesh:
    mesh = FINE[name]
    tags = {"boundary": np.where(mesh.face_cells[:, 1] < 0, 1 + (mesh.face_normals[:, 0] > 0.5), 0)}
    mesh = replace(mesh, face_tags=tags)
    return agglo.agglomerate(mesh, cells_per_part=6, seed=1).mesh(0)


def energy(mesh: Mesh, problem: Diffusion, degree: int) -> float:
    """u · b of the discrete solution."""
    system = default().build("discretisation", "polydg", degree=degree).assemble(problem, mesh)
    return float(np.linalg.solve(system.A.toarray(), system.b) @ system.b)


@pytest.mark.parametrize("name", FINE)
@pytest.mark.parametrize("degree", [1, 3])
def test_energies_do_not_depend_on_how_sides_are_divided(name: str, degree: int) -> None:
    mesh = coarse(name)
    simpler = mesh.simplified()
    assert simpler.n_faces < mesh.n_faces
    kappa = 10.0 ** np.random.default_rng(3).uniform(-2, 2, mesh.n_cells)
    for problem in (
        Diffusion(source=8.0),
        Diffusion(kappa=kappa, source=1.0, dirichlet={1: 0.0}, neumann={2: 3.0}),
        Diffusion(kappa=lambda x: 1.0 + x[:, 0] ** 2, dirichlet={1: lambda x: x[:, 1], 2: 2.0}),
    ):
        one, other = energy(mesh, problem, degree), energy(simpler, problem, degree)
        assert other == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("name", FINE)
def test_solutions_belong_to_the_mesh_that_was_given(name: str) -> None:
    mesh = coarse(name)
    solver = default().build("solver", "polydg_mg", degree=2)
    hierarchy = agglo.agglomerate(mesh, n_parts=5)
    exact = Diffusion(
        source=lambda x: -4.0 * np.ones(len(x)),
        dirichlet={1: lambda x: (x**2).sum(axis=1), 2: lambda x: (x**2).sum(axis=1)},
        exact=lambda x: (x**2).sum(axis=1),
    )
    every = replace(exact, dirichlet={1: exact.exact, 2: exact.exact})
    solution = solver.solve(every, hierarchy)
    assert solution.converged
    assert solver.discretisation.assemble(every, mesh).mesh is mesh
    assert solver.discretisation.errors(every, mesh, solution.x)["l2"] < 1e-6


def test_meshes_without_such_sides_stay_as_they_are() -> None:
    for mesh in (*FINE.values(), samples.hexagons(6), samples.ring(24), samples.disconnected(3)):
        assert with_straight_sides(mesh) is mesh
    solid = samples.boxes(2)
    assert with_straight_sides(solid) is solid


def test_edges_of_other_tags_or_neighbours_are_not_joined() -> None:
    """Two cells beside each other, the lower side of the first in two edges; and a third that hangs there."""
    points = [[0, 0], [1, 0], [2, 0], [2, 2], [0, 2], [4, 0], [4, 2]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3, 4], [2, 5, 6, 3]])
    assert with_straight_sides(mesh).n_faces == mesh.n_faces - 1
    tagged = replace(mesh, face_tags={"boundary": np.arange(mesh.n_faces)})
    assert with_straight_sides(tagged) is tagged
    below = Mesh.from_polygons([*points, [1, -1], [0, -1]], [[0, 1, 2, 3, 4], [2, 5, 6, 3], [8, 7, 1, 0]])
    assert with_straight_sides(below) is below
