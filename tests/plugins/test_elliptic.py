"""Elliptic problems beyond diffusion with Dirichlet data: reaction, Robin data, Neumann data alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import AggloError, Mesh, OptionError, agglomerate, samples
from agglo_core.fields.rules import inside
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.face_quadrature import face_rule
from agglo_polydg_mg.forms.norms import Errors, errors
from agglo_polydg_mg.polydg import PolyDG

Array = NDArray[np.float64]


def agglomerated(parts: int) -> Mesh:
    """Voronoi cells, eight to a part."""
    mesh = samples.voronoi(8 * parts, seed=3)
    return mesh.coarsen(agglomerate(mesh.graph, n_parts=parts).levels[0])


MESHES: dict[str, Callable[[], Mesh]] = {
    "voronoi": lambda: samples.voronoi(40, seed=1),
    "random triangles": lambda: samples.random_triangles(40, seed=2),
    "agglomerates": lambda: agglomerated(12),
    "tetrahedra": lambda: samples.random_tetrahedra(20, seed=3),
}


def solved(how: PolyDG, problem: Diffusion, mesh: Mesh) -> Array:
    system = how.assemble(problem, mesh)
    return np.asarray(spsolve(sparse.csc_array(system.A), system.b))


def errors_of(how: PolyDG, problem: Diffusion, mesh: Mesh) -> Errors:
    return errors(how.basis(mesh), solved(how, problem, mesh), problem, penalty=how.penalty)


# --- Reaction


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_reaction_adds_the_weighted_mass_matrix(name: str, degree: int) -> None:
    """Products of polynomials, by quadrature inside the cells."""
    mesh, how = MESHES[name](), PolyDG(degree)
    basis, rng = how.basis(mesh), np.random.default_rng(0)
    cells = rng.uniform(0.0, 3.0, mesh.n_cells)

    def bump(x: Array) -> Array:
        return np.asarray(1.0 + x[:, 0] ** 2)

    x, y = rng.standard_normal((2, basis.n))
    for reaction in (2.0, cells, bump):
        plain, more = (how.assemble(Diffusion(reaction=c), mesh).A for c in (0.0, reaction))
        expected = 0.0
        for batch in inside(mesh, 2 * degree + 4):
            points = batch.points + mesh.origin
            values = reaction(points) if callable(reaction) else np.broadcast_to(reaction, mesh.n_cells)
            weights = batch.weights * (values if callable(reaction) else values[batch.cells])
            u, v = (basis.evaluate(each, batch.cells, points) for each in (x, y))
            expected += weights @ (u * v)
        size = abs(x) @ (abs(more) @ abs(y))
        assert y @ ((more - plain) @ x) == pytest.approx(expected, abs=1e-13 * size)


def wave(x: Array) -> Array:
    return np.asarray(np.sin(2.0 * x[:, 0] + 0.3) * np.cos(3.0 * x[:, 1]))


def coefficient(x: Array) -> Array:
    return np.asarray(5.0 + 4.0 * np.sin(3.0 * x[:, 0] + x[:, 1]))


REACTING = Diffusion(
    source=lambda x: (13.0 + coefficient(x)) * wave(x),
    dirichlet={0: wave},
    exact=wave,
    reaction=coefficient,
)


@pytest.mark.parametrize("degree", [1, 2])
def test_orders_with_reaction(degree: int) -> None:
    found = [errors_of(PolyDG(degree), REACTING, samples.voronoi(n, seed=0)) for n in (100, 1600)]
    assert np.log2(found[0].l2 / found[1].l2) / 2 > degree + 0.75
    assert np.log2(found[0].dg / found[1].dg) / 2 > degree - 0.25


@pytest.mark.parametrize("solver", ["direct", "polydg_mg", "polydg_mg_paper", "polydg_cg"])
def test_insulated_domains_with_reaction_have_a_solution(solver: str) -> None:
    mesh = samples.voronoi(60, seed=2)
    problem = Diffusion(source=6.0, neumann={0: 0.0}, reaction=2.0)
    solution = agglo.solve(agglomerate(mesh, n_parts=(15, 4)), problem, solver=solver, tolerance=1e-10)
    assert solution.converged
    assert solution.x == pytest.approx(solution.discretisation.project(mesh, 3.0), abs=1e-8)


def test_reaction_in_one_cell_of_each_component_suffices() -> None:
    one, other = samples.squares(3), samples.squares(3)
    points = np.concatenate((one.points, other.points + np.array([2.0, 0.0])))
    cells = [each + shift for shift in (0, one.n_points) for each in one.cells]
    mesh = Mesh.from_polygons(points, cells)
    assert mesh.graph.components().max() == 1
    reaction = np.zeros(18)
    reaction[4] = 1.0
    problem = Diffusion(neumann={0: 0.0}, reaction=reaction)
    with pytest.raises(
        OptionError, match="the component of cell 9 has no boundary face with Dirichlet data, no r"
    ):
        PolyDG().assemble(problem, mesh)
    reaction[12] = 1.0
    solution = agglo.solve(mesh, problem, solver="direct", tolerance=1e-9)
    assert solution.converged
    basis = solution.discretisation.basis(mesh)
    integrals = (basis.project(1.0) * (basis.mass() @ solution.x)).reshape(18, -1).sum(axis=1)
    assert integrals[[4, 12]] == pytest.approx([1.0, 1.0])  # c u balances the source of each component


@pytest.mark.parametrize(
    ("reaction", "message"),
    [
        (-1.0, "reaction must not be negative: it is -1.0 in cell 0"),
        (np.where(np.arange(16) == 5, -2.0, 1.0), "reaction must not be negative: it is -2.0 in cell 5"),
        (lambda x: x[:, 0] - 0.5, r"reaction must not be negative: it is -0\.\d+ at \[0"),
        (np.nan, "reaction must be finite: it is nan"),
        (np.where(np.arange(16) == 5, np.inf, 1.0), "reaction must be finite: it is inf in cell 5"),
        (lambda x: np.where(x[:, 0] > 0.5, np.nan, 1.0), r"reaction must be finite: it is nan at \[0.[5-9]"),
        (lambda x: np.ones(3), r"reaction returned shape \(3,\) for \d+ points, expected \(\d+,\)"),
        (np.ones(3), "reaction has shape (3,): expected a number, (16,) values or a callable"),
        ("1", "reaction must be a number, an array with one value per cell, or a callable; given '1'"),
    ],
)
def test_bad_reactions_are_refused(reaction: Any, message: str) -> None:
    if "\\" not in message:
        message = re.escape(message)
    with pytest.raises(AggloError, match=message):
        PolyDG().assemble(Diffusion(reaction=reaction), samples.squares(4))


@pytest.mark.parametrize("degree", [1, 2])
def test_reaction_takes_no_more_iterations(degree: int) -> None:
    """And the solution is that of a direct solver, in the energy norm."""
    mesh = samples.voronoi(300, seed=0)
    levels = agglomerate(mesh, n_parts=(60, 10))
    counts = []
    for c in (0.0, 1.0, 1e2, 1e4, 1e8):
        problem = Diffusion(source=1.0, dirichlet={0: lambda x: 1.0 + x[:, 0]}, reaction=c)
        found = agglo.solve(levels, problem, degree=degree, tolerance=1e-8)
        exact = solved(PolyDG(degree), problem, mesh)
        e = found.x - exact
        assert found.converged
        assert np.sqrt(e @ found.A @ e) <= 1e-6 * np.sqrt(exact @ found.A @ exact)
        counts.append(found.iterations)
    assert max(counts) <= counts[0] + 1  # only without reaction the data 1 + x are measured as x


def test_coarse_operators_average_the_reaction() -> None:
    mesh, how = samples.squares(4), PolyDG(1, penalty=10.0)
    labels = np.arange(16) // 8
    c = np.arange(16.0)
    means = np.array([c[:8].mean(), c[8:].mean()])
    found = how.coarse_operator(Diffusion(reaction=c), mesh, labels)
    expected = how.assemble(Diffusion(reaction=means), mesh.coarsen(labels)).A
    assert abs(found - expected).max() <= 1e-12


def test_scattered_cells_keep_their_reaction() -> None:
    """The solver renumbers them."""
    plain = samples.squares(110)
    mesh = plain.renumbered(np.random.default_rng(0).permutation(plain.n_cells))
    reaction = np.where(mesh.cell_centroids[:, 0] < 0.5, 0.0, 1e4)
    found = agglo.solve(mesh, Diffusion(reaction=reaction), tolerance=1e-9)
    assert "renumbered" in found.choice
    assert abs(found.x - solved(PolyDG(1), Diffusion(reaction=reaction), mesh)).max() < 1e-8


def test_sizes_of_data_do_not_matter() -> None:
    mesh = samples.squares(4)
    plain = agglo.solve(mesh, Diffusion(source=1.0, reaction=3.0), solver="direct", tolerance=1e-9)
    huge = agglo.solve(mesh, Diffusion(source=1e200, reaction=3.0), solver="direct", tolerance=1e-9)
    assert 1e-200 * huge.x == pytest.approx(plain.x)


def test_material_tables_give_the_reaction(tmp_path: Any) -> None:
    plain = samples.squares(4)
    mesh = replace(plain, cell_tags={"material": (np.arange(16) > 7).astype(int)})
    path = tmp_path / "p.toml"
    path.write_text("[reaction.material]\n0 = 0\n1 = 4.5\n")
    problem = agglo.problems.read_problem(path, mesh)
    assert np.array_equal(problem.reaction, np.where(np.arange(16) > 7, 4.5, 0.0))
    path.write_text("reaction = -1\n")
    with pytest.raises(AggloError, match="reaction must not be negative, given -1"):
        agglo.problems.read_problem(path, mesh)


# --- Robin data


def sides(mesh: Mesh) -> Mesh:
    """The mesh with its boundary tagged: 1 left, 2 right, 0 elsewhere."""
    x = mesh.face_centroids[:, 0]
    tags = np.where(x < x.min() + 1e-9, 1, np.where(x > x.max() - 1e-9, 2, 0))
    return replace(mesh, face_tags={"boundary": tags})


def linear(x: Array) -> Array:
    return np.asarray(1.0 + x @ np.array([2.0, -3.0, 1.5])[: x.shape[1]])


def flux(kappa: float, axis: int, sign: float) -> float:
    return sign * kappa * (2.0, -3.0, 1.5)[axis]


BOXES: dict[str, Callable[[], Mesh]] = {
    "voronoi": lambda: sides(samples.voronoi(40, seed=1)),
    "random triangles": lambda: sides(samples.random_triangles(60, seed=2)),
    "tetrahedra": lambda: sides(samples.random_tetrahedra(20, seed=3)),
}


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("tagged", ["robin alone", "with the others"])
def test_linear_solutions_are_met_with_robin_data(name: str, degree: int, tagged: str) -> None:
    mesh, kappa = BOXES[name](), 2.5

    def alpha(x: Array) -> Array:
        return np.asarray(1.0 + x[:, 1])

    def right(x: Array) -> Array:
        return np.asarray(alpha(x) * linear(x) + flux(kappa, 0, 1.0))

    def left(x: Array) -> Array:
        return np.asarray(0.5 * linear(x) + flux(kappa, 0, -1.0))

    rest: dict[str, Any] = {"dirichlet": {0: linear}}
    if tagged == "robin alone":

        def around(x: Array) -> Array:
            """The flux through the other sides, which lie along axes."""
            low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
            total = np.zeros(len(x))
            for axis in range(1, mesh.dim):
                total += np.where(np.isclose(x[:, axis], low[axis]), flux(kappa, axis, -1.0), 0.0)
                total += np.where(np.isclose(x[:, axis], high[axis]), flux(kappa, axis, 1.0), 0.0)
            return total

        rest = {"neumann": {0: around}}
    problem = Diffusion(kappa, 0.0, robin={1: (0.5, left), 2: (alpha, right)}, exact=linear, **rest)
    assert errors_of(PolyDG(degree), problem, mesh).l2 < 1e-10


ROBIN = Diffusion(
    source=lambda x: (13.0 + coefficient(x)) * wave(x),
    dirichlet={0: wave, 1: wave},
    robin={
        2: (
            lambda x: 2.0 + x[:, 1],
            lambda x: (2.0 + x[:, 1]) * wave(x) + 2.0 * np.cos(2.0 * x[:, 0] + 0.3) * np.cos(3.0 * x[:, 1]),
        )
    },
    exact=wave,
    reaction=coefficient,
)


@pytest.mark.parametrize("degree", [1, 2])
def test_orders_with_robin_data(degree: int) -> None:
    found = [errors_of(PolyDG(degree), ROBIN, sides(samples.voronoi(n, seed=0))) for n in (100, 1600)]
    assert np.log2(found[0].l2 / found[1].l2) / 2 > degree + 0.75
    assert np.log2(found[0].dg / found[1].dg) / 2 > degree - 0.25


def test_a_large_alpha_is_a_dirichlet_condition() -> None:
    mesh = sides(samples.voronoi(80, seed=3))
    held = Diffusion(dirichlet={1: 5.0})
    for solver in ("direct", "polydg_mg"):
        stiff = agglo.solve(mesh, Diffusion(robin={1: (1e6, 5e6)}), solver=solver, degree=2, tolerance=1e-7)
        assert stiff.converged
        expected = agglo.solve(mesh, held, solver="direct", degree=2, tolerance=1e-9)
        points = mesh.cell_centroids
        values = [each.discretisation.evaluate(mesh, each.x, points) for each in (stiff, expected)]
        assert values[0] == pytest.approx(values[1], abs=1e-2)


def test_alpha_alone_makes_the_solution_unique() -> None:
    mesh = sides(samples.squares(4))
    solution = agglo.solve(mesh, Diffusion(source=0.0, robin={1: (2.0, 6.0)}), tolerance=1e-10)
    assert solution.x == pytest.approx(solution.discretisation.project(mesh, 3.0), abs=1e-8)
    for alpha in (0.0, lambda x: np.zeros(len(x))):
        with pytest.raises(OptionError, match="no Robin data with positive alpha"):
            PolyDG().assemble(Diffusion(source=0.0, robin={1: (alpha, 6.0)}), mesh)


def test_robin_data_by_cell_follow_the_numbering_and_the_agglomerates() -> None:
    plain = samples.squares(110)
    mesh = sides(plain.renumbered(np.random.default_rng(0).permutation(plain.n_cells)))
    by_cell = 1.0 + np.floor(4.0 * mesh.cell_centroids[:, 1])
    problem = Diffusion(robin={1: (by_cell, by_cell)})
    found = agglo.solve(mesh, problem, tolerance=1e-9)
    assert "renumbered" in found.choice
    assert abs(found.x - solved(PolyDG(1), problem, mesh)).max() < 1e-6
    coarse = sides(samples.squares(4))
    rows = np.arange(16) // 4 + 1.0
    operator = PolyDG(1, 10.0).coarse_operator(Diffusion(robin={1: (rows, 1.0)}), coarse, np.arange(16) // 8)
    assert np.linalg.eigvalsh(operator.toarray()).min() > 0.0


@pytest.mark.parametrize("solver", ["polydg_mg_paper", "polydg_cg", "multigrid"])
def test_solvers_accept_robin_data(solver: str) -> None:
    mesh = sides(samples.voronoi(100, seed=5))
    problem = Diffusion(robin={1: (3.0, 1.0), 2: (lambda x: 1.0 + x[:, 1], 0.0)})
    solution = agglo.solve(agglomerate(mesh, n_parts=(20, 5)), problem, solver=solver, tolerance=1e-9)
    exact = solved(solution.discretisation, problem, mesh)
    assert solution.converged
    assert abs(solution.x - exact).max() <= 1e-5 * abs(exact).max()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"robin": {1: (-1.0, 0.0)}},
            r"alpha of robin must not be negative: it is -1 on face \d+ with tag 1",
        ),
        ({"robin": {1: (lambda x: x[:, 1] - 9, 0.0)}}, r"it is -\d\.?\d* on face \d+ with tag 1"),
        ({"robin": {1: 2.0}}, r"robin\[1\] must be a pair \(alpha, g\), given 2.0"),
        ({"robin": {1: (1.0, "x")}}, r"g of robin\[1\]"),
        ({"robin": 3.0}, "robin must be a mapping from boundary tags to data; given 3.0"),
        ({"robin": {1: (1.0, 0.0)}, "neumann": {1: 0.0}}, r"tags \[1\] have both Neumann and Robin data"),
        ({"robin": {1: (1.0, 0.0)}, "dirichlet": {1: 0.0}}, r"tags \[1\] have both Dirichlet and Robin data"),
        ({"robin": {7: (1.0, 0.0)}}, "no boundary face has the tag 7"),
    ],
)
def test_bad_robin_data_are_refused(given: Any, message: str) -> None:
    with pytest.raises(AggloError, match=message):
        PolyDG().assemble(Diffusion(**given), sides(samples.squares(4)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[robin.1]\nalpha = 1", "robin.1 must be a table with alpha and value, given {'alpha': 1}"),
        ("robin = 3", "robin must be a table by boundary tag, given 3"),
        ("[robin]\n1 = 2", "robin.1 must be a table with alpha and value, given 2"),
        ("[robin.1]\nalpha = -2\nvalue = 0", "robin.1.alpha must not be negative, given -2"),
        ("[robin.1]\nalpha = 1\nvalue = 'x'", "robin.1.value must be a finite number, given 'x'"),
        ("[robin.9]\nalpha = 1\nvalue = 0", "robin names boundary tag 9; the mesh has: 0, 1, 2"),
        (
            "[robin.1]\nalpha = 1\nvalue = 0\n[neumann]\n1 = 0",
            "boundary tag 1 is in both neumann and robin",
        ),
        ("[robin]", "[robin] is empty"),
    ],
)
def test_bad_robin_tables_are_refused(tmp_path: Any, text: str, message: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(AggloError, match=re.escape(message)):
        agglo.problems.read_problem(path, sides(samples.squares(4)))


def test_robin_tables(tmp_path: Any) -> None:
    path = tmp_path / "p.toml"
    path.write_text("[robin.2]\nalpha = 10\nvalue = -2.5\n")
    assert agglo.problems.read_problem(path, sides(samples.squares(4))).robin == {2: (10.0, -2.5)}


# --- Neumann data alone


def drop(x: Array) -> Array:
    """A function with mean 0 on the unit square or cube."""
    return np.asarray(np.cos(np.pi * x[:, 0]) * np.cos(2.0 * np.pi * x[:, 1]) + x[:, 0] - 0.5)


def around(x: Array) -> Array:
    """The outward derivative of ``drop`` on the unit square."""
    return np.asarray(np.where(np.isclose(x[:, 0], 1.0), 1.0, np.where(np.isclose(x[:, 0], 0.0), -1.0, 0.0)))


NEUMANN = Diffusion(
    source=lambda x: 5.0 * np.pi**2 * (drop(x) - x[:, 0] + 0.5), neumann={0: around}, exact=drop
)


@pytest.mark.parametrize("degree", [1, 2])
def test_orders_with_neumann_data_alone(degree: int) -> None:
    found = []
    for n in (100, 1600):
        mesh = samples.voronoi(n, seed=0)
        solution = agglo.solve(mesh, NEUMANN, degree=degree, tolerance=1e-10)
        assert solution.converged
        found.append(solution.errors())
    assert np.log2(found[0]["l2"] / found[1]["l2"]) / 2 > degree + 0.75
    assert np.log2(found[0]["dg"] / found[1]["dg"]) / 2 > degree - 0.25


@pytest.mark.parametrize("solver", ["direct", "polydg_mg", "polydg_mg_paper", "polydg_cg", "multigrid"])
def test_the_solution_of_neumann_data_alone_has_mean_zero(solver: str) -> None:
    mesh = samples.voronoi(100, seed=5)
    kappa = np.where(mesh.cell_centroids[:, 0] < 0.3, 100.0, 1.0)
    problem = Diffusion(kappa, lambda x: 3.0 * (x[:, 1] - 0.5), neumann={0: 0.0})
    solution = agglo.solve(agglomerate(mesh, n_parts=(20, 5)), problem, solver=solver, tolerance=1e-9)
    basis = solution.discretisation.basis(mesh)
    assert solution.converged
    assert abs(basis.project(1.0) @ basis.mass() @ solution.x) < 1e-8
    r = solution.b - solution.A @ solution.x
    assert np.linalg.norm(r) <= 1e-7 * np.linalg.norm(solution.b)
    reference = agglo.solve(mesh, problem, solver="direct", tolerance=1e-10)
    if (basis.scaled, solver) == (False, "polydg_mg_paper"):
        assert solution.x == pytest.approx(reference.x, abs=1e-6)


@pytest.mark.parametrize("recipe", ["conforming", "patches"])
@pytest.mark.parametrize("degree", [1, 2])
def test_neumann_data_alone_take_few_more_iterations(recipe: str, degree: int) -> None:
    mesh = samples.voronoi(300, seed=0)
    levels = agglomerate(mesh, n_parts=(60, 10))
    load = lambda x: x[:, 0] - 0.5  # noqa: E731
    free, held = (
        agglo.solve(levels, Diffusion(source=load, **data), degree=degree, recipe=recipe, tolerance=1e-8)
        for data in ({"neumann": {0: 0.0}}, {"dirichlet": {0: 0.0}})
    )
    assert free.converged
    assert free.iterations <= held.iterations + 4


def test_neumann_data_alone_on_polyhedra() -> None:
    mesh = samples.random_tetrahedra(100, seed=1)
    problem = Diffusion(source=0.0, neumann={0: around}, exact=lambda x: x[:, 0] - 0.5)
    for solver in ("direct", "polydg_mg"):
        solution = agglo.solve(mesh, problem, solver=solver, tolerance=1e-11, degree=1)
        assert solution.errors()["l2"] < 1e-8


def test_each_component_has_its_own_constant() -> None:
    one = samples.squares(3)
    points = np.concatenate((one.points, one.points + np.array([2.0, 0.0])))
    mesh = Mesh.from_polygons(points, [each + shift for shift in (0, one.n_points) for each in one.cells])
    mesh = replace(mesh, face_tags={"boundary": (mesh.face_centroids[:, 0] > 1.5).astype(int)})

    def exact(x: Array) -> Array:
        return np.asarray(np.where(x[:, 0] < 1.5, x[:, 0] - 0.5, 7.0))

    def right(x: Array) -> Array:
        return np.where(np.isclose(x[:, 0], 1.0), 1.0, np.where(np.isclose(x[:, 0], 0.0), -1.0, 0.0))

    both: Any = {"dirichlet": {1: 7.0}, "exact": exact}
    neumann = Diffusion(source=0.0, neumann={0: right}, **both)
    robin = Diffusion(source=0.0, robin={0: (1.0, lambda x: exact(x) + right(x))}, **both)
    for problem in (neumann, robin):
        for solver in ("direct", "polydg_mg"):
            solution = agglo.solve(mesh, problem, solver=solver, tolerance=1e-11)
            assert solution.converged
            assert solution.errors()["l2"] < 1e-9


def test_quadrature_errors_are_corrected_and_more_is_refused() -> None:
    mesh = samples.squares(4)
    exact = Diffusion(source=lambda x: np.cos(np.pi * x[:, 0]), neumann={0: 0.0})
    off = Diffusion(source=lambda x: np.cos(np.pi * x[:, 0]) + 1e-6, neumann={0: 0.0})
    one, other = (agglo.solve(mesh, each, solver="direct", tolerance=1e-10) for each in (exact, off))
    assert other.x == pytest.approx(one.x, abs=1e-9)
    assert one.converged
    for problem, number in (
        (Diffusion(neumann={0: 0.0}), "they integrate to 1, their magnitudes to 1"),
        (Diffusion(source=-3.0, neumann={0: 0.5}), "they integrate to -1, their magnitudes to 5"),
        (Diffusion(source=lambda x: x[:, 0] - 0.4, neumann={0: 0.0}), "they integrate to 0.1, "),
    ):
        with pytest.raises(OptionError, match=number):
            PolyDG().assemble(problem, mesh)


def test_one_cell_without_dirichlet_data() -> None:
    mesh = samples.squares(1)
    solution = agglo.solve(mesh, Diffusion(source=0.0, neumann={0: around}), solver="direct", tolerance=1e-9)
    assert solution.x == pytest.approx(
        solution.discretisation.project(mesh, lambda x: x[:, 0] - 0.5), abs=1e-9
    )


def test_the_energy_is_the_work_of_the_loads() -> None:
    """∫ f u, which is the energy of u."""
    mesh = samples.voronoi(60, seed=2)
    for shift in (0.0, 100.0):
        moved = replace(mesh, points=mesh.points + shift)
        problem = Diffusion(source=lambda x: x[:, 0] - x[:, 1], neumann={0: 0.0})
        solution = agglo.solve(moved, problem, solver="direct", tolerance=1e-10)
        load = solution.discretisation.load(problem, moved, solution.b)
        assert load @ solution.x == pytest.approx(1 / 60, rel=0.1)


# --- Tensors


def rotated(angle: Any, ratio: float, dim: int = 2) -> Array:
    """Tensors with the eigenvalues 1 and ``ratio``, the first along an angle in the x–y plane."""
    c, s = np.cos(angle), np.sin(angle)
    first = np.stack((c, s, *([0.0 * c] * (dim - 2))), axis=-1)
    return np.asarray(ratio * np.eye(dim) + (1.0 - ratio) * first[..., :, None] * first[..., None, :])


def full(dim: int) -> Array:
    found = np.array([[2.0, 0.7, -0.3], [0.7, 1.0, 0.2], [-0.3, 0.2, 3.0]])
    return found[:dim, :dim]


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("penalty", ["sharp", 10.0])
def test_multiples_of_the_identity_are_scalars(name: str, degree: int, penalty: Any) -> None:
    mesh = MESHES[name]()
    if mesh.dim == 3 and penalty == 10.0:
        degree = 1
    how, identity = PolyDG(degree, penalty), np.eye(mesh.dim)
    cells = 10.0 ** np.random.default_rng(0).uniform(-2, 2, mesh.n_cells)

    def kappa(x: Array) -> Array:
        return np.asarray(2.0 + np.sin(5.0 * x[:, 0]))

    pairs = (
        (3.0, 3.0 * identity),
        (cells, cells[:, None, None] * identity),
        (kappa, lambda x: kappa(x)[:, None, None] * identity),
    )
    for scalar, tensor in pairs:
        data: Any = {"dirichlet": {0: lambda x: x[:, 0]}}
        one, other = (how.lifted(Diffusion(k, **data), mesh) for k in (scalar, tensor))
        assert other.sigma == pytest.approx(one.sigma, rel=1e-9)
        assert abs(other.system.A - one.system.A).max() <= 1e-9 * abs(one.system.A).max()
        assert other.system.b == pytest.approx(one.system.b, abs=1e-9 * abs(one.system.b).max())
        x = np.random.default_rng(1).standard_normal(len(one.load))
        measures = [how.residual_measure(Diffusion(k, **data), mesh, one.load) for k in (scalar, tensor)]
        assert measures[0].energy(x) == pytest.approx(measures[1].energy(x), rel=1e-9)
        labels = np.arange(mesh.n_cells) // 7
        if mesh.dim == 2 and not callable(scalar):
            coarse = [how.coarse_operator(Diffusion(k, **data), mesh, labels) for k in (scalar, tensor)]
            assert abs(coarse[0] - coarse[1]).max() <= 1e-9 * abs(coarse[0]).max()


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_linear_solutions_are_met_with_a_tensor(name: str, degree: int) -> None:
    mesh = MESHES[name]()
    K = full(mesh.dim)
    cells = np.broadcast_to(K, (mesh.n_cells, *K.shape))
    for kappa in (K, cells, lambda x: np.broadcast_to(K, (len(x), *K.shape))):
        problem = Diffusion(kappa, 0.0, {0: linear}, exact=linear)
        assert errors_of(PolyDG(degree), problem, mesh).l2 < 1e-10


def fluxes(x: Array) -> Array:
    """n·K∇u for ``linear`` on the sides of a square."""
    q = full(2) @ np.array([2.0, -3.0])
    low, high = x.min(axis=0), x.max(axis=0)
    total = np.zeros(len(x))
    for axis in (0, 1):
        total += np.where(np.isclose(x[:, axis], high[axis]), q[axis], 0.0)
        total -= np.where(np.isclose(x[:, axis], low[axis]), q[axis], 0.0)
    return total


def test_natural_data_are_fluxes_of_the_tensor() -> None:
    mesh = sides(samples.voronoi(40, seed=1))
    problem = Diffusion(
        full(2),
        0.0,
        {1: linear},
        {0: lambda x: np.where(x[:, 1] > 0.5, 1.0, -1.0) * (full(2) @ [2.0, -3.0])[1]},
        linear,
        robin={2: (2.0, lambda x: 2.0 * linear(x) + (full(2) @ [2.0, -3.0])[0])},
    )
    assert errors_of(PolyDG(2), problem, mesh).l2 < 1e-10


def varying(x: Array) -> Array:
    """A full tensor that varies."""
    a, b, c = 2.0 + x[:, 0], 0.5 + 0.3 * x[:, 1], 1.0 + x[:, 1] ** 2
    return np.stack((np.stack((a, b), axis=-1), np.stack((b, c), axis=-1)), axis=-2)


def varying_source(x: Array) -> Array:
    """−∇·(K∇u) + c u for ``wave``."""
    s, t = 2.0 * x[:, 0] + 0.3, 3.0 * x[:, 1]
    ux, uy = 2.0 * np.cos(s) * np.cos(t), -3.0 * np.sin(s) * np.sin(t)
    uxx, uyy, uxy = -4.0 * wave(x), -9.0 * wave(x), -6.0 * np.cos(s) * np.sin(t)
    K = varying(x)
    divergence = K[:, 0, 0] * uxx + 2.0 * K[:, 0, 1] * uxy + K[:, 1, 1] * uyy
    divergence += ux + 0.3 * ux + 2.0 * x[:, 1] * uy  # ∂x a ux + ∂y b ux + ∂x b uy + ∂y c uy
    return np.asarray(-divergence + coefficient(x) * wave(x))


def varying_robin(x: Array) -> Array:
    s, t = 2.0 * x[:, 0] + 0.3, 3.0 * x[:, 1]
    ux, uy = 2.0 * np.cos(s) * np.cos(t), -3.0 * np.sin(s) * np.sin(t)
    K = varying(x)
    return np.asarray((1.0 + x[:, 1]) * wave(x) + K[:, 0, 0] * ux + K[:, 0, 1] * uy)


VARYING = Diffusion(
    varying,
    varying_source,
    {0: wave, 1: wave},
    exact=wave,
    reaction=coefficient,
    robin={2: (lambda x: 1.0 + x[:, 1], varying_robin)},
)


def orders(degree: int, meshes: list[Mesh], problem: Diffusion) -> tuple[float, float]:
    """Orders in the L2 and DG norms between two meshes."""
    found = [errors_of(PolyDG(degree), problem, mesh) for mesh in meshes]
    sizes = [mesh.n_cells ** (-1 / mesh.dim) for mesh in meshes]
    steps = np.log(sizes[0] / sizes[1])
    return np.log(found[0].l2 / found[1].l2) / steps, np.log(found[0].dg / found[1].dg) / steps


@pytest.mark.parametrize("degree", [1, 2])
def test_orders_with_tensor_reaction_and_robin_data(degree: int) -> None:
    l2, dg = orders(degree, [sides(samples.voronoi(n, seed=0)) for n in (100, 1600)], VARYING)
    assert l2 > degree + 0.75
    assert dg > degree - 0.25


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["voronoi", "random_triangles"])
def test_orders_to_degree_four(degree: int, kind: str) -> None:
    l2, dg = orders(degree, [sides(getattr(samples, kind)(n, seed=0)) for n in (100, 1600)], VARYING)
    assert l2 > degree + 0.7
    assert dg > degree - 0.3


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_orders_on_tetrahedra(degree: int) -> None:
    K = full(3)

    def exact(x: Array) -> Array:
        return np.asarray(np.sin(x @ np.array([1.0, 2.0, -1.0])))

    w = np.array([1.0, 2.0, -1.0])
    problem = Diffusion(K, lambda x: (w @ K @ w + 2.0) * exact(x), {0: exact}, exact=exact, reaction=2.0)
    l2, dg = orders(degree, [samples.tetrahedra(n) for n in (3, 6)], problem)
    assert l2 > degree + 0.7
    assert dg > degree - 0.3


BAD: dict[str, tuple[Any, str]] = {
    "indefinite": (
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        "definite: it is .* eigenvalue -1, in cell 0",
    ),
    "in a cell": (
        np.where(np.arange(16)[:, None, None] == 3, -1.0, 1.0) * np.eye(2),
        "positive definite: it is .* in cell 3",
    ),
    "at a point": (
        lambda x: (x[:, 0] - 0.5)[:, None, None] * np.eye(2),
        r"positive definite: it is .* at \[0\.",
    ),
    "unsymmetric": (np.array([[1.0, 0.5], [0.0, 1.0]]), "symmetric: it is .* in cell 0"),
    "shape": (np.ones((3, 3)), r"kappa has shape \(3, 3\): expected a number, \(16,\) values, \(2, 2\) or"),
    "nan": (np.array([[1.0, np.nan], [np.nan, 1.0]]), "kappa is .* not finite"),
    "a callable of another shape": (lambda x: np.ones((len(x), 3, 3)), r"kappa returned shape \(\d+, 3, 3\)"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tensors_are_refused(name: str) -> None:
    kappa, message = BAD[name]
    with pytest.raises(AggloError, match=message):
        PolyDG().assemble(Diffusion(kappa), samples.squares(4))


@pytest.mark.parametrize("solver", ["direct", "polydg_mg", "polydg_mg_paper", "polydg_cg", "multigrid"])
def test_solvers_accept_tensors(solver: str) -> None:
    mesh = samples.voronoi(120, seed=5)
    angles = np.random.default_rng(0).uniform(0.0, np.pi, mesh.n_cells)
    levels = agglomerate(mesh, n_parts=(30, 8))
    for kappa in (rotated(0.5, 1e-2), rotated(angles, 0.05), lambda x: varying(x)):
        problem = Diffusion(kappa)
        solution = agglo.solve(levels, problem, solver=solver, tolerance=1e-9)
        exact = solved(solution.discretisation, problem, mesh)
        assert solution.converged
        assert abs(solution.x - exact).max() <= 1e-5 * abs(exact).max()


@pytest.mark.parametrize("degree", [2, 3])
@pytest.mark.parametrize(
    ("mesh", "most"), [(samples.squares(32), (12, 21)), (samples.voronoi(1024, seed=0), (15, 24))]
)
def test_strong_directions_take_few_iterations(mesh: Mesh, most: tuple[int, int], degree: int) -> None:
    x, y = mesh.cell_centroids.T
    for epsilon, limit in zip((1e-2, 1e-4), most, strict=True):
        found = agglo.solve(mesh, Diffusion(rotated(2.0 * x + y, epsilon)), degree=degree)
        assert found.converged
        assert found.iterations <= limit
        assert "directional" in found.choice


def test_directional_tensors_leave_layers_their_guide() -> None:
    plain = samples.squares(24)
    points = np.stack((plain.points[:, 0], np.expm1(7.0 * plain.points[:, 1]) / np.expm1(7.0)), axis=1)
    mesh = Mesh(points, plain.face_offsets, plain.face_vertices, plain.face_cells)
    assert agglo.solve(mesh, Diffusion(rotated(0.0, 1e-2))).iterations <= 7


@pytest.mark.parametrize("degree", [1, 2])
def test_polyhedra_with_tensors_are_solved(degree: int) -> None:
    mesh = samples.random_tetrahedra(40, seed=2)
    for ratio in (1.0, 1e-2):
        problem = Diffusion(rotated(0.7, ratio, 3), 0.0, {0: linear}, exact=linear)
        solution = agglo.solve(mesh, problem, degree=degree, tolerance=1e-10)
        assert solution.converged
        assert solution.errors()["l2"] < 1e-7


def test_scattered_cells_keep_their_tensors() -> None:
    plain = samples.squares(110)
    mesh = plain.renumbered(np.random.default_rng(0).permutation(plain.n_cells))
    kappa = rotated(np.where(mesh.cell_centroids[:, 0] < 0.5, 0.3, 1.2), 0.1)
    found = agglo.solve(mesh, Diffusion(kappa), tolerance=1e-9)
    assert "renumbered" in found.choice
    assert abs(found.x - solved(PolyDG(1), Diffusion(kappa), mesh)).max() < 1e-6


def test_tables_of_tensors(tmp_path: Any) -> None:
    plain = samples.squares(4)
    mesh = replace(plain, cell_tags={"material": (np.arange(16) > 7).astype(int)})
    path = tmp_path / "p.toml"
    path.write_text("kappa = [[2.0, 0.5], [0.5, 1.0]]\n")
    assert np.array_equal(agglo.problems.read_problem(path, mesh).kappa, [[2.0, 0.5], [0.5, 1.0]])
    path.write_text("[kappa.material]\n0 = 3\n1 = [[2.0, 0.5], [0.5, 1.0]]\n")
    kappa = agglo.problems.read_problem(path, mesh).kappa
    assert np.array_equal(kappa[0], 3.0 * np.eye(2))
    assert np.array_equal(kappa[9], [[2.0, 0.5], [0.5, 1.0]])
    for text, message in (
        ("kappa = [[1, 2], [2, 1]]", "kappa must be positive definite: its least eigenvalue is -1"),
        ("kappa = [[1, 2], [0, 1]]", "kappa must be symmetric, given [[1, 2], [0, 1]]"),
        ("kappa = [1, 2]", "kappa must be a number or 2 rows of 2 numbers, given [1, 2]"),
        ("[kappa.material]\n0 = [[1, 2], [2, 'x']]\n1 = 1", "kappa.material.0 must be a finite number"),
    ):
        path.write_text(text)
        with pytest.raises(AggloError, match=re.escape(message)):
            agglo.problems.read_problem(path, mesh)


# --- Convection


def stream(x: Array) -> Array:
    """A velocity that turns, without divergence."""
    return np.stack((1.0 + x[:, 1], -2.0 * x[:, 0] + 0.5, 0.0 * x[:, 0] + 0.7)[: x.shape[1]], axis=1)


def slope(x: Array) -> Array:
    return np.array([2.0, -3.0, 1.5])[: x.shape[1]]


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_linear_solutions_are_met_with_convection(name: str, degree: int) -> None:
    mesh = MESHES[name]()
    steady = np.array([3.0, -1.0, 2.0])[: mesh.dim]
    for b in (1e3 * steady, np.broadcast_to(steady, (mesh.n_cells, mesh.dim)), stream):
        source: Any = float(b @ slope(mesh.points)) if isinstance(b, np.ndarray) and b.ndim == 1 else None
        if source is None:
            source = float(steady @ slope(mesh.points)) if b is not stream else lambda x: stream(x) @ slope(x)
        problem = Diffusion(1e-2, source, {0: linear}, exact=linear, convection=b)
        assert errors_of(PolyDG(degree), problem, mesh).l2 < 1e-10


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kappa", [1.0, 1e-6])
def test_orders_with_convection(degree: int, kappa: float) -> None:
    def source(x: Array) -> Array:
        s, t = 2.0 * x[:, 0] + 0.3, 3.0 * x[:, 1]
        gradient = np.stack((2.0 * np.cos(s) * np.cos(t), -3.0 * np.sin(s) * np.sin(t)), axis=1)
        return np.asarray(13.0 * kappa * wave(x) + (stream(x) * gradient).sum(axis=1) + wave(x))

    problem = Diffusion(kappa, source, {0: wave}, exact=wave, convection=stream, reaction=1.0)
    l2, dg = orders(degree, [samples.voronoi(n, seed=0) for n in (100, 1600)], problem)
    assert l2 > degree + (0.75 if kappa == 1.0 else 0.4)  # p + 1/2 is proved where convection dominates
    assert dg > degree - 0.25


@pytest.mark.parametrize("name", MESHES)
def test_convection_adds_the_energy_of_jumps(name: str) -> None:
    """xᵀ A x grows by ½ Σ ∫ |b·n| [u]², with the values on the whole boundary as jumps."""
    mesh, how = MESHES[name](), PolyDG(2)
    basis, x = how.basis(mesh), np.random.default_rng(0).standard_normal(how.basis(mesh).n)
    plain, more = (how.assemble(Diffusion(convection=b), mesh).A for b in (0.0, stream))
    rule = face_rule(basis.mesh, np.arange(basis.mesh.n_faces), 4)
    cells, points = basis.mesh.face_cells[rule.faces], rule.points + mesh.origin
    count, q, dim = points.shape
    flat = points.reshape(-1, dim)
    jump = basis.evaluate(x, np.repeat(cells[:, 0], q), flat).reshape(count, q)
    inner = cells[:, 1] >= 0
    beyond = basis.evaluate(x, np.repeat(np.where(inner, cells[:, 1], 0), q), flat).reshape(count, q)
    jump -= np.where(inner[:, None], beyond, 0.0)
    speed = np.abs(np.einsum("tqd,td->tq", stream(flat).reshape(points.shape), rule.normals))
    expected = 0.5 * (rule.weights * speed * jump**2).sum()
    assert x @ (more - plain) @ x == pytest.approx(expected, rel=1e-2)


def test_direct_solves_problems_with_convection() -> None:
    mesh = samples.voronoi(200, seed=1)
    data: Any = {"convection": np.array([3.0, 1.0]), "dirichlet": {0: lambda x: 5.0 + x[:, 0]}}
    found = []
    for backend in ("auto", "superlu"):
        for source in (1.0, 1e200):
            problem = Diffusion(1e-2, source, **data)
            solution = agglo.solve(mesh, problem, solver="direct", tolerance=1e-9, backend=backend)
            assert solution.converged
            found.append(solution.x)
    assert found[0] == pytest.approx(found[2], abs=1e-10)
    with pytest.raises(OptionError, match="cholmod"):
        agglo.solve(mesh, Diffusion(**data), solver="direct", backend="cholmod")


@pytest.mark.parametrize("solver", ["polydg_mg_paper", "polydg_cg", "multigrid"])
def test_other_solvers_refuse_convection(solver: str) -> None:
    mesh = samples.squares(4)
    with pytest.raises(AggloError, match=r"not symmetric, but .* use solver='direct'"):
        agglo.solve(agglomerate(mesh, n_parts=4), Diffusion(convection=np.ones(2)), solver=solver)


@pytest.mark.parametrize(
    ("convection", "message"),
    [
        (np.ones(3), r"convection has shape \(3,\): expected \(2,\), \(16, 2\) or a callable"),
        (np.array([1.0, np.nan]), r"convection is \[1.0, nan\] in cell 0, not finite"),
        (lambda x: np.ones((len(x), 3)), r"convection returned shape \(\d+, 3\)"),
        ("east", "convection must be a number"),
    ],
)
def test_bad_velocities_are_refused(convection: Any, message: str) -> None:
    with pytest.raises(AggloError, match=message):
        PolyDG().assemble(Diffusion(convection=convection), samples.squares(4))


def test_convection_with_neumann_data_alone_is_refused() -> None:
    problem = Diffusion(source=0.0, neumann={0: 0.0}, convection=np.ones(2))
    with pytest.raises(OptionError, match="the component of cell 0 has convection, but no boundary face"):
        PolyDG().assemble(problem, samples.squares(4))


def test_tables_of_convection(tmp_path: Any) -> None:
    path = tmp_path / "p.toml"
    path.write_text("convection = [1, -2.5]\n")
    assert agglo.problems.read_problem(path, samples.squares(4)).convection.tolist() == [1.0, -2.5]
    path.write_text("convection = [1.0]\n")
    with pytest.raises(AggloError, match=re.escape("convection must be a list of 2 numbers, given [1.0]")):
        agglo.problems.read_problem(path, samples.squares(4))


def squeezed(dim: int) -> Mesh:
    """Cells too thin for the eigenvalue problem of the sharp penalty."""
    if dim == 2:
        mesh = samples.random_triangles(40, seed=5)
        return replace(mesh, points=mesh.points * [1.0, 1e-7])
    mesh, way = samples.tetrahedra(2), np.array((1.0, 2.0, 3.0)) / np.sqrt(14.0)
    return replace(mesh, points=mesh.points - (1 - 1e-7) * np.outer(mesh.points @ way, way))


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_too_thin_for_their_stiffness_with_tensors(dim: int) -> None:
    """Multiples of the identity give the penalty of scalars, and turned tensors a definite matrix."""
    mesh, how, identity = squeezed(dim), PolyDG(2 if dim == 3 else 3, scaled_basis=False), np.eye(dim)
    cells = 10.0 ** np.random.default_rng(0).uniform(-2, 2, mesh.n_cells)
    pairs = (
        (cells, cells[:, None, None] * identity),
        (lambda x: 2.0 + np.sin(x[:, 0]), lambda x: (2.0 + np.sin(x[:, 0]))[:, None, None] * identity),
    )
    for scalar, tensor in pairs:
        sigmas = [how.lifted(Diffusion(kappa), mesh).sigma for kappa in (scalar, tensor)]
        assert sigmas[1] == pytest.approx(sigmas[0], rel=1e-6)
    A = how.assemble(Diffusion(rotated(0.5, 1e-3, dim)), mesh).A.toarray()
    scale = 1 / np.sqrt(np.diag(A))
    assert np.linalg.eigvalsh(A * scale[:, None] * scale).min() > -1e-10


def test_steps_reuse_levels_for_tensors_and_neumann_data_alone() -> None:
    """A solver that keeps its levels gives the solutions of one that does not."""
    levels = agglomerate(samples.voronoi(200, seed=6), n_parts=(40, 8))
    mesh = levels.fine
    steps = agglo.registry.default().build("solver", "polydg_mg", tolerance=1e-10).repeated(levels)
    for k in range(3):
        for kappa in (1.0 + k, rotated(0.3 * k, 0.2)):
            problem = Diffusion(kappa, lambda x: x[:, 0] - 0.5, neumann={0: 0.0})
            found = steps.solve(problem)
            expected = agglo.solve(mesh, problem, tolerance=1e-10)
            assert found.converged
            assert found.x == pytest.approx(expected.x, abs=1e-7)
