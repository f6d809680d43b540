"""Estimators: effectivity for all coefficients and boundary data, units, and refused solutions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from random_diffusion import with_four_sides

import agglo_core as agglo
from agglo_core import Diffusion, Mesh, OptionError, Solution, samples
from agglo_core.adaptivity.estimators import GradientJump, Residual
from agglo_polydg_mg.hierarchical import Hierarchical
from agglo_polydg_mg.polydg import PolyDG

Array = NDArray[np.float64]


def exact(x: Array) -> Array:
    return np.asarray(np.sin(3.0 * x[:, 0]) * np.exp(x[:, 1]) + (x[:, 2] ** 2 if x.shape[1] == 3 else 0.0))


def slope(x: Array) -> Array:
    first = 3.0 * np.cos(3.0 * x[:, 0]) * np.exp(x[:, 1])
    second = np.sin(3.0 * x[:, 0]) * np.exp(x[:, 1])
    return np.stack([first, second, *([2.0 * x[:, 2]] if x.shape[1] == 3 else [])], axis=1)


def growing(x: Array) -> Array:
    return np.asarray(1.0 + x[:, 0])


def full_tensor(x: Array) -> Array:
    return np.asarray(np.eye(2) + 0.8 * x[:, 1, None, None] * np.array([[1.0, -0.9], [-0.9, 1.0]]))


COEFFICIENTS = {
    "number": Diffusion(kappa=7.0),
    "function": Diffusion(kappa=growing),
    "tensor": Diffusion(kappa=full_tensor),
    "weak reaction": Diffusion(reaction=1.0),
    "strong reaction": Diffusion(reaction=1e4),
    "convection": Diffusion(convection=[5.0, 0.0]),
}


def posed(coefficients: Diffusion, normals: bool = False) -> Diffusion:
    """Problem with the solution ``exact``, by Dirichlet data, or fluxes and Robin data on two sides."""

    def flux(x: Array) -> Array:
        kappa = coefficients.kappa(x) if callable(coefficients.kappa) else coefficients.kappa
        return (
            np.einsum("qij,qj->qi", kappa, slope(x))
            if np.ndim(kappa) == 3
            else np.reshape(kappa, (-1, 1)) * slope(x)
        )

    def source(x: Array) -> Array:
        total, h = (
            coefficients.reaction * exact(x)
            + slope(x) @ np.broadcast_to(coefficients.convection, x.shape[1]),
            1e-3,
        )
        for axis, step in enumerate(h * np.eye(x.shape[1])):
            first, second = (flux(x + k * step)[:, axis] - flux(x - k * step)[:, axis] for k in (1, 2))
            total = total - (8.0 * first - second) / (12.0 * h)
        return np.asarray(total)

    data = dict.fromkeys((1, 2, 3, 4), exact) if normals else {0: exact}
    problem = replace(coefficients, source=source, dirichlet=data, exact=exact)
    if not normals:
        return problem
    return replace(
        problem,
        dirichlet=dict.fromkeys((1, 2), exact),
        neumann={3: lambda x: -flux(x)[:, 1]},
        robin={4: (2.0, lambda x: 2.0 * exact(x) + flux(x)[:, 1])},
    )


def solved(mesh: Mesh, problem: Diffusion, degree: int = 1) -> Solution:
    return agglo.solve(mesh, problem, degree=degree, tolerance=1e-9)


def index(estimator: Residual | Hierarchical, solution: Solution) -> float:
    """Effectivity index: estimate over the true error in the DG norm."""
    return float(np.linalg.norm(estimator.indicate(solution)) / solution.errors()["dg"])


@cache
def agglomerates() -> Mesh:
    mesh = samples.random_triangles(600, seed=5)
    return mesh.coarsen(agglo.agglomerate(mesh, cells_per_part=8).levels[0])


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", [name for name in COEFFICIENTS if name != "convection"])
def test_the_residual_estimate_of_virtual_elements_is_near_the_error(name: str, degree: int) -> None:
    for mesh in (samples.voronoi(120, seed=4), agglomerates()):
        solution = agglo.solve(
            mesh, posed(COEFFICIENTS[name]), degree=degree, discretisation="vem", tolerance=1e-9
        )
        assert 1.0 < energy_index(Residual(), solution) < 4.0


def test_the_index_of_virtual_elements_in_3d_and_with_fluxes() -> None:
    solids = [samples.random_tetrahedra(60, seed=2), samples.voronoi3d(60, seed=1)]
    plate = with_four_sides(samples.voronoi(120, seed=6))
    for mesh in (*solids, solids[1].coarsen(agglo.agglomerate(solids[1], cells_per_part=6).levels[0]), plate):
        problem = posed(COEFFICIENTS["number"], normals=mesh is plate)
        solution = agglo.solve(mesh, problem, discretisation="vem", tolerance=1e-9)
        assert 1.0 < energy_index(Residual(), solution) < 4.0
        assert 0.5 < energy_index(GradientJump(), solution) < 4.0


def energy_index(estimator: Residual, solution: Solution) -> float:
    """Effectivity index in the energy norm, which contains the reaction."""
    errors, problem = solution.errors(), solution.problem
    error = np.hypot(errors["energy"], np.sqrt(problem.reaction) * errors["l2"])
    return float(np.linalg.norm(estimator.indicate(solution)) / error)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("name", COEFFICIENTS)
def test_the_residual_estimate_is_near_the_error(name: str, degree: int) -> None:
    for mesh in (samples.voronoi(120, seed=4), agglomerates()):
        assert 1.0 < index(Residual(), solved(mesh, posed(COEFFICIENTS[name]), degree)) < 3.5


@pytest.mark.parametrize("name", ["number", "tensor"])
def test_neumann_and_robin_data_count_as_fluxes(name: str) -> None:
    mesh = with_four_sides(samples.voronoi(120, seed=6))
    solution = solved(mesh, posed(COEFFICIENTS[name], normals=True), 2)
    assert 1.0 < index(Residual(), solution) < 3.0
    wrong = replace(solution, problem=replace(solution.problem, neumann={3: 0.0}))
    beside = mesh.face_cells[mesh.face_tags["boundary"] == 3, 0]
    before, after = (Residual().terms(each)["flux"][beside] for each in (solution, wrong))
    assert after.sum() > 10.0 * before.sum()


def test_a_jump_of_kappa_leaves_the_index_unchanged() -> None:
    mesh = samples.squares(12)
    left = mesh.cell_centroids[:, 0] < 0.5
    for contrast in (1.0, 1e3, 1e6):
        # κ u' is continuous at x = 1/2
        def u(x: Array, contrast: float = contrast) -> Array:
            s = x[:, 0] - 0.5
            return np.asarray(np.sin(s) * np.where(s < 0.0, 1.0, 1.0 / contrast))

        problem = Diffusion(np.where(left, 1.0, contrast), lambda x: np.sin(x[:, 0] - 0.5), {0: u}, exact=u)
        assert 1.0 < index(Residual(), solved(mesh, problem)) < 3.0


def test_the_index_in_3d() -> None:
    for mesh in (samples.random_tetrahedra(60, seed=2), samples.boxes(4)):
        coarse = mesh.coarsen(agglo.agglomerate(mesh, cells_per_part=6).levels[0])
        for degree in (1, 2):
            for on in (mesh, coarse):
                assert 0.7 < index(Residual(), solved(on, posed(Diffusion()), degree)) < 4.0


@pytest.mark.parametrize("estimator", [GradientJump(), Hierarchical()])
def test_the_other_estimates_are_of_the_size_of_the_error(estimator: Residual | Hierarchical) -> None:
    for name in ("number", "tensor", "convection"):
        assert 0.4 < index(estimator, solved(agglomerates(), posed(COEFFICIENTS[name]), 2)) < 4.0


@pytest.mark.parametrize("how", ["polydg", "vem"])
def test_gradient_jump_is_the_residual_without_cells(how: str) -> None:
    problem = Diffusion(kappa=growing, source=growing, reaction=growing)
    solution = agglo.solve(agglomerates(), problem, discretisation=how)
    terms = {name: values for name, values in Residual().terms(solution).items() if name in ("flux", "jump")}
    found = GradientJump().terms(solution)
    assert not {"cell", "oscillation"} & set(found)
    for name, values in terms.items():
        np.testing.assert_array_equal(found[name], values)


def test_the_indicators_scale_with_the_data() -> None:
    mesh = samples.voronoi(60, seed=2)
    values = Residual().indicate(solved(mesh, Diffusion(source=1.0)))
    for factor in (1e-200, 1e5, 1e200):
        larger = Residual().indicate(solved(mesh, Diffusion(source=factor)))
        np.testing.assert_allclose(larger / factor, values, rtol=1e-6)
    # Units of length and coefficient: the energy of κ = 4 and source 4 is 4 times that of 1 and 1
    np.testing.assert_allclose(
        Residual().indicate(solved(mesh, Diffusion(4.0, 4.0))), 2.0 * values, rtol=1e-6
    )


def test_oscillation_is_what_no_polynomial_represents() -> None:
    mesh = samples.squares(6)
    assert (
        Residual().terms(solved(mesh, Diffusion(source=lambda x: 1.0 + x[:, 0])))["oscillation"].max() < 1e-10
    )
    rough = Residual().terms(solved(mesh, Diffusion(source=lambda x: np.sign(np.sin(60.0 * x[:, 0])))))
    assert rough["oscillation"].min() > 0.5 * rough["cell"].min() > 0.0
    assert (rough["oscillation"] <= rough["cell"]).all()


def test_the_largest_indicator_is_at_the_largest_error() -> None:
    def peak(x: Array) -> Array:
        return np.asarray(np.exp(-200.0 * ((x - 0.3) ** 2).sum(axis=1)))

    def source(x: Array) -> Array:
        r = ((x - 0.3) ** 2).sum(axis=1)
        return np.asarray(-(400.0**2 * r - 800.0) * peak(x))

    mesh = samples.voronoi(400, seed=8)
    values = Residual().indicate(solved(mesh, Diffusion(source=source, dirichlet={0: peak}, exact=peak)))
    assert np.linalg.norm(mesh.cell_centroids[values.argmax()] - 0.3) < 0.15


def test_other_solutions_are_refused() -> None:
    mesh = samples.squares(4)
    bent = agglo.solve(mesh, agglo.Elasticity(), "direct", degree=1)
    for estimator in (Residual(), Hierarchical()):
        with pytest.raises(OptionError, match="given a solution of Elasticity by PolyDGElasticity"):
            estimator.indicate(bent)
    with pytest.raises(OptionError, match="given a solution of Diffusion by VirtualElements"):
        Hierarchical().indicate(agglo.solve(mesh, Diffusion(), discretisation="vem"))
    with pytest.raises(OptionError, match="6 is the largest degree"):
        Hierarchical().indicate(agglo.solve(mesh, Diffusion(), "direct", degree=6))
    with pytest.raises(OptionError, match="tolerance"):
        Hierarchical(tolerance=2.0)


def test_a_transfer_keeps_polynomials_and_the_integral() -> None:
    mesh = samples.random_triangles(300, seed=3)
    hierarchy = agglo.agglomerate(mesh, n_parts=(60, 12))
    coarse = hierarchy.cut_at(1)
    mixed = coarse.refine([0, 3, 5]).cut
    how, random = PolyDG(degree=2), np.random.default_rng(4)
    for one, other in ((coarse, mixed), (mixed, coarse), (hierarchy.cut_at(0), coarse)):
        pairs = np.unique(np.stack((one.labels, other.labels), axis=1), axis=0)
        x = how.transfer(one.mesh, how.project(one.mesh, lambda p: p[:, 0] * p[:, 1]), other.mesh, pairs)
        np.testing.assert_allclose(x, how.project(other.mesh, lambda p: p[:, 0] * p[:, 1]), atol=1e-10)
        rough = random.normal(size=len(how.project(one.mesh, 1.0)))
        moved = how.transfer(one.mesh, rough, other.mesh, pairs)
        before, after = (
            how.project(cut.mesh, 1.0) @ (how.mass(cut.mesh) @ values)
            for cut, values in ((one, rough), (other, moved))
        )
        assert after == pytest.approx(before, rel=1e-9, abs=1e-9)
    finer = how.transfer(
        coarse.mesh,
        how.project(coarse.mesh, np.sin(np.arange(12.0))),
        mixed.mesh,
        np.unique(np.stack((coarse.labels, mixed.labels), axis=1), axis=0),
    )
    centres = mesh.cell_centroids
    expected = np.sin(np.arange(12.0))[coarse.labels]
    np.testing.assert_allclose(how.evaluate(mixed.mesh, finer, centres), expected, atol=1e-8)
