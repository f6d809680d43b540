"""Gradients, stresses, integrals and fluxes: exact for polynomials, conservative on each cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Diffusion, Elasticity, Linear, Mesh, OptionError, Solution, samples
from agglo_core.errors import FileError
from agglo_core.io.vtk.xml_read import parse
from agglo_polydg_mg.elasticity.discretisation import PolyDGElasticity
from agglo_polydg_mg.forms.coefficients import reaction_blocks
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import block_diagonal
from agglo_polydg_mg.space.quadrature import weighted_moments

Array = NDArray[np.float64]


def joined(mesh: Mesh, parts: int) -> Mesh:
    """Agglomerates, whose collinear edges the sharp penalty merges."""
    return mesh.coarsen(agglo.agglomerate(mesh, n_parts=parts).levels[0])


def sides_tagged(mesh: Mesh) -> Mesh:
    """Boundary faces with tag 1 on the left, 2 on the right and 3 elsewhere, and inner faces with 0."""
    x = mesh.face_centroids[:, 0]
    tags = np.where(np.isclose(x, 0.0), 1, np.where(np.isclose(x, 1.0), 2, 3))
    return agglo.Mesh(
        mesh.points,
        mesh.face_offsets,
        mesh.face_vertices,
        mesh.face_cells,
        face_tags={"boundary": np.where(mesh.outer_faces, tags, 0)},
    )


MESHES = {
    "voronoi": sides_tagged(samples.voronoi(60, seed=3)),
    "agglomerates": joined(sides_tagged(samples.squares(12)), 20),
    "boxes": sides_tagged(samples.boxes(3)),
    "agglomerated tetrahedra": joined(sides_tagged(samples.tetrahedra(2)), 10),
}


def tensor(x: Array) -> Array:
    """Full tensor that varies in space."""
    dim = x.shape[1]
    directions = np.stack([np.cos(x[:, 0]), np.sin(x[:, 0]), x[:, 1]][:dim], axis=1)
    return np.asarray(0.1 * np.eye(dim) + directions[:, :, None] * directions[:, None])


DATA = {
    "numbers": Diffusion(source=2.0, dirichlet={1: 1.0, 2: 3.0}, neumann={3: 0.5}),
    "cell values": Diffusion(
        kappa=10.0 ** np.linspace(-3, 3, 60), source=lambda x: 1.0 + x[:, 0], dirichlet={1: 0.0}
    ),
    "functions": Diffusion(
        kappa=lambda x: np.exp(2.0 * x[:, 0]),
        source=lambda x: np.sin(x[:, 1]),
        dirichlet={1: lambda x: np.cos(3.0 * x[:, 1]), 3: 2.0},
        neumann={2: lambda x: x[:, 1]},
    ),
    "reaction and Robin": Diffusion(
        kappa=lambda x: 1.0 + x[:, 0],
        reaction=lambda x: 5.0 * x[:, 1],
        source=1.0,
        dirichlet={1: 2.0},
        robin={2: (lambda x: 1.0 + x[:, 1], 3.0)},
    ),
    "convection": Diffusion(
        kappa=lambda x: 0.02 * np.exp(x[:, 0]),
        source=1.0,
        reaction=0.5,
        convection=lambda x: np.roll(x, 1, axis=1) - 0.4,  # without divergence
        dirichlet={1: lambda x: 3.0 + x[:, 1], 3: 2.0},
    ),
    "tensor": Diffusion(kappa=tensor, source=1.0, dirichlet={1: lambda x: x[:, 1]}, neumann={2: 1.0}),
}


def outflow(mesh: Mesh, fluxes: Array) -> Array:
    """Sum of the fluxes out of each cell."""
    first, second = mesh.face_cells.T
    inner = second >= 0
    sums = np.bincount(first, fluxes, mesh.n_cells)
    return np.asarray(sums - np.bincount(second[inner], fluxes[inner], mesh.n_cells))


@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("data", DATA)
@pytest.mark.parametrize("name", MESHES)
def test_fluxes_out_of_each_cell_sum_to_its_source_less_reaction(name: str, data: str, degree: int) -> None:
    mesh, problem = MESHES[name], DATA[data]
    if data == "cell values" and name != "voronoi":
        problem = Diffusion(kappa=np.geomspace(1e-3, 1e3, mesh.n_cells), source=1.0)
    for penalty in ("sharp", 40.0):
        how = PolyDG(degree, penalty)
        system = how.assemble(problem, mesh)
        x = spsolve(system.A.tocsc(), system.b)
        fluxes = how.fluxes(problem, mesh, x)
        source = how.mass(mesh) @ how.project(mesh, problem.source)
        reaction = reaction_blocks(how.basis(mesh), problem.reaction)
        source -= 0.0 if reaction is None else block_diagonal(reaction) @ x
        expected = how.basis(mesh).constants(np.ones(mesh.n_cells)) * source
        gap = outflow(mesh, fluxes) - expected.reshape(mesh.n_cells, -1).sum(axis=1)
        assert np.abs(gap).max() <= 1e-10 * np.abs(fluxes).max()


def test_given_fluxes_are_those_of_neumann_faces() -> None:
    """−κ ∂u/∂n outward, the datum being κ ∂u/∂n; 0 where insulated."""
    mesh = MESHES["voronoi"]
    problem = Diffusion(dirichlet={1: 0.0}, neumann={2: lambda x: x[:, 1] ** 2})
    solution = agglo.solve(mesh, problem)
    fluxes, tags = solution.fluxes(), mesh.face_tags["boundary"]
    assert fluxes[tags == 2].sum() == pytest.approx(-1.0 / 3.0, rel=1e-12)
    assert not fluxes[tags == 3].any()
    assert fluxes[tags == 1].sum() == pytest.approx(1.0 + 1.0 / 3.0, rel=1e-5)


@pytest.mark.parametrize("name", MESHES)
def test_the_flux_of_a_linear_function_is_that_of_a_tensor(name: str) -> None:
    mesh, slope = MESHES[name], np.array([2.0, -1.0, 0.5])
    slope = slope[: mesh.dim]
    K = tensor(np.full((1, mesh.dim), 0.7))[0]
    problem = Diffusion(kappa=K, source=0.0, dirichlet=dict.fromkeys((1, 2, 3), lambda x: x @ slope))
    solution = agglo.solve(mesh, problem, solver="direct", degree=1, penalty="sharp")
    expected = -mesh.face_measures * (mesh.face_normals @ (K @ slope))
    np.testing.assert_allclose(solution.fluxes(), expected, atol=1e-10)


@pytest.mark.parametrize("name", MESHES)
def test_a_linear_function_has_the_flux_of_its_gradient(name: str) -> None:
    mesh, slope = MESHES[name], np.array([2.0, -1.0, 0.5])
    slope = slope[: mesh.dim]
    problem = Diffusion(kappa=3.0, source=0.0, dirichlet=dict.fromkeys((1, 2, 3), lambda x: x @ slope))
    solution = agglo.solve(mesh, problem, solver="direct", degree=1, penalty="sharp")
    expected = -3.0 * mesh.face_measures * (mesh.face_normals @ slope)
    np.testing.assert_allclose(solution.fluxes(), expected, atol=1e-10)
    inside = mesh.points.mean(axis=0)
    slopes = solution.gradient(np.array([inside, inside + 9.0]))
    np.testing.assert_allclose(slopes[0], slope, atol=1e-9)
    assert np.isnan(slopes[1]).all()
    np.testing.assert_allclose(solution.evaluate([inside]), [inside @ slope], atol=1e-10)


def test_the_imbalance_of_an_iterative_solution_is_its_residual() -> None:
    mesh = samples.voronoi(400, seed=5)
    for tolerance in (1e-3, 1e-9):
        solution = agglo.solve(mesh, Diffusion(source=8.0), degree=2, tolerance=tolerance)
        assert solution.discretisation is not None
        one = solution.discretisation.project(mesh, lambda points: np.ones(len(points)))
        residual = (one * (solution.b - solution.A @ solution.x)).reshape(mesh.n_cells, -1).sum(axis=1)
        gap = 8.0 * mesh.cell_measures - outflow(mesh, solution.fluxes())
        np.testing.assert_allclose(gap, residual, atol=1e-12)


def test_integrals_are_those_of_the_cells() -> None:
    mesh = samples.voronoi(80, seed=4)
    material = (mesh.cell_centroids[:, 0] > 0.5).astype(int)
    tagged = agglo.Mesh(
        mesh.points,
        mesh.face_offsets,
        mesh.face_vertices,
        mesh.face_cells,
        cell_tags={"material": material},
    )
    problem = Diffusion(source=0.0, dirichlet={0: lambda x: 1.0 + x[:, 0]})
    solution = agglo.solve(tagged, problem, solver="direct", degree=1, penalty="sharp")
    box = np.tile([0.0, 0.0, 1.0, 1.0, 1.0, 0.0], (80, 1))
    exact = 2.0 * weighted_moments(tagged, lambda x: 1.0 + x[:, 0], box, 0, "u")[:, 0]
    assert solution.integral() == pytest.approx(1.5, rel=1e-10)
    for value in (0, 1):
        assert solution.integral("material", value) == pytest.approx(exact[material == value].sum(), rel=1e-9)
    for given, message in (
        (("soil", 1), "no cell tag 'soil'; it has: material"),
        (("material", 7), "no cell has the value 7"),
        (("material", None), "its value, or neither"),
    ):
        with pytest.raises(OptionError, match=message):
            solution.integral(*given)


def test_a_solution_without_meaning_has_none_of_them() -> None:
    mesh = samples.squares(2)
    solution = agglo.solve(mesh, Linear(np.diag([1.0, 2.0, 3.0, 4.0]), np.ones(4)), solver="direct")
    for ask in (solution.fluxes, solution.integral, lambda: solution.gradient([[0.5, 0.5]])):
        with pytest.raises(OptionError, match="only for problems that the solver discretises"):
            ask()


def arrays(path: Path) -> dict[str | None, Array]:
    """Arrays of a VTU file by name."""
    document = parse(path.read_bytes())
    return {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}


def test_files_hold_gradients_and_fluxes(tmp_path: Path) -> None:
    mesh = MESHES["voronoi"]
    slope = np.array([2.0, -1.0])
    problem = Diffusion(source=0.0, dirichlet=dict.fromkeys((1, 2, 3), lambda x: x @ slope))
    solution = agglo.solve(mesh, problem, solver="direct", degree=1, penalty="sharp")
    solution.write(tmp_path / "u.vtu")
    solution.write_fluxes(tmp_path / "f.vtu")
    slopes = arrays(tmp_path / "u.vtu")["gradient"].reshape(-1, 3)
    np.testing.assert_allclose(slopes, np.tile([2.0, -1.0, 0.0], (len(slopes), 1)), atol=1e-9)
    assert agglo.read(tmp_path / "u.vtu").cell_measures.sum() == pytest.approx(1.0)
    faces = arrays(tmp_path / "f.vtu")
    assert set(faces["types"]) == {3}
    assert np.array_equal(faces["connectivity"], mesh.face_vertices)
    assert np.array_equal(faces["flux"], solution.fluxes())
    assert np.array_equal(faces["second_cell"], mesh.face_cells[:, 1])
    assert np.array_equal(faces["boundary"], mesh.face_tags["boundary"])
    with pytest.raises(FileError, match=r"written as \.vtu"):
        solution.write_fluxes(tmp_path / "f.csv")


SLOPE = np.array([[2.0, -1.0, 0.5], [0.3, 1.0, -2.0], [0.7, 0.2, -0.4]])
TAGS = (1, 2, 3)


def linear(x: Array) -> Array:
    """Displacement with the gradient SLOPE."""
    return np.asarray(x @ SLOPE[: x.shape[1], : x.shape[1]].T)


def curved(x: Array) -> Array:
    """Vectors that no polynomial equals."""
    return np.asarray(np.sin(x + x[:, ::-1] ** 2))


def net_force(mesh: Mesh, forces: Array) -> Array:
    """Sum of the forces on each cell."""
    total = np.zeros((mesh.n_cells, mesh.dim))
    first, second = mesh.face_cells.T
    np.add.at(total, first, forces)
    np.subtract.at(total, second[second >= 0], forces[second >= 0])
    return total


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", MESHES)
def test_forces_on_each_cell_balance_its_body_force(name: str, degree: int) -> None:
    mesh = MESHES[name]
    zero = (0.0,) * mesh.dim
    jumping = 10.0 ** np.linspace(-3, 3, mesh.n_cells)
    for problem in (
        Elasticity(force=curved),
        Elasticity(young=jumping, force=curved, displacement={1: zero}, traction={2: curved}),
        Elasticity(poisson=0.45, displacement={1: curved, 3: zero}, traction={2: zero}),
        Elasticity(force=curved, reaction=3.0, traction={2: curved}),
    ):
        how = PolyDGElasticity(degree)
        system = how.assemble(problem, mesh)
        x = spsolve(system.A.tocsc(), system.b)
        forces = how.fluxes(problem, mesh, x)
        body = how.integrals(mesh, how.project(mesh, problem.force)) if problem.force else 0.0
        body = body - problem.reaction * how.integrals(mesh, x)
        assert forces.shape == (mesh.n_faces, mesh.dim)
        assert np.abs(net_force(mesh, forces) + body).max() <= 1e-10 * np.abs(forces).max()


def linear_solution(mesh: Mesh, **material: object) -> Solution:
    problem = Elasticity(displacement=dict.fromkeys(TAGS, linear), **material)
    return agglo.solve(mesh, problem, solver="direct", degree=1)


@pytest.mark.parametrize("name", MESHES)
def test_a_linear_displacement_has_its_gradient_stress_and_forces(name: str) -> None:
    mesh = MESHES[name]
    solution, dim = linear_solution(mesh, lame_lambda=3.0, lame_mu=0.5), mesh.dim
    slope = SLOPE[:dim, :dim]
    inside = mesh.points.mean(axis=0)
    points = np.array([inside, inside + 9.0])
    expected = 0.5 * (slope + slope.T) + 3.0 * np.trace(slope) * np.eye(dim)
    for values, exact in (
        (solution.gradient(points), slope),
        (solution.stress(points)[:, :dim, :dim], expected),
    ):
        np.testing.assert_allclose(values[0], exact, atol=1e-8)
        assert np.isnan(values[1]).all()
    stress = solution.stress()
    np.testing.assert_allclose(
        stress[:, 2, 2], expected[2, 2] if dim == 3 else 3.0 * np.trace(slope), atol=1e-8
    )
    np.testing.assert_allclose(solution.gradient(), np.tile(slope, (mesh.n_cells, 1, 1)), atol=1e-8)
    forces = mesh.face_measures[:, None] * (mesh.face_normals @ expected)
    np.testing.assert_allclose(solution.fluxes(), forces, atol=1e-9)
    np.testing.assert_allclose(solution.evaluate(points[:1]), linear(points[:1]), atol=1e-9)


def test_means_over_cells_are_those_of_the_quadrature() -> None:
    mesh = samples.voronoi(40, seed=2)
    scalar = agglo.registry.default().build("discretisation", "polydg", degree=3)
    vector, rng = PolyDGElasticity(3), np.random.default_rng(0)
    x = rng.normal(size=scalar.assemble(Diffusion(), mesh).n)
    points, weights, values = scalar.quadrature(mesh)
    cells = scalar.basis(mesh).mesh.n_cells  # points are inside their cells
    owner = vector.locate(mesh, points)
    integral = np.bincount(owner, weights * (values @ x), cells)
    np.testing.assert_allclose(scalar.integrals(mesh, x), integral, atol=1e-11)
    slopes = weights[:, None] * scalar.gradient(mesh, x, points)
    means = np.stack([np.bincount(owner, s, cells) for s in slopes.T], axis=1) / mesh.cell_measures[:, None]
    np.testing.assert_allclose(scalar.gradient(mesh, x), means, atol=1e-8 * np.abs(means).max())
    both = np.stack((x.reshape(cells, -1), 2.0 * x.reshape(cells, -1)), axis=1).ravel()
    np.testing.assert_allclose(vector.integrals(mesh, both), np.outer(integral, [1.0, 2.0]), atol=1e-11)
    np.testing.assert_allclose(vector.gradient(mesh, both)[:, 1], 2.0 * scalar.gradient(mesh, x))
    assert both @ (vector.mass(mesh) @ both) == pytest.approx(5.0 * (x @ (scalar.mass(mesh) @ x)))


def test_integrals_are_vectors() -> None:
    mesh = MESHES["voronoi"].with_tags(material=(np.arange(60) < 20).astype(int))
    solution = linear_solution(mesh)
    np.testing.assert_allclose(solution.integral(), linear(np.array([[0.5, 0.5]]))[0], atol=1e-10)
    parts = [solution.integral("material", value) for value in (0, 1)]
    np.testing.assert_allclose(sum(parts), solution.integral(), atol=1e-12)


def test_given_tractions_are_those_of_their_faces() -> None:
    mesh = MESHES["voronoi"]
    problem = Elasticity(
        displacement={1: (0.0, 0.0)}, traction={2: lambda x: np.stack((x[:, 1] ** 2, x[:, 1]), 1)}
    )
    solution = agglo.solve(mesh, problem, tolerance=1e-10)
    forces, tags = solution.fluxes(), mesh.face_tags["boundary"]
    np.testing.assert_allclose(forces[tags == 2].sum(axis=0), [1.0 / 3.0, 0.5], rtol=1e-12)
    assert not forces[tags == 3].any()
    np.testing.assert_allclose(forces[tags == 1].sum(axis=0), [-1.0 / 3.0, -0.5], rtol=1e-6)


def test_files_hold_stresses_and_forces(tmp_path: Path) -> None:
    mesh = MESHES["voronoi"]
    solution = linear_solution(mesh)
    solution.write(tmp_path / "u.vtu")
    solution.write_fluxes(tmp_path / "f.vtu")
    found, stress = arrays(tmp_path / "u.vtu"), solution.stress()[0]
    np.testing.assert_allclose(found["stress"].reshape(-1, 3, 3)[0], stress, atol=1e-8)
    np.testing.assert_allclose(found["gradient"].reshape(-1, 3, 3)[0, :2, :2], SLOPE[:2, :2], atol=1e-8)
    xx, yy, zz, xy = stress[0, 0], stress[1, 1], stress[2, 2], stress[0, 1]
    squares = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * xy**2
    np.testing.assert_allclose(found["von_mises"], np.sqrt(squares), atol=1e-8)
    faces = arrays(tmp_path / "f.vtu")
    forces = faces["force"].reshape(-1, 3)
    np.testing.assert_array_equal(forces[:, :2], solution.fluxes())
    np.testing.assert_allclose(faces["traction"].reshape(-1, 3), forces / mesh.face_measures[:, None])


def test_stress_belongs_to_elasticity() -> None:
    solution = agglo.solve(samples.squares(3), Diffusion())
    with pytest.raises(OptionError, match="diffusion has no stress"):
        solution.stress()
