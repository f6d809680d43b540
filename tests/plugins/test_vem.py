"""Virtual elements: patch tests, orders, data of all kinds, condensation, and solvers of the core."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from polygon_meshes import PLANE, collapsing
from scipy import sparse
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Mesh, OptionError, samples
from agglo_core.problems import Diffusion
from agglo_core.problems.diffusion import sine
from agglo_vem.virtual_elements import VirtualElements

Array = NDArray[np.float64]


SOLID: dict[str, Callable[[], Mesh]] = {
    "boxes": lambda: samples.boxes(3),
    "tetrahedra": lambda: samples.random_tetrahedra(60, seed=3),
    "agglomerates": lambda: samples.boxes(4).coarsen(np.arange(64) // 4),
}
STABILISATIONS = ["dofi", "d-recipe"]


def solved(how: VirtualElements, problem: Diffusion, mesh: Mesh) -> Array:
    system = how.assemble(problem, mesh)
    return np.asarray(spsolve(sparse.csc_array(system.A), system.b))


def polynomial(degree: int, dim: int = 2) -> tuple[Any, Any, Any]:
    """Return a polynomial, its gradient and its Hessian matrix, as functions of points."""
    slope, bend = np.array([0.7, -0.4, 0.3])[:dim], np.array([0.5, 1.0, -0.2])[:dim]
    step = np.array([0.6, -0.8, 0.1])[:dim]

    def value(x: Array) -> Array:
        return 1.0 + x @ slope + (degree > 1) * (x @ bend) ** 2 + (degree > 2) * (x @ step) ** 3

    def gradient(x: Array) -> Array:
        square = 2.0 * (degree > 1) * (x @ bend)[:, None] * bend
        return slope + square + 3.0 * (degree > 2) * (x @ step)[:, None] ** 2 * step

    def hessian(x: Array) -> Array:
        square = 2.0 * (degree > 1) * np.outer(bend, bend)
        return square + 6.0 * (degree > 2) * (x @ step)[:, None, None] * np.outer(step, step)

    return value, gradient, hessian


KAPPA = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 1.5]])


def tagged(mesh: Mesh) -> Mesh:
    """Tag the boundary: 1 on faces at the right, 2 at the top, 0 elsewhere."""
    high, middle = mesh.points.max(axis=0) - 1e-9, mesh.face_centroids
    tags = np.where(middle[:, 0] > high[0], 1, np.where(middle[:, 1] > high[1], 2, 0))
    return mesh.with_face_tags(boundary=tags)


def patch_problem(mesh: Mesh, degree: int) -> Diffusion:
    """Problem with a polynomial solution: a tensor, a reaction, Dirichlet, Neumann and Robin data."""
    dim, tags = mesh.dim, mesh.face_tags["boundary"][mesh.outer_faces]
    u, slope, hessian = polynomial(degree, dim)
    kappa = KAPPA[:dim, :dim]
    neumann = {1: lambda x: slope(x) @ kappa[0]}
    robin = {2: (2.0, lambda x: 2.0 * u(x) + slope(x) @ kappa[1])}
    return Diffusion(
        kappa,
        lambda x: 3.0 * u(x) - (kappa * hessian(x)).sum(axis=(-2, -1)),
        dirichlet={0: u},
        neumann=neumann if (tags == 1).any() else {},
        robin=robin if (tags == 2).any() else {},
        reaction=3.0,
        exact=u,
    )


@pytest.mark.parametrize("stabilisation", STABILISATIONS)
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", PLANE)
def test_polynomials_of_the_degree_are_met(name: str, degree: int, stabilisation: str) -> None:
    mesh, how = tagged(PLANE[name](60)), VirtualElements(degree, stabilisation)
    problem = patch_problem(mesh, degree)
    x = solved(how, problem, mesh)
    errors = how.errors(problem, mesh, x)
    assert errors["l2"] < 1e-10
    assert errors["h1"] < 1e-9  # by differences of the exact solution
    assert np.abs(how.project(mesh, problem.exact) - x).max() < 1e-10


@pytest.mark.parametrize("stabilisation", STABILISATIONS)
@pytest.mark.parametrize("name", SOLID)
def test_linear_functions_are_met_on_polyhedra(name: str, stabilisation: str) -> None:
    mesh, how = tagged(SOLID[name]()), VirtualElements(1, stabilisation)
    problem = patch_problem(mesh, 1)
    assert how.errors(problem, mesh, solved(how, problem, mesh))["l2"] < 1e-10


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", ["voronoi", "random triangles", "agglomerates", "hexagons", "non-convex"])
def test_errors_have_orders_k_plus_1_and_k(name: str, degree: int) -> None:
    how, sizes, errors = VirtualElements(degree), [], []
    problem = Diffusion(lambda x: 1.0 + x[:, 0], _source, {0: _exact}, exact=_exact)
    for n in (64, 576):
        mesh = PLANE[name](n)
        sizes.append(mesh.n_cells**-0.5)
        errors.append(list(how.errors(problem, mesh, solved(how, problem, mesh)).values()))
    orders = np.log(np.divide(*errors)) / np.log(sizes[0] / sizes[1])
    assert orders[0] > degree + 0.75
    assert orders[1] > degree - 0.25


@pytest.mark.parametrize("name", ["voronoi", "tetrahedra", "agglomerates"])
def test_errors_have_orders_2_and_1_on_polyhedra(name: str) -> None:
    problem = Diffusion(2.0, lambda x: 4.0 * _bump(x), {0: _bump}, exact=_bump)
    how, sizes, errors = VirtualElements(), [], []
    for n in (4, 8):
        mesh = SOLIDS_BY_SIZE[name](n)
        sizes.append(mesh.n_cells ** (-1.0 / 3.0))
        errors.append(list(how.errors(problem, mesh, solved(how, problem, mesh)).values()))
    orders = np.log(np.divide(*errors)) / np.log(sizes[0] / sizes[1])
    assert orders[:2] == pytest.approx([2.0, 1.0], abs=0.1)


SOLIDS_BY_SIZE: dict[str, Callable[[int], Mesh]] = {
    "voronoi": lambda n: samples.voronoi3d(n**3, seed=1),
    "tetrahedra": samples.tetrahedra,
    "agglomerates": lambda n: (fine := samples.tetrahedra(3 * n // 2)).coarsen(
        agglo.agglomerate(fine, cells_per_part=8).levels[0]
    ),
}


def _bump(x: Array) -> Array:
    """Solution of −Δu = 2u."""
    return np.asarray(np.sin(x[:, 0]) * np.sin(x[:, 1] + 0.3) * (1.0 + x[:, 2]))


def _exact(x: Array) -> Array:
    return np.asarray(np.sin(2.0 * x[:, 0]) * np.exp(x[:, 1]))


def _source(x: Array) -> Array:
    return np.asarray(
        np.exp(x[:, 1]) * (3.0 * (1.0 + x[:, 0]) * np.sin(2.0 * x[:, 0]) - 2.0 * np.cos(2.0 * x[:, 0]))
    )


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_conditions_are_bounded_as_edges_collapse(degree: int) -> None:
    """A vertex moves towards the next vertex of its cell."""
    conditions = []
    for length in (1e-1, 1e-7):
        problem = Diffusion(reaction=1.0, neumann={0: 0.0})
        A = VirtualElements(degree).assemble(problem, collapsing(length)).A.toarray()
        scale = 1.0 / np.sqrt(A.diagonal())
        conditions.append(np.linalg.cond(scale[:, None] * A * scale))
    assert conditions[1] < 30.0 * conditions[0]


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_solvers_condense_unknowns_inside_cells(degree: int) -> None:
    mesh, how = samples.voronoi(60, seed=1), VirtualElements(degree)
    solution = agglo.solve(mesh, sine(), "direct", discretisation=how)
    assert np.abs(solution.x - solved(how, sine(), mesh)).max() < 1e-12
    inside = degree * (degree - 1) // 2 * mesh.n_cells
    assert solution.A.shape[0] - solution.operators[0][0].shape[0] == inside


def test_direct_takes_names_options_and_objects() -> None:
    mesh, how = samples.voronoi(30, seed=1), VirtualElements(2, "d-recipe")
    by_object = agglo.solve(mesh, sine(), "direct", discretisation=how)
    named = agglo.solve(
        mesh, sine(), "direct", degree=2, discretisation=("vem", {"stabilisation": "d-recipe"})
    )
    assert np.array_equal(by_object.x, named.x)
    with pytest.raises(OptionError, match="penalty belongs to the discretisation polydg"):
        agglo.solve(mesh, sine(), "direct", discretisation="vem", penalty=3.0)


def test_time_steps_keep_dirichlet_values() -> None:
    """The mode sin πx sin πy decays by exp(−2π² t); u − 1 has the boundary value 0."""
    mesh, how = samples.squares(12), VirtualElements(2)
    problem = Diffusion(source=0.0, dirichlet={0: 1.0})
    start = lambda x: 1.0 + np.sin(np.pi * x).prod(axis=1)  # noqa: E731
    steps = agglo.evolve(mesh, problem, start, 0.05, 0.001, "be", solver="direct", discretisation=how)
    _, last = list(steps)[-1]
    assert np.abs(last.x[how.fixed_unknowns(problem, mesh)] - 1.0).max() < 1e-12
    assert np.abs(last.b - last.A @ last.x).max() < 1e-10
    assert abs(last.evaluate(np.array([[0.5, 0.5]]))[0] - 1.0 - np.exp(-0.1 * np.pi**2)) < 5e-3


@pytest.mark.parametrize("solver", ["direct", "polydg_mg"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_neumann_data_alone_give_the_solution_with_mean_zero(degree: int, solver: str) -> None:
    """On two unit squares, the other with Dirichlet data, and with κ as a tensor."""
    u, slope, hessian = polynomial(degree)
    mesh, kappa = samples.disconnected(4), KAPPA[:2, :2]
    left = mesh.cell_centroids[:, 0] < mesh.cell_centroids[:, 0].mean()
    mesh = mesh.with_face_tags(boundary=np.where(left[mesh.face_cells[:, 0]], 1, 2))
    centre = mesh.cell_centroids[left].mean(axis=0)

    def flux(x: Array) -> Array:
        normals = np.where(np.abs(x - centre) > 0.5 - 1e-9, np.sign(x - centre), 0.0)
        return np.asarray((slope(x) @ kappa * normals).sum(axis=1))

    problem = Diffusion(
        kappa, lambda x: -(kappa * hessian(x)).sum(axis=(-2, -1)), dirichlet={2: u}, neumann={1: flux}
    )
    solution = agglo.solve(mesh, problem, solver, discretisation="vem", degree=degree, tolerance=1e-10)
    assert solution.converged
    how = VirtualElements(degree)
    assert abs(how.integrals(mesh, solution.x)[left].sum()) < 1e-9
    gaps = solution.evaluate(mesh.cell_centroids) - u(mesh.cell_centroids)
    assert np.ptp(gaps[left]) < 1e-7
    assert np.abs(gaps[~left]).max() < 1e-7
    assert np.abs(solution.b - solution.A @ solution.x).max() < 1e-7


def test_components_that_touch_in_a_vertex_share_their_constant() -> None:
    points = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (2, 1), (2, 2), (1, 2)], float)
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [2, 4, 5, 6]])
    problem = Diffusion(source=0.0, neumann={0: lambda x: np.where(x.sum(axis=1) < 2.0, -1.0, 1.0)})
    x = agglo.solve(mesh, problem, "direct", discretisation="vem").x
    assert abs(VirtualElements().integrals(mesh, x).sum()) < 1e-12
    assert np.ptp(x) > 0.5


def test_problems_without_a_unique_solution_are_refused() -> None:
    mesh = samples.squares(3)
    for problem, words in (
        (Diffusion(source=1.0, neumann={0: 0.5}), "they integrate to 3, their magnitudes to 3"),
        (Diffusion(convection=[1.0, 0.0]), "convection"),
        (Diffusion(kappa=-1.0), "positive"),
        (Diffusion(robin={0: (-1.0, 0.0)}), "negative"),
        (Diffusion(exact=lambda x: x[:, 0]), "exact contradicts"),
    ):
        with pytest.raises(OptionError, match=words):
            VirtualElements().assemble(problem, mesh)
    with pytest.raises(OptionError, match="degree 1"):
        VirtualElements(2).check(sine(), samples.boxes(2))


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", ["voronoi", "random triangles", "agglomerates"])
def test_multigrid_takes_at_most_20_iterations(name: str, degree: int) -> None:
    mesh = PLANE[name](300)
    solution = agglo.solve(mesh, sine(), discretisation="vem", degree=degree)
    assert solution.converged
    assert solution.iterations <= 20
    exact = solved(VirtualElements(degree), sine(), mesh)
    assert np.abs(solution.x - exact).max() < 1e-5
    assert np.linalg.norm(solution.b - solution.A @ solution.x) < 1e-5 * np.linalg.norm(solution.b)


def test_multigrid_refuses_what_belongs_to_polydg() -> None:
    mesh = samples.squares(6)
    with pytest.raises(OptionError, match="repeated solves require the discretisation polydg"):
        agglo.registry.default().build("solver", "polydg_mg", discretisation="vem").repeated(
            agglo.agglomerate(mesh, n_parts=4)
        )
    for solver in ("polydg_mg", "direct"):
        tool = agglo.registry.default().build("solver", solver, discretisation="vem", degree=2)
        with pytest.raises(OptionError, match="unknowns inside cells"):
            tool.aspreconditioner(sine(), agglo.agglomerate(mesh, n_parts=4))
    with pytest.raises(OptionError, match="recipe 'patches' requires"):
        agglo.solve(mesh, sine(), discretisation="vem", recipe="patches")


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_prolongation_keeps_polynomials_and_unknowns_between_agglomerates(degree: int) -> None:
    mesh, how = samples.voronoi(60, seed=2), VirtualElements(degree)
    labels = agglo.agglomerate(mesh.graph, n_parts=9).levels[0]
    coarse, u = mesh.coarsen(labels), polynomial(degree)[0]
    P = how.prolongation(mesh, labels)
    assert np.abs(P @ how.project(coarse, u) - how.project(mesh, u)).max() < 1e-10
    outer = how.fixed_unknowns(sine(), mesh)
    x = np.random.default_rng(0).normal(size=P.shape[1])
    assert np.array_equal(np.sort((P @ x)[outer]), np.sort(x[how.fixed_unknowns(sine(), coarse)]))


def test_prolongation_on_polyhedra_keeps_linear_functions() -> None:
    mesh, u, how = samples.boxes(4), polynomial(1, 3)[0], VirtualElements()
    labels = np.arange(64) // 8
    error = how.prolongation(mesh, labels) @ how.project(mesh.coarsen(labels), u) - how.project(mesh, u)
    assert np.abs(error).max() < 1e-10
