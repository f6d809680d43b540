"""Adaptive agglomeration: fewer unknowns for the same error, ends, data by cell, and refused arguments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from random_diffusion import with_four_sides

import agglo_core as agglo
from agglo_core import Diffusion, Hierarchy, Mesh, OptionError, PluginError, samples
from agglo_core.adaptivity.marking import divisions, next_cut
from agglo_core.adaptivity.posing import PosedOnCuts

Array = NDArray[np.float64]


def front(x: Array) -> Array:
    return np.asarray(np.arctan(40.0 * (np.linalg.norm(x, axis=1) - 0.7)))


def front_source(x: Array) -> Array:
    r = np.linalg.norm(x, axis=1)
    s = 40.0 * (r - 0.7)
    return np.asarray(-((x.shape[1] - 1) * 40.0 / (r * (1 + s * s)) - 3200.0 * s / (1 + s * s) ** 2))


FRONT = Diffusion(source=front_source, dirichlet={0: front}, exact=front)


def uniform_error(hierarchy: Hierarchy, degree: int, unknowns: int) -> float:
    """Error of a uniform level with as many unknowns, interpolated between the levels."""
    solutions = [agglo.solve(hierarchy.mesh(level), FRONT, degree=degree) for level in range(len(hierarchy))]
    sizes, errors = (
        [np.log(value) for value in values]
        for values in zip(*((len(each.x), each.errors()["dg"]) for each in reversed(solutions)), strict=True)
    )
    return float(np.exp(np.interp(np.log(unknowns), sizes, errors)))


@pytest.mark.parametrize(("degree", "bound"), [(1, 0.75), (2, 0.5)])
def test_the_error_is_below_that_of_a_uniform_level_with_as_many_unknowns(degree: int, bound: float) -> None:
    mesh = samples.random_triangles(3000, seed=12)
    found = agglo.adapt(mesh, FRONT, max_unknowns=1500, degree=degree)
    last = found.steps[-1]
    assert last.unknowns == len(found.solution.x) <= 1500
    assert last.errors["dg"] < bound * uniform_error(found.hierarchy, degree, last.unknowns)
    for step in found.steps:
        assert step.converged
        assert 0.9 < step.estimate / step.errors["dg"] < 6.0
        assert step.oscillation is not None
        assert step.oscillation <= step.estimate


def test_the_tolerance_is_relative_to_the_energy_and_bounds_the_error() -> None:
    mesh = samples.voronoi(3000, seed=3)
    found = agglo.adapt(mesh, FRONT, tolerance=0.15, degree=2)
    last = found.steps[-1]
    assert found.reason == "tolerance"
    assert last.relative is not None
    assert last.relative <= 0.15
    assert [step.relative > 0.15 for step in found.steps[:-1] if step.relative] == [True] * (
        len(found.steps) - 1
    )
    assert (
        last.errors["dg"]
        <= last.estimate
        == found.estimate
        == pytest.approx(np.linalg.norm(found.indicators))
    )
    # Other units of the coefficient and the solution do not alter the steps
    other = Diffusion(1e-7, lambda x: 1e-4 * front_source(x), {0: lambda x: 1e3 * front(x)})
    again = agglo.adapt(mesh, other, tolerance=0.15, degree=2)
    assert [step.unknowns for step in again.steps] == [step.unknowns for step in found.steps]
    assert again.steps[-1].relative == pytest.approx(last.relative, rel=1e-4)
    assert not again.steps[-1].errors


@pytest.mark.parametrize("degree", [1, 2])
def test_virtual_elements_are_adapted_with_their_own_estimate(degree: int) -> None:
    mesh = samples.random_triangles(3000, seed=12)
    found = agglo.adapt(mesh, FRONT, tolerance=0.5 / degree, degree=degree, discretisation="vem")
    assert found.reason == "tolerance"
    for step in found.steps:
        assert step.converged
        assert 0.9 < step.estimate / step.errors["energy"] < 4.0
    fine = agglo.solve(mesh, FRONT, degree=degree, discretisation="vem")
    assert found.steps[-1].unknowns < 0.6 * len(fine.x)


def test_adapts_in_3d() -> None:
    mesh = samples.random_tetrahedra(1500, seed=4)
    found = agglo.adapt(mesh, FRONT, max_unknowns=1200, estimator="gradient_jump")
    sizes, errors = ([step.unknowns for step in found.steps], [step.errors["dg"] for step in found.steps])
    assert found.reason == "max_unknowns"
    assert sizes == sorted(sizes)
    assert errors[-1] < errors[0]
    near = np.abs(np.linalg.norm(found.cut.mesh.cell_centroids, axis=1) - 0.7) < 0.15
    assert found.cut.measures[near].mean() < 0.7 * found.cut.measures[~near].mean()


def test_ends_at_the_fine_mesh_or_with_the_solver() -> None:
    mesh = samples.squares(8)
    fine = agglo.adapt(mesh, FRONT, tolerance=1e-3)
    assert fine.reason == "fine mesh"
    assert "ended by fine mesh" in repr(fine)
    stopped = agglo.adapt(mesh, FRONT, tolerance=1e-3, max_iterations=1)
    assert (stopped.reason, len(stopped.steps), stopped.steps[0].converged) == ("solver", 1, False)
    only = agglo.adapt(agglo.agglomerate(mesh, n_parts=8), FRONT, max_unknowns=5)
    assert (only.reason, len(only.steps)) == ("max_unknowns", 1)


def test_parts_never_mix_coefficients_given_by_cell() -> None:
    mesh = samples.squares(16)
    kappa = np.where(np.abs(mesh.cell_centroids[:, 0] - 0.5) < 0.2, 1e4, 1.0)
    problem = Diffusion(kappa, 1.0)
    crossing = agglo.agglomerate(mesh, n_parts=(40, 9))
    for on in (mesh, crossing):
        found = agglo.adapt(on, problem, tolerance=0.6)
        least, most = (operation(found.cut.n_parts, found.cut.labels, kappa) for operation in (_least, _most))
        assert (least == most).all()
        np.testing.assert_array_equal(found.solution.problem.kappa, least)


def _least(n: int, labels: Array, values: Array) -> Array:
    return np.array([values[labels == part].min() for part in range(n)])


def _most(n: int, labels: Array, values: Array) -> Array:
    return np.array([values[labels == part].max() for part in range(n)])


def test_a_source_by_cell_is_averaged_and_its_oscillation_counts() -> None:
    mesh = samples.voronoi(300, seed=2)
    source = np.random.default_rng(3).normal(size=300)
    hierarchy = agglo.agglomerate(mesh, n_parts=(80, 20))
    cut, posed = hierarchy.cut_at(1), PosedOnCuts(Diffusion(4.0, source), mesh)
    assert not posed.mixed_parts(cut).any()
    means = np.array(
        [np.average(source[cut.labels == k], weights=mesh.cell_measures[cut.labels == k]) for k in range(20)]
    )
    np.testing.assert_allclose(posed.on(cut).source, means)
    gaps = mesh.cell_measures * (source - means[cut.labels]) ** 2
    expected = cut.mesh.cell_diameters / np.pi * np.sqrt(np.bincount(cut.labels, gaps) / 4.0)
    np.testing.assert_allclose(posed.source_oscillation(cut), expected)
    step = agglo.adapt(hierarchy, Diffusion(4.0, source), max_unknowns=1).steps[0]
    assert step.estimate >= np.linalg.norm(expected)
    # A uniform source by cell is that source
    same = agglo.adapt(hierarchy, Diffusion(4.0, np.full(300, 2.0)), max_unknowns=1)
    other = agglo.adapt(hierarchy, Diffusion(4.0, 2.0), max_unknowns=1)
    assert same.estimate == pytest.approx(other.estimate, rel=1e-9)


def test_boundary_data_and_tensors_by_cell_are_kept() -> None:
    mesh = with_four_sides(samples.squares(12))
    x = mesh.cell_centroids
    tensors = np.where(x[:, :1, None] < 0.5, np.eye(2), np.array([[2.0, 0.5], [0.5, 1.0]]))
    steps = np.floor(4.0 * x[:, 1])
    problem = Diffusion(
        tensors,
        dirichlet={1: steps},
        neumann={2: steps},
        robin={3: (np.floor(3.0 * x[:, 0]), 1.0)},
        reaction=np.where(x[:, 1] < 0.25, 0.0, 3.0),
        convection=np.stack((np.floor(2.0 * x[:, 1]), 0.0 * steps), axis=1),
    )
    found = agglo.adapt(agglo.agglomerate(mesh, n_parts=(36, 6)), problem, max_unknowns=600)
    whole = agglo.solve(mesh, problem, degree=2).evaluate([[0.3, 0.6], [0.8, 0.4]])
    np.testing.assert_allclose(found.solution.evaluate([[0.3, 0.6], [0.8, 0.4]]), whole, rtol=0.08)
    finest = agglo.agglomerate(mesh, n_parts=36).cut_at(-1)
    posed = PosedOnCuts(problem, mesh).on(finest)
    x_fine, x_posed = (agglo.solve(mesh, each).x for each in (problem, posed))
    np.testing.assert_allclose(x_posed, x_fine, rtol=1e-9, atol=1e-12)


def test_divides_the_largest_given_or_predicted_indicator() -> None:
    def slow(squares: list[float], ratio: float, target: float) -> list[int]:
        left, depth, found = list(squares), [0] * len(squares), list[int]()
        while sum(square / ratio**k for square, k in zip(squares, depth, strict=True)) > target:
            k = int(np.argmax(left))
            left[k], depth[k] = (left[k] / ratio**2 if depth[k] < 2 else 0.0), depth[k] + 1
            found.append(k)
        return found

    squares = [1.0, 50.0, 0.0, 3.0, 1.0]
    assert slow(squares, 4.0, 12.0) == [1, 1]
    for target in (30.0, 12.0, 9.0, 5.2, 2.0):
        parts, largest = divisions(np.array(squares), 4.0, target)
        assert parts.tolist() == slow(squares, 4.0, target)
        assert (np.diff(largest) <= 0).all()


def test_divides_marked_parts_and_joins_siblings_that_hardly_count() -> None:
    hierarchy = agglo.agglomerate(samples.squares(8), n_parts=(16, 4))
    coarse = hierarchy.cut_at(1)
    divided = coarse.refine([0, 1]).cut
    parents = coarse.labels[np.unique(divided.labels, return_index=True)[1]]
    squares = np.where(parents == 0, 1e-9, 1.0)
    moved = next_cut(divided, squares, 0.2)
    assert moved is not None
    of_first = np.unique(moved.labels[coarse.labels == 0])
    assert len(of_first) == 1  # joined again
    assert moved.n_parts > coarse.n_parts
    most = next_cut(divided, squares, 0.9, most=divided.n_parts)
    assert most is None or most.n_parts <= divided.n_parts
    cells = hierarchy.cut_at(-1)
    assert next_cut(cells, np.ones(64), 0.5) is None


def test_a_guess_near_the_solution_saves_iterations() -> None:
    mesh = samples.voronoi(500, seed=6)
    solver = agglo.registry.default().build("solver", "polydg_mg", degree=2)
    bare = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    data = Diffusion(source=1.0, dirichlet={0: lambda x: 100.0 + x[:, 0]})
    first = solver.solve(data, bare)
    assert solver.solve(data, bare, start=first.x).iterations <= 1 < first.iterations
    np.testing.assert_allclose(solver.solve(data, bare, start=first.x).x, first.x, atol=1e-8)
    for wrong in (first.x[1:], np.full_like(first.x, np.nan)):
        with pytest.raises(OptionError, match=r"start must contain \(3000,\) finite numbers"):
            solver.solve(data, bare, start=wrong)
    with pytest.raises(OptionError, match="start is an initial guess for discretised problems"):
        solver.solve(agglo.Linear(first.A, first.b), bare, start=first.x)


def test_wrong_arguments_are_refused() -> None:
    mesh = samples.squares(6)
    for given, match in (
        ({}, "give tolerance, max_unknowns or both"),
        ({"tolerance": 0.0}, "tolerance must be a number above 0"),
        ({"tolerance": 0.1, "marking": 2.0}, "marking must be a number above 0 and at most 1"),
        ({"max_unknowns": 2.5}, "max_unknowns must be a positive whole number"),
        (
            {"tolerance": 0.1, "problem": agglo.Elasticity()},
            "adapt solves problems of kind diffusion, given a problem of kind elasticity",
        ),
        ({"tolerance": 0.1, "estimator": 3}, "3 is not an estimator"),
        ({"tolerance": 0.1, "solver": "direct", "degre": 2}, "did you mean 'degree'"),
    ):
        with pytest.raises(OptionError, match=match):
            agglo.adapt(mesh, **given)  # type: ignore[arg-type]
    loose = agglo.agglomerate(mesh, n_parts=(12, 3), nested=False)
    with pytest.raises(OptionError, match="the hierarchy is not nested"):
        agglo.adapt(replace(loose, nested=False), tolerance=0.1)
    with pytest.raises(OptionError, match="requires a hierarchy with a mesh"):
        agglo.adapt(agglo.agglomerate(mesh.graph, n_parts=4), tolerance=0.1)


class Wrong:
    accepts = ("diffusion",)

    def indicate(self, solution: object) -> Array:
        return np.array([-1.0])


class Centred(Wrong):
    def indicate(self, solution: object) -> Array:
        mesh: Mesh = solution.mesh  # type: ignore[attr-defined]
        return mesh.cell_measures * np.exp(-np.linalg.norm(mesh.cell_centroids - 0.5, axis=1))


def test_a_custom_estimator_drives_adapt() -> None:
    mesh = samples.squares(12)
    found = agglo.adapt(mesh, max_unknowns=300, estimator=Centred(), solver="direct")
    assert found.steps[-1].oscillation is None
    assert found.steps[-1].parts > found.steps[0].parts
    with pytest.raises(PluginError, match=r"estimator Wrong: indicate returned .* finite numbers"):
        agglo.adapt(mesh, max_unknowns=300, estimator=Wrong())


def test_a_goal_refines_where_the_quantity_depends_on_the_solution() -> None:
    mesh = samples.voronoi(3000, seed=9)

    def weight(x: Array) -> Array:
        return np.asarray(np.exp(-100.0 * ((x - 0.2) ** 2).sum(axis=1)))

    problem = Diffusion(source=lambda x: 100.0 * np.cos(9.0 * x[:, 0]) * np.cos(9.0 * x[:, 1]))
    found = agglo.adapt(mesh, problem, goal=weight, tolerance=0.05, degree=2)
    assert found.reason == "tolerance"
    how = found.solution.discretisation
    numbers = []
    for solution in (found.solution, agglo.solve(mesh, problem, degree=3)):
        how, on = solution.discretisation, solution.mesh
        numbers.append(how.project(on, weight) @ (how.mass(on) @ solution.x))
    assert abs(numbers[0] - numbers[1]) < found.estimate
    assert found.steps[-1].relative == pytest.approx(found.estimate / abs(numbers[0]))
    # The energy needs more parts away from the weight
    energy = agglo.adapt(mesh, problem, max_unknowns=found.steps[-1].unknowns, degree=2)
    far = [np.linalg.norm(cut.mesh.cell_centroids - 0.2, axis=1) > 0.5 for cut in (found.cut, energy.cut)]
    assert far[0].mean() < 0.8 * far[1].mean()
    by_cell = agglo.adapt(mesh, problem, goal=weight(mesh.cell_centroids), max_unknowns=600, degree=2)
    assert by_cell.steps[-1].relative is not None
    with pytest.raises(OptionError, match="goal requires a problem without convection"):
        agglo.adapt(mesh, Diffusion(convection=[1.0, 0.0]), goal=1.0, tolerance=0.1)
