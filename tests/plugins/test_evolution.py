"""Evolution in time: orders of the schemes, explicit reactions, and reuse of matrices and factors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Diffusion, Elasticity, Hierarchy, Linear, Mesh, OptionError, samples
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.forms import assembly
from agglo_polydg_mg.forms.norms import EnergyNorm
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.numbering import numbering_for
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

Array = NDArray[np.float64]
ORDERS = {"be": 1, "cn": 2, "bdf2": 2}


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


def decaying(t: float) -> Diffusion:
    """u = exp(−t) (x² + y) + t y: in the space of degree 2, so that all errors are those of time steps."""

    def u(x: Array) -> Array:
        return np.asarray(np.exp(-t) * (x[:, 0] ** 2 + x[:, 1]) + t * x[:, 1])

    def source(x: Array) -> Array:
        return np.asarray(-np.exp(-t) * (x[:, 0] ** 2 + x[:, 1]) + x[:, 1] - np.exp(-t) + 2.0 * u(x))

    return Diffusion(kappa=0.5, reaction=2.0, source=source, dirichlet={0: u}, exact=u)


def order(error: Callable[[int], float]) -> float:
    return float(np.log2(error(10) / error(20)))


@pytest.mark.parametrize("scheme", ORDERS)
def test_schemes_have_their_order_with_data_that_depend_on_time(scheme: str) -> None:
    mesh = samples.voronoi(12, seed=2)

    def error(n: int) -> float:
        states = agglo.evolve(
            mesh, decaying, decaying(0.0).exact, 1.0, 1.0 / n, scheme,
            solver="direct", degree=2, tolerance=1e-12,
        )  # fmt: skip
        t, solution = list(states)[-1]
        assert t == pytest.approx(1.0, rel=1e-12)
        return solution.errors()["l2"]

    assert order(error) == pytest.approx(ORDERS[scheme], abs=0.15)


@pytest.mark.parametrize("scheme", ORDERS)
def test_schemes_have_their_order_with_a_nonlinear_reaction(scheme: str) -> None:
    """Logistic growth u' = u (1 − u) + t, insulated, against the solution of the differential equation."""
    mesh = samples.squares(2)
    problem = Diffusion(source=0.0, neumann={0: 0.0})

    def grown(n: int) -> float:
        *_, (_, solution) = agglo.evolve(
            mesh, problem, 0.2, 1.0, 1.0 / n, scheme, reaction=lambda t, x, u: u * (1.0 - u) + t,
            solver="direct", penalty="sharp", tolerance=1e-12,
        )  # fmt: skip
        return solution.integral()

    u, n = 0.2, 2000  # by Heun's method with short steps
    for k in range(n):
        t, h = k / n, 1.0 / n
        first = u * (1.0 - u) + t
        ahead = u + h * first
        u += 0.5 * h * (first + ahead * (1.0 - ahead) + t + h)
    assert order(lambda n: abs(grown(n) - u)) == pytest.approx(ORDERS[scheme], abs=0.25)


def test_a_reaction_may_keep_variables_at_its_points() -> None:
    """It is called once per step, with the same points in the same order."""
    mesh, step, calls = samples.voronoi(30, seed=3), 0.1, []
    gates: dict[str, Array] = {}

    def reaction(t: float, points: Array, u: Array) -> Array:
        gates.setdefault("w", np.zeros(len(u)))
        calls.append((t, points.copy()))
        current = -gates["w"]
        gates["w"] += step * u
        return current

    problem = Diffusion(source=0.0, neumann={0: 0.0})
    states = list(agglo.evolve(mesh, problem, 1.0, 1.0, step, "be", reaction=reaction, tolerance=1e-10))
    assert len(states) == len(calls) == 10
    np.testing.assert_allclose([t for t, _ in calls], 0.1 * np.arange(10))
    assert all(np.array_equal(points, calls[0][1]) for _, points in calls)
    u, w = 1.0, 0.0
    for _ in range(10):
        u, w = u - step * w, w + step * u
    assert states[-1][1].integral() == pytest.approx(u, rel=1e-8)


