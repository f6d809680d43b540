"""Gradients, integrals and fluxes of solutions: exact for polynomials, conservative on each cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Diffusion, Linear, Mesh, OptionError, samples
from agglo_core.errors import FileError
from agglo_core.io.vtk.xml_read import parse
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
