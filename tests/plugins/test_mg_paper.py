"""The paper's solver: its switches, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core import AggloError, Hierarchy, Mesh, MeshError, OptionError, agglomerate, samples
from agglo_core.arrays import trusted_copy
from agglo_core.multigrid import block_inverses
from agglo_core.problems import Diffusion, Linear, MultigridLevel
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.paper.schwarz import Smooth, Solve
from agglo_polydg_mg.plain_cg import PlainCG

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def voronoi() -> Hierarchy:
    """Three coarse levels of the paper's Voronoi grid."""
    return agglomerate(samples.paper("voronoi"), bisector="kmeans", h_star=[0.177, 0.354, 0.708])


@pytest.mark.parametrize(
    "solver",
    [
        PaperMultigrid(tolerance=1e-9),
        PaperMultigrid(degree=2, tolerance=1e-9, levels=3),
        PaperMultigrid(tolerance=1e-9, operators="inherited"),
        PaperMultigrid(tolerance=1e-9, smoother="block_jacobi", max_iterations=5000),
        PaperMultigrid(tolerance=1e-9, schwarz_coarse=False),
        PaperMultigrid(tolerance=1e-9, scaled_basis=True, coarse_solver="dense"),
        PaperMultigrid(tolerance=1e-9, penalty=4.0, smoothing_steps=5),
    ],
    ids=["paper", "degree 2", "inherited", "jacobi", "one level", "scaled, dense", "penalty"],
)
def test_every_switch_solves_the_same_system(solver: PaperMultigrid, voronoi: Hierarchy) -> None:
    solution = solver.solve(Diffusion(), voronoi)
    assert solution.converged
    assert solution.reason == "tolerance met"
    direct = spsolve(sparse.csc_array(solution.A), solution.b)
    assert np.linalg.norm(solution.x - direct) < 1e-6 * np.linalg.norm(direct)
    assert len(solution.operators) == (solver.levels or 4)
    assert set(solution.seconds) == {"assemble", "setup", "solve"}


def test_custom_smoother_and_coarse_solver(voronoi: Hierarchy) -> None:
    """Richardson steps on the Schwarz preconditioner, a solve by the inverse."""

    def richardson(level: MultigridLevel) -> Smooth:
        local, coarse = block_inverses(level.inherited, level.block_offsets), level.coarse
        assert coarse is not None

        def smooth(b: Array, x: Array) -> Array:
            for _ in range(level.steps):
                r = b - level.A @ x
                x = x + 0.2 * (local @ r + coarse(r))
            return x

        return smooth

    def inverse(A: sparse.sparray) -> Solve:
        inverted = np.linalg.inv(A.toarray())
        return lambda b: inverted @ b

    own = PaperMultigrid(smoother=richardson, coarse_solver=inverse).solve(Diffusion(), voronoi)
    named = PaperMultigrid(coarse_solver="dense").solve(Diffusion(), voronoi)
    assert own.converged
    assert own.iterations > named.iterations
    assert np.linalg.norm(own.x - named.x) < 1e-3 * np.linalg.norm(named.x)


def test_inherited_matrices_are_galerkin_and_anew_ones_are_not(voronoi: Hierarchy) -> None:
    for kind, inherits in (("inherited", True), ("rediscretised", False)):
        (A, P), (coarse, _) = PaperMultigrid(operators=kind).solve(Diffusion(), voronoi).operators[:2]
        gap = abs(P.T @ A @ P - coarse).max() / abs(coarse).max()
        assert bool(gap < 1e-12) is inherits


def test_scaling_the_basis_changes_neither_solution_nor_energy(voronoi: Hierarchy) -> None:
    plain, scaled = (
        PaperMultigrid(tolerance=1e-10, scaled_basis=each).solve(Diffusion(), voronoi)
        for each in (False, True)
    )
    assert plain.b @ plain.x == pytest.approx(scaled.b @ scaled.x, rel=1e-9)
    assert np.linalg.norm(plain.b) != pytest.approx(np.linalg.norm(scaled.b))