def swinging(t: float, order: int) -> Elasticity:
    """u = cos t (x², x y), of the space of degree 2, with the force of derivatives of an order in time."""
    lame, mu = 2.0, 0.5

    def u(x: Array) -> Array:
        return np.asarray(np.cos(t) * np.stack((x[:, 0] ** 2, x[:, 0] * x[:, 1]), axis=1))

    def force(x: Array) -> Array:
        change = u(x) * (-np.tan(t) if order == 1 else -1.0)
        return np.asarray(change - np.cos(t) * np.array([2.0 * mu + 3.0 * (lame + mu), 0.0]))

    return Elasticity(lame_lambda=lame, lame_mu=mu, force=force, displacement={0: u}, exact=u)


@pytest.mark.parametrize("scheme", [*ORDERS, "newmark"])
def test_schemes_have_their_order_for_displacements(scheme: str) -> None:
    mesh, order_in_time = samples.voronoi(12, seed=2), 2 if scheme == "newmark" else 1

    def error(n: int) -> float:
        *_, (_, solution) = agglo.evolve(
            mesh, lambda t: swinging(t, order_in_time), swinging(0.0, 1).exact, 1.0, 1.0 / n, scheme,
            solver="direct", degree=2, tolerance=1e-12,
        )  # fmt: skip
        return solution.errors()["l2"]

    assert order(error) == pytest.approx(ORDERS.get(scheme, 2), abs=0.2)


def test_newmark_moves_waves_without_damping() -> None:
    """sin(√2 π t) sin πx sin πy / (√2 π) is largest after a quarter of the period, and back after a half."""
    mesh, speed = samples.squares(8), lambda x: np.sin(np.pi * x).prod(axis=1)
    half = 1.0 / np.sqrt(2.0)
    states = dict(
        agglo.evolve(
            mesh, Diffusion(source=0.0), 0.0, half, half / 40, "newmark", velocity=speed, degree=2,
            tolerance=1e-10,
        )
    )  # fmt: skip
    integrals = np.array([solution.integral() for solution in states.values()])
    exact = np.sin(np.sqrt(2.0) * np.pi * np.array(list(states))) * 4.0 / np.pi**3 / np.sqrt(2.0)
    np.testing.assert_allclose(integrals, exact, atol=2e-3 * exact.max())


def test_free_bodies_move_by_the_given_force() -> None:
    """Newton's second law: half a square of the time in each direction of the force, exactly."""
    mesh, force = samples.voronoi(300, seed=3), (1.0, -2.0)
    free = Elasticity(young=1e3, force=force, traction={0: (0.0, 0.0)})
    *_, (t, state) = agglo.evolve(mesh, free, 0.0, 0.5, 0.1, "newmark", tolerance=1e-10)
    np.testing.assert_allclose(state.integral(), 0.5 * t**2 * np.array(force), rtol=1e-7)


@pytest.mark.parametrize("scheme", ORDERS)
def test_multigrid_takes_the_steps_of_a_direct_solver(scheme: str) -> None:
    mesh = samples.voronoi(250, seed=4)
    problem = Diffusion(kappa=np.linspace(0.1, 1.0, 250), source=lambda x: x[:, 0], dirichlet={0: 1.0})
    found = [
        list(agglo.evolve(mesh, problem, 0.0, 0.2, 0.02, scheme, solver=solver, degree=2, tolerance=1e-9))
        for solver in ("polydg_mg", ("direct", {"penalty": "sharp", "scaled_basis": True}))
    ]
    assert len(found[0]) == len(found[1]) == 10
    for (_, one), (_, other) in zip(*found, strict=True):
        np.testing.assert_allclose(one.x, other.x, atol=1e-6 * np.abs(other.x).max())


