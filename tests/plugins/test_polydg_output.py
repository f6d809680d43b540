"""Spaces, transfer, evaluation and files of PolyDG."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agglo_core import FileError, Mesh, MeshError, OptionError, read, samples
from agglo_core.arrays import frozen_int
from agglo_core.draw.solution import middle_slice
from agglo_core.fields.location import locate
from agglo_core.fields.sampling import sample_points
from agglo_core.fields.simplices import triangulate
from agglo_core.io.vtk.solution import write_solution
from agglo_core.io.vtk.xml_read import parse
from agglo_core.problems import Diffusion
from agglo_polydg_mg.auxiliary.box_transfer import project_between
from agglo_polydg_mg.forms.norms import errors
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.sampling import evaluate, samples_of

Array = NDArray[np.float64]


def cubic(x: Array) -> Array:
    """x³ − 2xy² + 1."""
    return np.asarray(x[:, 0] ** 3 - 2 * x[:, 0] * x[:, 1] ** 2 + 1)


def nested(seed: int = 0) -> tuple[Mesh, Mesh, NDArray[np.int64]]:
    """A mesh, agglomerates in pieces with holes, and their labels."""
    mesh = samples.voronoi(60, seed=1)
    labels = np.random.default_rng(seed).permutation(np.arange(mesh.n_cells) % 7)
    return mesh, mesh.coarsen(labels), labels


@pytest.mark.parametrize("scaled", [False, True])
def test_projection_keeps_polynomials_and_gradients_are_derivatives(scaled: bool) -> None:
    for mesh in nested()[:2]:
        basis = Basis(mesh, 3, scaled)
        x = basis.project(cubic)
        points = mesh.cell_centroids
        cells = np.arange(mesh.n_cells)
        np.testing.assert_allclose(basis.evaluate(x, cells, points), cubic(points), atol=1e-11)
        gradient = np.einsum(
            "qdk,qk->qd", basis.gradients(cells, mesh.local_centroids), basis.coefficients(x)
        )
        wanted = [3 * points[:, 0] ** 2 - 2 * points[:, 1] ** 2, -4 * points[:, 0] * points[:, 1]]
        np.testing.assert_allclose(gradient, np.transpose(wanted), atol=1e-9)


def test_the_scaled_basis_is_orthonormal_on_rectangles() -> None:
    np.testing.assert_allclose(Basis(samples.squares(3), 2, True).mass().toarray(), np.eye(54), atol=1e-13)
    np.testing.assert_allclose(Basis(samples.squares(3), 2).mass().toarray(), np.eye(54) / 36, atol=1e-13)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("coarse_degree", [1, 3])
def test_injection_leaves_the_function_as_it_is(scaled: bool, coarse_degree: int) -> None:
    mesh, coarse, labels = nested()
    fine, wide = Basis(mesh, 3, scaled), Basis(coarse, coarse_degree, scaled)
    y = np.random.default_rng(1).standard_normal(wide.n)
    x = project_between(fine, wide, labels) @ y
    cells, points, _ = sample_points(fine.mesh, fine.degree)
    np.testing.assert_allclose(
        fine.evaluate(x, cells, points), wide.evaluate(y, labels[cells], points), rtol=1e-9, atol=1e-9
    )


def test_the_mass_of_agglomerates_is_that_of_their_cells() -> None:
    mesh, coarse, labels = nested()
    fine, wide = Basis(mesh, 2), Basis(coarse, 2)
    P = project_between(fine, wide, labels)
    np.testing.assert_allclose((P.T @ fine.mass() @ P).toarray(), wide.mass().toarray(), atol=1e-14)


def test_injection_refuses_what_does_not_fit() -> None:
    mesh, coarse, labels = nested()
    with pytest.raises(OptionError, match="cannot inject degree 2 into degree 1"):
        project_between(Basis(mesh, 1), Basis(coarse, 2), labels)
    with pytest.raises(OptionError, match="labels of shape"):
        project_between(Basis(mesh, 1), Basis(coarse, 1), labels[:-1])


def test_triangles_cover_each_cell() -> None:
    for mesh in nested()[:2]:
        offsets, corners = triangulate(mesh)
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        areas = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        assert (areas > -1e-15).all()
        np.testing.assert_allclose(np.add.reduceat(areas, offsets[:-1]), mesh.cell_measures, rtol=1e-12)


def test_points_are_found_in_their_cells() -> None:
    mesh, coarse, labels = nested()
    points = np.random.default_rng(2).random((200, 2))
    cells = locate(mesh, points)
    assert (labels[cells] == locate(coarse, points)).all()
    assert locate(mesh, [[0.0, 0.0], [2.0, 0.0], [np.nan, 0.0]]).tolist()[1:] == [-1, -1]
    assert (locate(mesh, mesh.points) >= 0).all()  # corners of cells, where rounding could lose them


def test_values_at_points() -> None:
    basis = Basis(samples.voronoi(20, seed=3), 3)
    points = np.array([[0.3, 0.4], [0.9, 0.1], [1.5, 0.5]])
    values = evaluate(basis, basis.project(cubic), points)
    np.testing.assert_allclose(values[:2], cubic(points[:2]), atol=1e-12)
    assert np.isnan(values[2])
    with pytest.raises(OptionError, match="points must have shape"):
        evaluate(basis, np.zeros(basis.n), [0.1, 0.2])


def test_norms_of_a_known_error() -> None:
    """u_h = 0, u = x on the unit square: L2 1/√3, H1 1, and jumps of the boundary values in the DG norm."""
    basis = Basis(samples.squares(2), 1)
    problem = Diffusion(dirichlet={0: lambda x: x[:, 0]}, exact=lambda x: x[:, 0])
    found = errors(basis, np.zeros(basis.n), problem)
    assert found.l2 == pytest.approx(1 / np.sqrt(3))
    assert found.h1 == pytest.approx(1)
    assert found.dg == pytest.approx(np.sqrt(1 + 40 * (1 + 2 / 3)))  # σ = 20 p² / h
    with pytest.raises(OptionError, match="no exact solution"):
        errors(basis, np.zeros(basis.n), Diffusion())


def test_squares_of_norms_add_up_over_a_division_of_the_mesh() -> None:
    problem = Diffusion(exact=lambda x: np.cos(3 * x).prod(axis=1))
    for mesh in (samples.voronoi(30, seed=4), samples.boxes(2)):
        how = PolyDG(2, "sharp", True)
        x, third = how.project(mesh, lambda x: x[:, 0] ** 4), np.arange(mesh.n_cells) % 3
        pieces = [how.errors_in(problem, mesh, x, third == k) for k in range(3)]
        for name, norm in how.errors(problem, mesh, x).items():
            assert np.linalg.norm([each[name] for each in pieces]) == pytest.approx(norm, rel=1e-12)


def test_a_file_holds_the_function(tmp_path: Path) -> None:
    _, mesh, _ = nested()
    basis = Basis(mesh, 3)
    write_solution(tmp_path / "u.vtu", mesh, samples_of(basis, basis.project(cubic)))
    document = parse((tmp_path / "u.vtu").read_bytes())
    arrays = {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}
    points = arrays["Points"].reshape(-1, 3)[:, :2]
    np.testing.assert_allclose(arrays["u"], cubic(points), atol=1e-10)
    assert set(arrays["cell"]) == set(range(mesh.n_cells))
    pieces = read(tmp_path / "u.vtu")  # merged at their points, the triangles are a mesh of the same square
    assert pieces.cell_measures.sum() == pytest.approx(mesh.cell_measures.sum())
    shares = np.bincount(pieces.cell_tags["cell"], pieces.cell_measures)
    np.testing.assert_allclose(shares, mesh.cell_measures, rtol=1e-10)


def test_a_file_holds_polyhedra_that_are_not_star_shaped(tmp_path: Path) -> None:
    cubes = samples.boxes(3)
    x, y, _ = (3 * cubes.cell_centroids).astype(int).T
    mesh = cubes.coarsen(frozen_int((x == 1) & (y > 0)))  # a block of six cubes, and a U around it
    basis = Basis(mesh, 2)
    found = samples_of(basis, basis.project(cubic))
    cut = np.unique(found.cells[found.simplices])
    assert cut.tolist() == [1]
    write_solution(tmp_path / "u.vtu", mesh, found)
    document = parse((tmp_path / "u.vtu").read_bytes())
    arrays = {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}
    whole = arrays["types"] == 42
    assert sorted(set(arrays["cell"][~whole])) == cut.tolist()
    np.testing.assert_array_equal(np.isnan(arrays["gradient"].reshape(-1, 3)).all(axis=1), whole)
    points = arrays["Points"].reshape(-1, 3)
    np.testing.assert_array_equal(arrays["u"], basis.evaluate(basis.project(cubic), found.cells, points))
    pieces = read(tmp_path / "u.vtu", allow_gaps=True)
    shares = np.bincount(pieces.cell_tags["cell"], pieces.cell_measures)
    np.testing.assert_allclose(shares, mesh.cell_measures, rtol=1e-10)
    with pytest.raises(MeshError, match="not star-shaped"):
        middle_slice(found, 2)
    with pytest.raises(MeshError, match="no polyhedra sampled at their vertices"):
        write_solution(tmp_path / "v.vtu", mesh, replace(found, points=found.points[::-1]))


def test_a_tag_called_cell_leaves_the_numbers_of_the_cells(tmp_path: Path) -> None:
    mesh = samples.squares(2)
    basis = Basis(mesh, 1)
    found = samples_of(basis, np.zeros(basis.n))
    write_solution(tmp_path / "u.vtu", replace(mesh, cell_tags={"cell": np.full(4, 9)}), found)
    tags = read(tmp_path / "u.vtu").cell_tags
    assert set(tags["cell"]) == {9}
    assert set(tags["agglo_cell"]) == {0, 1, 2, 3}
    with pytest.raises(MeshError, match=r"v\.vtu: .*control characters"):
        write_solution(tmp_path / "v.vtu", replace(mesh, cell_tags={"\x02": np.full(4, 9)}), found)
    assert [file.name for file in tmp_path.iterdir()] == ["u.vtu"]


def test_files_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    basis = Basis(samples.squares(2), 1)
    found = samples_of(basis, np.zeros(basis.n))
    with pytest.raises(FileError, match=r"written as \.vtu"):
        write_solution(tmp_path / "u.vtk", basis.mesh, found)
    with pytest.raises(FileError, match="missing"):
        write_solution(tmp_path / "missing" / "u.vtu", basis.mesh, found)
    with pytest.raises(OptionError, match="12"):
        samples_of(basis, np.zeros(5))
    assert not list(tmp_path.iterdir())