def test_levels_that_do_not_nest_are_served(voronoi: Hierarchy) -> None:
    x, y = voronoi.graph.centroids.T
    levels = [voronoi.levels[0], (x > 0).astype(int) + 2 * (y > 0), (x + y > 0.1).astype(int)]
    crossed = replace(voronoi, levels=levels, nested=False)
    solution = PaperMultigrid().solve(Diffusion(), crossed)
    assert solution.converged
    linear = Linear(solution.A, solution.b, np.arange(voronoi.graph.n + 1) * 3)
    assert PaperMultigrid(tolerance=1e-8).solve(linear, crossed).converged


@pytest.mark.parametrize("nested", [True, False])
@pytest.mark.parametrize("degree", [1, 3])
def test_agglomerates_in_pieces_with_holes_and_pinch_vertices(degree: int, nested: bool) -> None:
    mesh, random = samples.voronoi(150, seed=1), np.random.default_rng(0)
    fine = random.permutation(150) % 30
    coarse = fine % 6 if nested else random.permutation(150) % 6
    hierarchy = Hierarchy(mesh, mesh.graph, [fine, coarse], [{}, {}], nested)
    solution = PaperMultigrid(degree, tolerance=1e-9).solve(Diffusion(), hierarchy)
    assert solution.converged
    direct = spsolve(sparse.csc_array(solution.A), solution.b)
    assert np.linalg.norm(solution.x - direct) < 1e-6 * np.linalg.norm(direct)


@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_jumps_of_the_coefficient_are_solved(ratio: float) -> None:
    mesh = samples.squares(16)
    kappa = np.where(mesh.cell_centroids[:, 0] < 0.5, 1.0, ratio)
    hierarchy = agglomerate(mesh, n_parts=(64, 16))
    for field in (kappa, lambda x: np.where(x[:, 0] < 0.5, 1.0, ratio)):
        solution = PaperMultigrid(tolerance=1e-9).solve(Diffusion(kappa=field), hierarchy)
        assert solution.converged
        direct = spsolve(sparse.csc_array(solution.A), solution.b)
        assert np.linalg.norm(solution.x - direct) < 1e-5 * np.linalg.norm(direct)


def with_sides(mesh: Mesh) -> Mesh:
    """Boundary tags 1 at x = 0, 2 at x = 1, 0 elsewhere."""
    ends = mesh.points[mesh.face_pairs][:, :, 0]
    sides = (np.abs(ends) < 1e-12).all(axis=1) + 2 * (np.abs(ends - 1) < 1e-12).all(axis=1)
    return replace(mesh, face_tags={"boundary": sides.astype(int)})


@pytest.mark.parametrize("solver", [PaperMultigrid(), PlainCG()])
@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_a_jump_of_the_coefficient_hides_no_error_beside_dirichlet_data(
    ratio: float, solver: PaperMultigrid | PlainCG
) -> None:
    """u = 0 and 1 on two sides: what the data put into b at large κ is far above all that counts at small."""
    mesh = with_sides(samples.squares(16))
    kappa = np.where(mesh.cell_centroids[:, 0] < 0.5, 1.0, ratio)
    hierarchy = agglomerate(mesh, n_parts=(64, 16))
    for field in (kappa, lambda x: np.where(x[:, 0] < 0.5, 1.0, ratio)):
        problem = Diffusion(kappa=field, source=0.0, dirichlet={1: 0.0, 2: 1.0})
        solution = solver.solve(problem, hierarchy)
        assert solution.converged
        mean = 1 / (0.5 + 0.5 / ratio)
        exact = solver.discretisation.basis(mesh).project(
            lambda x, mean=mean: np.where(x[:, 0] < 0.5, mean * x[:, 0], 1 - mean / ratio * (1 - x[:, 0]))
        )
        assert np.linalg.norm(solution.x - exact) < 1e-5 * np.linalg.norm(exact)


@pytest.mark.parametrize(
    "solver", [PaperMultigrid(), PaperMultigrid(smoother="block_jacobi", max_iterations=300)]
)
def test_a_wrong_value_of_an_island_is_not_called_converged(solver: PaperMultigrid) -> None:
    """A strip at u = 1 and an island, both of large κ: the value of the island hangs on what lies between."""
    mesh = with_sides(samples.squares(16))
    middle = mesh.cell_centroids
    stiff = (np.abs(middle - 0.5).max(axis=1) < 0.2) | (middle[:, 0] < 0.15)
    problem = Diffusion(np.where(stiff, 1e6, 1.0), source=0.0, dirichlet={1: 1.0, 2: 0.0})
    solution = solver.solve(problem, agglomerate(mesh, n_parts=(64, 16)))
    direct = spsolve(sparse.csc_array(solution.A), solution.b)
    right = np.linalg.norm(solution.x - direct) < 1e-5 * np.linalg.norm(direct)
    assert solution.converged == right
    assert right or solver.max_iterations == 300  # what does not get there says so