def test_matrices_are_assembled_and_factorised_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    original = assembly._matrix_and_penalty

    def counted(*arguments: object) -> object:
        made.append(1)
        return original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(assembly, "_matrix_and_penalty", counted)
    mesh, cells = samples.voronoi(60, seed=5), np.ones(60)
    constant = Diffusion(kappa=lambda x: 1.0 + x[:, 0])
    for problem, scheme, expected in (
        (constant, "cn", 1),
        (constant, "bdf2", 2),
        (lambda t: Diffusion(kappa=cells, source=t, dirichlet={0: t}), "cn", 1),
        (lambda t: Diffusion(kappa=(1.0 + t) * cells, source=t), "be", 5),
        (lambda t: Diffusion(kappa=lambda x: 1.0 + x[:, 0], source=t), "be", 5),
    ):
        made.clear()
        for _ in agglo.evolve(mesh, problem, 0.0, 0.5, 0.1, scheme):
            pass
        assert len(made) == expected
    steps = Direct().repeated(bare(mesh))
    for source in (1.0, 2.0):
        assert steps.solve(Diffusion(source=source)).converged
    assert steps.solve_again(np.ones(180)).converged
    assert steps.setups == 1
    assert steps.solve(Diffusion(kappa=2.0)).converged
    assert steps.setups == 2


def test_a_tensor_with_new_boundary_values_is_solved_as_afresh() -> None:
    mesh, kappa = samples.voronoi(60, seed=8), np.array([[2.0, 0.9], [0.9, 0.5]])
    solver, hierarchy = PolyDGMultigrid(tolerance=1e-10), bare(mesh)
    steps = solver.repeated(hierarchy)
    for k in range(3):
        problem = Diffusion(kappa=kappa, dirichlet={0: lambda x, k=k: np.cos(k + x[:, 0])})
        kept, fresh = steps.solve(problem), solver.solve(problem, hierarchy)
        np.testing.assert_allclose(kept.b, fresh.b, atol=1e-12 * np.abs(fresh.b).max())
        np.testing.assert_allclose(kept.x, fresh.x, atol=1e-7)


def test_convection_keeps_its_matrix_over_steps() -> None:
    mesh = samples.voronoi(60, seed=9)
    for solver in (Direct(), Direct(degree=2)):
        steps = solver.repeated(bare(mesh))
        for k in range(3):
            problem = Diffusion(convection=(3.0, 1.0), source=1.0 + k, dirichlet={0: 1.0 * k})
            kept, fresh = steps.solve(problem), solver.solve(problem, bare(mesh))
            assert kept.converged
            np.testing.assert_allclose(kept.x, fresh.x, atol=1e-9)
        assert steps.setups == 1
        assert kept.fluxes()[mesh.outer_faces].sum() == pytest.approx(3.0, rel=1e-8)
    states = list(agglo.evolve(mesh, problem, 0.0, 0.3, 0.1, solver="direct"))
    assert states[-1][1].converged


@pytest.mark.parametrize("mesh", [samples.voronoi(40, seed=7), samples.tetrahedra(2)], ids=["2-D", "3-D"])
def test_the_norm_of_the_jump_operator_is_that_of_the_sums(mesh: Mesh) -> None:
    """For new data on the old norm, too."""
    penalty, rng = "sharp", np.random.default_rng(2)
    for kappa in (np.linspace(1.0, 9.0, mesh.n_cells), lambda x: 1.0 + x[:, 0]):
        of = [Diffusion(kappa=kappa, dirichlet={0: lambda x, k=k: np.cos(k * x[:, 0])}) for k in (2, 3)]
        old = EnergyNorm(PolyDG(2).basis(mesh), of[0], penalty)
        x = rng.standard_normal(old.basis.n)
        for norm, problem in ((old, of[0]), (old.with_data(of[1]), of[1])):
            sums = EnergyNorm(old.basis, problem, penalty)
            vars(sums)["_operators"] = None  # as on large meshes
            assert norm(x) == pytest.approx(sums(x), rel=1e-12)


def test_coefficients_altered_in_place_are_noticed() -> None:
    mesh, kappa = samples.voronoi(60, seed=6), np.ones(60)
    problem = Diffusion(kappa=kappa)
    for solver in (PolyDGMultigrid(), Direct()):
        kappa[:] = 1.0
        steps = solver.repeated(bare(mesh))
        first = steps.solve(problem).x.max()
        kappa[:] = 4.0
        assert steps.solve(problem).x.max() == pytest.approx(first / 4.0, rel=1e-4)


