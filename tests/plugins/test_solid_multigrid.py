"""The default solver in space: iterations, what it chooses, the continuous space on polyhedra."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Agglo
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

from agglo_core import Hierarchy, Mesh, agglomerate, samples
from agglo_core.problems import Diffusion
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.auxiliary.solid_space import solid_space
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.solver.numbering import numbering_for
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid
from agglo_polydg_mg.space.basis import Basis

Array = NDArray[np.float64]


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


@cache
def lumps() -> Mesh:
    fine = samples.tetrahedra(8)
    how: dict[str, Any] = {"bisector": "coordinate", "refiners": (), "polish": False}
    return fine.coarsen(agglomerate(fine, cells_per_part=8, **how).levels[0])


MESHES: dict[str, tuple[Callable[[], Mesh], str, tuple[int, int]]] = {
    "tetrahedra": (lambda: samples.tetrahedra(6), "continuous space", (10, 14)),
    "hexahedra": (lambda: samples.boxes(9), "continuous space", (10, 11)),
    "Voronoi": (lambda: samples.voronoi3d(500, seed=1), "smoothed agglomerates, cells", (14, 16)),
    "random tetrahedra": (
        lambda: samples.random_tetrahedra(150, seed=1),
        "smoothed agglomerates, patches",
        (9, 11),
    ),
    "agglomerates": (lumps, "smoothed agglomerates, cells", (14, 18)),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_iterations_are_few(name: str, degree: int) -> None:
    make, recipe, most = MESHES[name]
    mesh = make()
    solution = PolyDGMultigrid(degree).solve(Diffusion(source=8.0), bare(mesh))
    assert solution.converged
    assert solution.iterations <= most[degree - 1]
    assert recipe in solution.choice
    x = spsolve(solution.A.tocsc(), solution.b)
    assert np.abs(solution.x - x).max() < 1e-5 * np.abs(x).max()


@pytest.mark.parametrize("name", ["tetrahedra", "hexahedra"])
def test_jumps_of_the_coefficient_take_patches(name: str) -> None:
    mesh = MESHES[name][0]()
    kappa = np.where((mesh.cell_centroids * 3).astype(int).sum(axis=1) % 2, 1e6, 1.0)
    solution = PolyDGMultigrid(1, tolerance=1e-8).solve(Diffusion(kappa=kappa, source=8.0), bare(mesh))
    assert solution.converged
    assert solution.iterations <= 12
    assert "patches" in solution.choice
    x = spsolve(solution.A.tocsc(), solution.b)
    e = solution.x - x
    assert e @ (solution.A @ e) < 1e-12 * (x @ (solution.A @ x))


@pytest.mark.parametrize("recipe", ["conforming", "patches", "agglomerates"])
def test_every_recipe_preconditions_symmetrically(recipe: Any) -> None:
    mesh = samples.voronoi3d(120, seed=3)
    tool = PolyDGMultigrid(1, recipe=recipe)
    M = tool.aspreconditioner(Diffusion(), bare(mesh))
    x, y = np.random.default_rng(0).standard_normal((2, M.shape[0]))
    assert x @ (M @ y) == pytest.approx(y @ (M @ x), rel=1e-9)
    assert x @ (M @ x) > 0
    assert tool.solve(Diffusion(), bare(mesh)).converged


def test_given_levels_are_used() -> None:
    mesh = samples.tetrahedra(5)
    hierarchy = agglomerate(mesh, bisector="kmeans", cells_per_part=(8, 64))
    tool = PolyDGMultigrid(1, recipe="agglomerates")
    solution = tool.solve(Diffusion(), hierarchy)
    assert solution.converged
    assert [A.shape[0] for A, _ in solution.operators][:2] == [4 * 750, 4 * (hierarchy.levels[0].max() + 1)]


def test_scattered_numbers_do_not_show() -> None:
    mesh = samples.boxes(15)
    order = np.random.default_rng(1).permutation(mesh.n_cells)
    there = mesh.renumbered(order)
    assert numbering_for(bare(mesh)).cells is None
    assert numbering_for(bare(there)).cells is not None
    here = PolyDGMultigrid(1, tolerance=1e-9).solve(Diffusion(), bare(mesh)).x.reshape(-1, 4)
    found = PolyDGMultigrid(1, tolerance=1e-9).solve(Diffusion(), bare(there)).x.reshape(-1, 4)
    np.testing.assert_allclose(found, here[order], atol=1e-7 * np.abs(here).max())


def test_other_solvers_work_in_space() -> None:
    mesh = samples.boxes(4)
    energy = Direct(2).solve(Diffusion(source=8.0), bare(mesh))
    levels = agglomerate(mesh, bisector="kmeans", cells_per_part=(8,))
    paper = PaperMultigrid(2).solve(Diffusion(source=8.0), levels)
    assert paper.converged
    assert paper.b @ paper.x == pytest.approx(energy.b @ energy.x, rel=1e-5)


@pytest.mark.parametrize("degree", [1, 2])
def test_functions_of_the_continuous_space_are_continuous_on_tetrahedra(degree: int) -> None:
    """Degree 1: linear elements. Degree 2: nearly, fits are regularised."""
    mesh = samples.random_tetrahedra(10, seed=4)
    basis = Basis(mesh, degree, True)
    space = solid_space(basis)
    assert space.n_vertices == len(np.unique(mesh.face_vertices))
    P = space.prolongation()
    u = P @ np.random.default_rng(2).standard_normal(space.n)
    for f, (a, b) in enumerate(mesh.face_cells):
        if b >= 0:
            corners = mesh.points[mesh.face_vertices[3 * f : 3 * f + 3]]
            points = np.random.default_rng(f).dirichlet(np.ones(3), 6) @ corners
            left, right = (basis.evaluate(u, np.full(6, cell), points) for cell in (a, b))
            np.testing.assert_allclose(left, right, atol=(1e-9, 0.1)[degree - 1] * np.abs(u).max())


def test_linear_functions_are_in_the_continuous_space() -> None:
    for mesh in (samples.boxes(3), samples.tetrahedra(2), samples.voronoi3d(20, seed=5)):
        basis = Basis(mesh, 2, True)
        space = solid_space(basis, bubbles=False)
        numbers = np.full(mesh.n_points, -1)
        offsets, vertices = mesh.cell_vertices
        for c in range(mesh.n_cells):
            for v in vertices[offsets[c] : offsets[c + 1]]:
                if numbers[v] < 0:
                    numbers[v] = numbers.max() + 1
        values = np.empty(space.n)
        used = numbers >= 0
        values[numbers[used]] = mesh.points[used] @ (1.0, 2.0, -3.0)
        found = space.prolongation() @ values
        if (np.diff(mesh.face_offsets) <= 4).all():  # on other faces the mean of corners is no centre
            expected = basis.project(lambda x: x @ (1.0, 2.0, -3.0))
            np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["hexahedra", "Voronoi"])
def test_degree_one_fits_the_values_at_corners(name: str) -> None:
    mesh = MESHES[name][0]()
    basis = Basis(mesh, 1, True)
    space = solid_space(basis)
    P = space.prolongation()
    values = np.random.default_rng(1).standard_normal(space.n)
    offsets, vertices = mesh.cell_vertices
    for c in range(0, mesh.n_cells, 50):
        own = space.unknowns[offsets[c] : offsets[c + 1]]
        corners = mesh.points[vertices[offsets[c] : offsets[c + 1]]]
        found = basis.evaluate(P @ values, np.full(len(own), c), corners)
        centred = np.column_stack((np.ones(len(own)), corners - corners.mean(axis=0)))
        slopes = np.linalg.lstsq(centred, values[own], rcond=None)[0]
        np.testing.assert_allclose(found, centred @ slopes, atol=1e-9)


def test_products_of_the_continuous_space_are_galerkin() -> None:
    mesh = samples.tetrahedra(2)
    space = solid_space(Basis(mesh, 2, True))
    P = space.prolongation()
    A = PolyDGMultigrid(2).discretisation.assemble(Diffusion(), mesh).A
    expected = (P.T @ A @ P).toarray()
    np.testing.assert_allclose(space.galerkin(A).toarray(), expected, atol=1e-11 * np.abs(expected).max())


def test_meshes_in_space_are_solved(agglo: Agglo) -> None:
    """The same command, a file for ParaView; a picture there is none, and the rest is made."""
    asked = ("boxes:n=4", "--degree", "2", "--problem", "sine", "-o", "u.vtu", "--no-cg", "--json")
    done = agglo("solve", *asked)
    assert done.code == 0
    data = done.data
    assert data["converged"]
    assert data["dofs"] == 640
    assert data["error_l2"] < 0.01
    assert data["energy"] == pytest.approx(3 * np.pi**2 / 8, rel=0.03)
    assert Path("u.vtu").exists()
