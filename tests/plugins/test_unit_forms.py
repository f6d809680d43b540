"""Parts of matrices kept for κ = 1: what they make is what a fresh assembly makes, whatever changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.errors import OptionError
from agglo_core.problems import Diffusion, Solution
from agglo_core.threads import using_threads
from agglo_polydg_mg.forms import unit_forms
from agglo_polydg_mg.forms.assembly import Lifted
from agglo_polydg_mg.forms.unit_forms import UnitForms
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

Array = NDArray[np.float64]


def scattered() -> Mesh:
    """Cells of several parts, which share many faces with each other."""
    mesh = samples.voronoi(60, seed=2)
    return mesh.coarsen(np.random.default_rng(0).integers(0, 9, mesh.n_cells))


MESHES: dict[str, Callable[[], Mesh]] = {
    "voronoi": lambda: samples.voronoi(70, seed=1),
    "random triangles": lambda: samples.random_triangles(60, seed=3),
    "scattered": scattered,
}


def jumping(mesh: Mesh, seed: int) -> Array:
    return np.asarray(10.0 ** np.random.default_rng(seed).uniform(-4, 4, mesh.n_cells))


def require_same(found: Lifted, expected: Lifted) -> None:
    """The same up to rounding, entry by entry beside the entries of the diagonal."""
    A, B = found.system.A.tocsr(), expected.system.A.tocsr()
    root = np.sqrt(B.diagonal())
    difference = (A - B).tocoo()
    assert (abs(difference.data) <= 1e-12 * root[difference.row] * root[difference.col]).all()
    np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-12)
    np.testing.assert_allclose(found.system.b, expected.system.b, rtol=1e-12, atol=1e-12 * abs(B).max())


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_matrices_and_penalties_are_those_of_a_fresh_assembly(name: str, degree: int) -> None:
    mesh, how = MESHES[name](), PolyDG(degree, "sharp", True)
    units = UnitForms(how.basis(mesh))
    for seed in range(2):
        problem = Diffusion(kappa=jumping(mesh, seed), source=1.0)
        require_same(how.lifted(problem, mesh, units.basis, units), how.lifted(problem, mesh))


def test_unit_forms_of_cells_too_thin_for_the_sharp_penalty() -> None:
    mesh, how = samples.random_triangles(40, seed=5), PolyDG(3, "sharp", False)
    mesh = replace(mesh, points=mesh.points * [1.0, 1e-7])
    units = UnitForms(how.basis(mesh))
    problem = Diffusion(kappa=jumping(mesh, 0), source=1.0)
    require_same(how.lifted(problem, mesh, units.basis, units), how.lifted(problem, mesh))


@pytest.mark.parametrize("penalty", ["paper", 3.0])
def test_other_penalties_are_taken_as_they_are(penalty: float) -> None:
    mesh, how = samples.voronoi(50, seed=4), PolyDG(2, penalty, True)
    units = UnitForms(how.basis(mesh))
    problem = Diffusion(kappa=jumping(mesh, 1), source=1.0)
    require_same(how.lifted(problem, mesh, units.basis, units), how.lifted(problem, mesh))


def sides(mesh: Mesh) -> Mesh:
    """A mesh whose boundary faces on the left have the tag 1, the others 2."""
    middle = mesh.points[mesh.face_pairs].mean(axis=1)
    return replace(mesh, face_tags={"boundary": np.where(middle[:, 0] < 1e-9, 1, 2)})


def wave(points: Array) -> Array:
    return np.asarray(1.5 + np.sin(3.0 * points[:, 0] + points[:, 1]))


def changing(mesh: Mesh) -> list[Diffusion]:
    """Problems of which each changes something else."""
    smooth, rng = 1.0 + mesh.cell_centroids[:, 0], np.random.default_rng(6)
    return [
        Diffusion(kappa=smooth, source=1.0),
        Diffusion(kappa=smooth, source=wave),
        Diffusion(kappa=jumping(mesh, 3), source=wave),
        Diffusion(kappa=2.0, source=rng.standard_normal(mesh.n_cells)),
        Diffusion(kappa=smooth, source=1.0, dirichlet={1: 1.0, 2: wave}),
        Diffusion(kappa=smooth, source=1.0, dirichlet={1: 1.0}, neumann={2: 0.5}),
        Diffusion(kappa=wave, source=1.0, dirichlet={2: 0.0}),
        Diffusion(kappa=smooth, source=1.0, dirichlet={2: 0.0}, neumann={1: wave}),
        Diffusion(kappa=3.0 * smooth, source=0.0, dirichlet={1: 0.0, 2: 2.0}),
    ]


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


def require_alike(found: Solution, expected: Solution, tolerance: float) -> None:
    assert found.converged
    assert expected.converged
    root = np.sqrt(expected.A.diagonal())
    difference = (found.A - expected.A).tocoo()
    assert (abs(difference.data) <= 1e-12 * root[difference.row] * root[difference.col]).all()
    np.testing.assert_allclose(found.b, expected.b, rtol=1e-10, atol=1e-12 * abs(expected.b).max())
    error = found.x - expected.x
    assert error @ (expected.A @ error) <= (4.0 * tolerance) ** 2 * (expected.x @ (expected.A @ expected.x))


@pytest.mark.parametrize("degree", [1, 2])
def test_steps_solve_the_problem_at_hand_whatever_changed(degree: int) -> None:
    """κ, its jumps and its kind, source, boundary data, and which faces have which."""
    mesh = sides(samples.voronoi(70, seed=7))
    solver = PolyDGMultigrid(degree, tolerance=1e-8)
    steps = solver.repeated(bare(mesh))
    problems = changing(mesh)
    for problem in [*problems, *problems[::-1]]:
        require_alike(steps.solve(problem), solver.solve(problem, bare(mesh)), 1e-8)


def test_a_coefficient_that_is_changed_in_place_is_seen() -> None:
    mesh = samples.squares(8)
    steps, kappa = PolyDGMultigrid().repeated(bare(mesh)), np.ones(mesh.n_cells)
    for factor in (1.0, 2.0, 4.0):
        kappa[: mesh.n_cells // 2] = factor
        found = steps.solve(Diffusion(kappa=kappa, source=1.0))
        require_alike(
            found, PolyDGMultigrid().solve(Diffusion(kappa=kappa.copy(), source=1.0), bare(mesh)), 1e-6
        )


def test_values_of_another_mesh_are_refused_and_do_no_harm() -> None:
    mesh, other = samples.squares(8), samples.squares(9)
    steps = PolyDGMultigrid().repeated(bare(mesh))
    for _ in range(2):
        assert steps.solve(Diffusion(kappa=np.ones(mesh.n_cells), source=1.0)).converged
    with pytest.raises(OptionError, match="kappa has shape"):
        steps.solve(Diffusion(kappa=np.ones(other.n_cells), source=1.0))
    with pytest.raises(OptionError, match="positive"):
        steps.solve(Diffusion(kappa=np.zeros(mesh.n_cells), source=1.0))
    assert steps.solve(Diffusion(kappa=np.ones(mesh.n_cells), source=1.0)).converged


def test_one_solve_keeps_nothing_and_callables_neither() -> None:
    mesh, how = samples.squares(6), PolyDG(2, "sharp", True)
    units = UnitForms(how.basis(mesh))
    how.lifted(Diffusion(kappa=wave, source=1.0), mesh, units.basis, units)
    assert set(vars(units)) == {"basis"}
    how.lifted(Diffusion(kappa=1.0, source=1.0), mesh, units.basis, units)
    assert {"faces", "stiffness"} < set(vars(units))


def test_too_large_a_basis_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what fits is told from the bytes of the arrays."""
    mesh, how = samples.voronoi(40, seed=8), PolyDG(2, "sharp", True)
    units, problem = UnitForms(how.basis(mesh)), Diffusion(kappa=jumping(mesh, 2), source=1.0)
    kept = how.lifted(problem, mesh, units.basis, units)
    size = sum(each.nbytes for each in (units.faces, units.stiffness, units._whitened[0]))
    for most, fits in ((size, True), (size - 1, False)):
        monkeypatch.setattr(unit_forms, "_MOST", most)
        assert UnitForms(units.basis).fit is fits
    small = UnitForms(units.basis)
    require_same(how.lifted(problem, mesh, units.basis, small), kept)
    assert set(vars(small)) == {"basis"}


def test_two_threads_make_the_same_of_what_is_kept() -> None:
    mesh, how = samples.voronoi(300, seed=9), PolyDG(2, "sharp", True)
    problem = Diffusion(kappa=jumping(mesh, 5), source=1.0)
    found = []
    for threads in (1, 2):
        with using_threads(threads, few=20):
            units = UnitForms(how.basis(mesh))
            found.append(how.lifted(problem, mesh, units.basis, units))
    np.testing.assert_array_equal(found[0].sigma, found[1].sigma)
    np.testing.assert_array_equal(found[0].system.A.indices, found[1].system.A.indices)
    np.testing.assert_allclose(found[0].system.A.data, found[1].system.A.data, rtol=1e-12, atol=1e-12)
