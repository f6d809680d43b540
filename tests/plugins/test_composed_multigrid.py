"""The solver whose parts are chosen by name: solutions, counts, what it refuses, the paper's as a preset."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from command_line import Agglo
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu, spsolve

from agglo_core import Hierarchy, OptionError, agglomerate, samples
from agglo_core.problems import Diffusion, Linear
from agglo_core.registry import default
from agglo_polydg_mg.paper.composed_multigrid import ComposedMultigrid
from agglo_polydg_mg.paper.outer_iterations import FlexibleSteps

Array = NDArray[np.float64]


@pytest.fixture(scope="module", params=["voronoi", "random_triangles"])
def hierarchy(request: pytest.FixtureRequest) -> Hierarchy:
    """Two coarse levels."""
    mesh = getattr(samples, request.param)(300, seed=21)
    return agglomerate(mesh, bisector="coordinate", refiners=(), cells_per_part=(8, 64))


def true_error(solution) -> float:
    """Energy error relative to the solution."""
    e = solution.x - spsolve(sparse.csc_array(solution.A), solution.b)
    return float(np.sqrt((e @ (solution.A @ e)) / (solution.x @ solution.b)))


@pytest.mark.parametrize(
    ("parts", "most"),
    [
        ({}, 35),
        ({"smoother": "vertex_patches"}, 12),
        ({"smoother": "vertex_patches", "cycle": "W", "degree": 2}, 12),
        ({"transfer": "injection", "smoother": "vertex_patches"}, 18),
        ({"transfer": "injection", "coarse_operator": "rediscretised", "smoother": "vertex_patches"}, 14),
        ({"transfer": "aggregation", "smoother": "chebyshev", "coarse_solver": "lu"}, 50),
        ({"smoother": "chebyshev", "smoothing_steps": 2, "levels": 2}, 30),
        ({"cycle": "K", "outer": "flexible_cg"}, 35),
        ({"cycle": "F", "outer": "flexible_cg"}, 35),
        ({"transfer": "injection", "smoother": "schwarz", "outer": "flexible_cg"}, 70),
        ({"smoother": "vertex_patches", "outer": "stationary"}, 25),
    ],
    ids=lambda given: " ".join(map(str, given.values())) or "default" if isinstance(given, dict) else "",
)
def test_compositions_solve(parts: dict[str, object], most: int, hierarchy: Hierarchy) -> None:
    solution = ComposedMultigrid(**parts).solve(Diffusion(), hierarchy)  # type: ignore[arg-type]
    assert solution.converged
    assert solution.iterations <= most
    assert true_error(solution) <= 1e-6
    assert len(solution.operators) == parts.get("levels", 3)
    assert solution.parts[0] == hierarchy.graph.n


@pytest.mark.parametrize("transfer", ["injection", "smoothed", "aggregation"])
def test_linear_systems(transfer: str, hierarchy: Hierarchy) -> None:
    links, n = hierarchy.graph.to_scipy(), hierarchy.graph.n
    A = sparse.csr_array(sparse.diags_array(links.sum(axis=1) + 0.01) - links)
    problem = Linear(A, np.linspace(-1, 1, n), np.arange(n + 1), np.ones(n))
    bare = Hierarchy(None, hierarchy.graph, hierarchy.levels, hierarchy.targets, nested=True)
    for given in (hierarchy, bare):
        solution = ComposedMultigrid(transfer=transfer, tolerance=1e-9).solve(problem, given)
        assert solution.converged
        assert solution.iterations <= 30
        assert solution.x == pytest.approx(spsolve(sparse.csc_array(A), problem.b), abs=1e-6)
    assert ComposedMultigrid(smoother="vertex_patches").solve(problem, hierarchy).converged


def test_the_preconditioner_is_symmetric_and_positive_definite() -> None:
    small = agglomerate(samples.random_triangles(50, seed=4), n_parts=(25, 5))
    for parts in ({"cycle": "W"}, {"coarse_operator": "rediscretised", "transfer": "injection"}):
        M = ComposedMultigrid(**parts).aspreconditioner(Diffusion(), small)  # type: ignore[arg-type]
        dense = M @ np.eye(M.shape[0])
        assert np.abs(dense - dense.T).max() < 1e-9 * np.abs(dense).max()
        assert np.linalg.eigvalsh(0.5 * (dense + dense.T))[0] > 0.0


class ForwardSweep:
    """Gauss–Seidel in one direction on both sides of the correction."""

    uses_coarse = False

    def setup(self, level):
        lower = splu(sparse.csc_array(sparse.tril(level.A)), permc_spec="NATURAL", diag_pivot_thresh=0.0)
        return lambda b, x: x + lower.solve(b - level.A @ x)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"cycle": "F"}, "cannot use the F-cycle, which is not symmetric: use outer=flexible_cg"),
        ({"cycle": "K"}, "cannot use the K-cycle, which is not linear: use outer=flexible_cg"),
        ({"smoother": "schwarz"}, "smoother schwarz.* is not linear: use outer=flexible_cg"),
        ({"smoother": ForwardSweep()}, "smoother ForwardSweep.* is not symmetric: use outer=flexible_cg"),
        (
            {"transfer": "aggregation", "coarse_operator": "rediscretised"},
            "rediscretised has .* unknowns on the coarse level, but the transfer .*: use",
        ),
        ({"transfer": "wavelets"}, "transfer must be one of injection, smoothed, aggregation; given 'wav"),
        ({"coarse_operator": "inherited"}, "coarse_operator must be one of galerkin, rediscretised; given"),
        ({"coarse_solver": "direct"}, "coarse_solver must be one of elimination, dense, lu; given 'direct'"),
        ({"cycle": "Z"}, "cycle must be one of V, W, F, K; given 'Z'"),
        ({"outer": "gmres"}, "outer must be one of cg, flexible_cg, stationary; given 'gmres'"),
        ({"corrections": 1}, "corrections must be true or false; given 1"),
        ({"smoothing_steps": 0}, "smoothing_steps must be a whole number, at least 1; given 0"),
    ],
)
def test_what_makes_no_sense_is_refused(parts: dict[str, object], message: str, hierarchy: Hierarchy) -> None:
    with pytest.raises(OptionError, match=message):
        ComposedMultigrid(**parts).solve(Diffusion(), hierarchy)  # type: ignore[arg-type]


def test_smoothers_refused_by_conjugate_gradients_serve_the_flexible_ones(hierarchy: Hierarchy) -> None:
    solution = ComposedMultigrid(smoother=ForwardSweep(), outer="flexible_cg").solve(Diffusion(), hierarchy)
    assert solution.converged
    assert true_error(solution) <= 1e-6


def test_rediscretised_linear_systems_are_refused(hierarchy: Hierarchy) -> None:
    n = hierarchy.graph.n
    problem = Linear(sparse.eye_array(n).tocsr(), np.ones(n), np.arange(n + 1))
    with pytest.raises(OptionError, match="use coarse_operator=galerkin"):
        ComposedMultigrid(coarse_operator="rediscretised").solve(problem, hierarchy)


def test_the_papers_solver_is_these_parts() -> None:
    mesh = samples.paper("triangles")
    levels = agglomerate(mesh, bisector="kmeans", h_star=[sqrt(2) / 8, sqrt(2) / 4, sqrt(2) / 2])
    composed = ComposedMultigrid(
        transfer="injection",
        coarse_operator="rediscretised",
        smoother="schwarz",
        coarse_solver="lu",
        outer="stationary",
        smoothing_steps=3,
        penalty="paper",
        scaled_basis=False,
    )
    ours = composed.solve(Diffusion(source=8.0), levels)
    paper = default().build("solver", "polydg_mg_paper").solve(Diffusion(source=8.0), levels)
    assert ours.iterations == paper.iterations == 9
    assert (ours.x == paper.x).all()
    assert ours.choice == paper.choice


def test_flexible_steps_with_a_fixed_preconditioner_are_conjugate_gradients() -> None:
    random = np.random.default_rng(0)
    root = random.random((12, 12))
    A, b = root @ root.T + np.eye(12), random.random(12)
    weights = 1.0 / A.diagonal()
    steps, x = FlexibleSteps(A, sparse.diags_array(weights)), np.zeros(12)
    basis = [weights * b]
    for _ in range(6):
        x = steps(b, x)
        V = np.linalg.qr(np.array(basis).T)[0]
        assert x == pytest.approx(V @ np.linalg.solve(V.T @ A @ V, V.T @ b), abs=1e-8)
        basis.append(weights * (A @ basis[-1]))
    exact = np.linalg.solve(A, b)
    assert steps(A @ exact, exact) == pytest.approx(exact, abs=1e-12)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        FlexibleSteps(-A, sparse.eye_array(12))(b, np.zeros(12))


def test_from_the_command_line(agglo: Agglo) -> None:
    parts = "transfer=aggregation,smoother=chebyshev,cycle=W,coarse_solver=lu,smoothing_steps=2"
    asked = ("--cells-per-part", "8,64", "--no-cg", "--json", "--solver", f"multigrid:{parts}")
    data = agglo("solve", "squares:n=16", *asked).data
    assert data["converged"]
    assert "transfer aggregation, coarse_operator galerkin, smoother chebyshev" in data["choice"]
    refused = agglo("solve", "squares:n=8", "--cells-per-part", "8", "--solver", "multigrid:smoother=schwarz")
    assert refused.code != 0
    assert "is not linear: use outer=flexible_cg" in " ".join(refused.err.split())