@pytest.mark.parametrize("operators", ["rediscretised", "inherited"])
def test_boundary_data_by_tag(operators: Literal["rediscretised", "inherited"]) -> None:
    """u = 1 + x between held sides; the flux of κ = 2 leaves on the right; top and bottom are insulated."""
    tagged = with_sides(samples.voronoi(80, seed=2))
    hierarchy = agglomerate(tagged, n_parts=(20, 5))
    problem = Diffusion(kappa=2.0, source=0.0, dirichlet={1: 1.0}, neumann={2: 2.0})
    solver = PaperMultigrid(tolerance=1e-10, operators=operators)
    solution = solver.solve(problem, hierarchy)
    assert solution.converged
    exact = solver.discretisation.basis(tagged).project(lambda x: 1.0 + x[:, 0])
    assert solution.x == pytest.approx(exact, abs=1e-7)


def test_a_coarse_mesh_of_one_cell_and_a_mesh_of_one_cell() -> None:
    mesh = samples.squares(4)
    whole = agglomerate(mesh, n_parts=(4, 1))
    assert PaperMultigrid(degree=2).solve(Diffusion(), whole).converged
    single = samples.squares(1)
    alone = agglomerate(single, n_parts=1)
    solution = PaperMultigrid().solve(Diffusion(), alone)
    assert (solution.converged, solution.iterations, len(solution.operators)) == (True, 1, 1)


def test_what_is_not_reached_is_flagged(voronoi: Hierarchy) -> None:
    solution = PaperMultigrid(max_iterations=2).solve(Diffusion(), voronoi)
    assert not solution.converged
    assert solution.iterations == 2
    assert "after 2 iterations" in solution.reason


@pytest.mark.parametrize("smoother", ["schwarz", "block_jacobi"])
def test_an_indefinite_matrix_is_flagged(smoother: str, voronoi: Hierarchy) -> None:
    n = voronoi.graph.n
    A = sparse.diags_array(np.where(np.arange(n) % 2, 1.0, -1.0)).tocsr()
    problem = Linear(A, np.ones(n), np.arange(n + 1))
    solution = PaperMultigrid(smoother=smoother, max_iterations=50).solve(problem, voronoi)
    assert not solution.converged
    assert solution.reason


BAD_PROBLEMS: dict[str, tuple[Callable[[int], object], str]] = {
    "cells": (lambda n: Linear(sparse.eye_array(3), np.ones(3), np.arange(4)), "unknowns in 3 cells"),
    "unequal": (
        lambda n: Linear(sparse.eye_array(n + 1), np.ones(n + 1), np.r_[0, np.arange(n) + 2]),
        "same number of unknowns; given 1 to 2",
    ),
    "shape": (lambda n: Linear(sparse.eye_array(n), np.ones(n - 1), np.arange(n + 1)), "A has shape"),
    "nan": (lambda n: Linear(sparse.eye_array(n), np.full(n, np.nan), np.arange(n + 1)), "not finite"),
    "kappa of another mesh": (lambda n: Diffusion(kappa=np.ones(n + 1)), "kappa"),
    "negative kappa": (lambda n: Diffusion(kappa=-1.0), "kappa must be positive"),
    "nan kappa": (lambda n: Diffusion(kappa=np.full(n, np.nan)), "kappa"),
    "infinite kappa": (lambda n: Diffusion(kappa=np.inf), "kappa must be finite: it is inf"),
    "infinite source": (
        lambda n: Diffusion(source=np.full(n, np.inf)),
        "source must be finite: it is inf in cell 0",
    ),
    "nan on the boundary": (
        lambda n: Diffusion(dirichlet={0: np.nan}),
        "dirichlet of tag 0 must be finite: it is nan",
    ),
    "pure Neumann": (lambda n: Diffusion(neumann={0: 0.0}), "must balance; they integrate to 1"),
    "neither": (lambda n: "sine", "a Diffusion or a Linear, given str"),
}