@pytest.mark.parametrize("n", [300, 6000])
def test_a_load_is_added_in_the_users_numbering(n: int) -> None:
    """The larger mesh is renumbered for the solve."""
    mesh = samples.random_triangles(n, seed=1)
    mesh = mesh.renumbered(np.random.default_rng(0).permutation(mesh.n_cells))
    assert (numbering_for(bare(mesh)).cells is not None) == (n > 1000)
    problem = Diffusion(reaction=1.0, source=2.0, dirichlet={0: 1.0})
    load = np.random.default_rng(1).standard_normal(3 * mesh.n_cells)
    steps = PolyDGMultigrid(tolerance=1e-9).repeated(bare(mesh))
    system = PolyDG().assemble(problem, mesh)
    for solution, own in ((steps.solve(problem, load=load), load), (steps.solve_again(-load), -load)):
        assert solution.converged
        expected = spsolve(system.A.tocsc(), system.b + own)
        np.testing.assert_allclose(solution.x, expected, atol=1e-6 * np.abs(expected).max())
        np.testing.assert_allclose(solution.b, system.b + own, atol=1e-9 * np.abs(system.b).max())


def test_an_evolution_continues_from_a_solution() -> None:
    mesh, problem = samples.squares(4), Diffusion()
    whole = list(agglo.evolve(mesh, problem, 0.0, 0.4, 0.1, "be", tolerance=1e-11))
    half = list(agglo.evolve(mesh, problem, 0.0, 0.2, 0.1, "be", tolerance=1e-11))
    rest = list(agglo.evolve(mesh, problem, half[-1][1], 0.2, 0.1, "be", tolerance=1e-11))
    np.testing.assert_allclose(rest[-1][1].x, whole[-1][1].x, atol=1e-9)
    times = [t for t, _ in agglo.evolve(mesh, problem, 0.0, 1.0, 0.3, "be")]
    np.testing.assert_allclose(times, [0.25, 0.5, 0.75, 1.0])


class Bare:
    """A solver without repeated solves."""

    def solve(self, problem: object, hierarchy: object) -> None: ...


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scheme": "rk4"}, "scheme must be one of be, cn, bdf2, newmark; given 'rk4'"),
        ({"step": 0.0}, "step must be a positive number, given 0.0"),
        ({"t_end": np.nan}, "t_end must be a positive number, given nan"),
        ({"problem": Linear(np.eye(16), np.ones(16))}, "problem must be a Diffusion or an Elasticity"),
        ({"reaction": lambda t, x, u: u[:3]}, "reaction must return"),
        ({"reaction": lambda t, x, u: np.full(len(u), np.inf)}, "reaction must return"),
        ({"velocity": 1.0}, "velocity is for the scheme newmark, not for 'cn'"),
        ({"problem": Elasticity(), "reaction": lambda t, x, u: u}, "no discretisation with quadrature"),
        ({"solver": Bare()}, "no method repeated"),
        ({"max_iterations": 1, "tolerance": 1e-12}, r"step 1, to t = 0.1, did not converge"),
        ({"on": 3}, "evolve expects a Mesh or a Hierarchy first, given 3"),
    ],
)
def test_bad_arguments_are_refused(given: dict[str, object], message: str) -> None:
    asked = {"on": samples.squares(4), "problem": Diffusion(), "u0": 0.0, "t_end": 1.0, "step": 0.1} | given
    with pytest.raises(OptionError, match=message):
        next(agglo.evolve(**asked))  # type: ignore[arg-type]


def test_loads_without_a_discretised_problem_are_refused() -> None:
    mesh = samples.squares(2)
    linear = Linear(np.diag([1.0, 2.0, 3.0, 4.0]), np.ones(4))
    for solver in (PolyDGMultigrid(), Direct()):
        steps = solver.repeated(bare(mesh))
        with pytest.raises(OptionError, match="call solve first"):
            steps.solve_again(np.ones(4))
        with pytest.raises(OptionError, match="only to discretised problems"):
            steps.solve(linear, load=np.ones(4))
        with pytest.raises(OptionError, match="unique only up to a constant"):
            steps.solve(Diffusion(source=0.0, neumann={0: 0.0}), load=np.ones(12))
        with pytest.raises(OptionError, match="load must contain"):
            steps.solve(Diffusion(), load=np.ones(5))