@pytest.mark.parametrize("name", BAD_PROBLEMS)
@pytest.mark.parametrize("solver", [PaperMultigrid, PlainCG])
def test_problems_that_do_not_fit_are_refused(name: str, solver: Callable, voronoi: Hierarchy) -> None:
    make, message = BAD_PROBLEMS[name]
    with pytest.raises(AggloError, match=message):
        solver().solve(make(voronoi.graph.n), voronoi)


@pytest.mark.parametrize("solver", [PaperMultigrid(), PlainCG()])
def test_a_hierarchy_of_another_mesh_is_refused(solver: PaperMultigrid | PlainCG) -> None:
    mesh = samples.squares(4)
    hierarchy = agglomerate(mesh, n_parts=4)
    larger = trusted_copy(hierarchy, fine=samples.squares(5))
    with pytest.raises(OptionError, match=r"another mesh: its levels have 16 cells, but Mesh\(.*has 25"):
        solver.solve(Diffusion(), larger)
    other = replace(hierarchy, fine=replace(mesh, points=2.0 * mesh.points))
    with pytest.raises(OptionError, match=r"another mesh: cell 0 has measure 0.0625 in its graph, but 0.25"):
        solver.solve(Diffusion(), other)


def test_an_agglomerate_that_overlaps_itself_is_named_by_its_level() -> None:
    """Two squares that overlap: each is valid, their union is not; inherited matrices need no triangles."""
    points = [[0, 0], [2, 0], [2, 2], [0, 2], [1, -0.5], [3, -0.5], [3, 2.5], [1, 2.5]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [4, 5, 6, 7]])
    hierarchy = Hierarchy(mesh, mesh.graph, [np.zeros(2, int)], [{}], nested=True)
    said = (
        r"on the level with 1 agglomerates: no simplex on face 0 .* overlap themselves.*operators='inherited'"
    )
    with pytest.raises(MeshError, match=said):
        PaperMultigrid().solve(Diffusion(), hierarchy)
    assert PaperMultigrid(operators="inherited").solve(Diffusion(), hierarchy).converged


def test_a_bare_graph_has_no_diffusion_problem() -> None:
    hierarchy = agglomerate(samples.squares(4).graph, n_parts=4)
    with pytest.raises(OptionError, match="belongs to a graph without a mesh"):
        PaperMultigrid().solve(Diffusion(), hierarchy)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"degree": 0}, r"degree must be a whole number, 1\.\.6; given 0"),
        ({"degree": 9}, r"1\.\.6; given 9"),
        ({"smoothing_steps": 0}, "at least 1; given 0"),
        ({"smoothing_steps": True}, "given True"),
        ({"levels": 1}, "at least 2; given 1"),
        ({"degree": 2.0}, r"whole number, 1\.\.6; given 2.0"),
        ({"degree": "2"}, "given '2'"),
        ({"tolerance": 0.0}, "between 0 and 1; given 0.0"),
        ({"tolerance": float("nan")}, "between 0 and 1; given nan"),
        ({"tolerance": "small"}, "between 0 and 1; given 'small'"),
        ({"max_iterations": 0}, "max_iterations must be a whole number, at least 1; given 0"),
        ({"penalty": float("nan")}, "penalty must be a positive number; given nan"),
        ({"penalty": -10.0}, "penalty must be a positive number; given -10.0"),
        ({"penalty": None}, "penalty must be a positive number; given None"),
        ({"scaled_basis": 1}, "scaled_basis must be true or false; given 1"),
        ({"schwarz_coarse": "maybe"}, "schwarz_coarse must be true or false; given 'maybe'"),
        ({"operators": "galerkin"}, "one of rediscretised, inherited; given 'galerkin'"),
        (
            {"smoother": "jacobi"},
            "one of schwarz, block_jacobi, chebyshev, gauss_seidel, vertex_patches; given 'jacobi'",
        ),
        ({"coarse_solver": "cg"}, "coarse_solver must be one of elimination, dense, lu; given 'cg'"),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        PaperMultigrid(**options)  # type: ignore[arg-type]


def test_more_levels_than_there_are_is_an_error(voronoi: Hierarchy) -> None:
    with pytest.raises(OptionError, match=r"levels must lie in 2\.\.4"):
        PaperMultigrid(levels=5).solve(Diffusion(), voronoi)
