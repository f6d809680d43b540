"""Meshes with flat cells: iterations of the default solver, and what it chooses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.linalg import splu
from solid_meshes import wedge_layers

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.problems import Diffusion, Solution
from agglo_polydg_mg.auxiliary.strong_faces import columns, flat_part
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

FRESH = 20261127


def squeezed(mesh: Mesh, ratio: float, power: float = 1.0) -> Mesh:
    """Map y of a plane mesh to ``ratio`` y to a power."""
    x, y = mesh.points.T
    loops = mesh.boundary_loops
    return Mesh.from_polygons(np.column_stack((x, ratio * y**power)), (loops.loop_offsets, loops.vertices))


def solved(mesh: Mesh, degree: int, kappa: object = 1.0) -> Solution:
    """Solve, and check the error in the energy norm."""
    found = PolyDGMultigrid(degree).solve(
        Diffusion(kappa, 8.0), Hierarchy(mesh, mesh.graph, [], [], nested=True)
    )
    assert found.converged, found.reason
    e = found.x - splu(found.A.tocsc()).solve(found.b)
    assert e @ (found.A @ e) <= 1e-10 * (found.b @ found.x)
    return found


@pytest.mark.parametrize(("degree", "most"), [(1, 15), (2, 18), (3, 22)])
@pytest.mark.parametrize("ratio", [1e-1, 1e-3, 1e-6])
def test_squeezed_polygons(ratio: float, degree: int, most: int) -> None:
    found = solved(squeezed(samples.voronoi(800, seed=FRESH), ratio), degree)
    assert found.iterations <= most, f"seed {FRESH}"
    assert "patches" in found.choice
    assert "flat cells" in found.choice


@pytest.mark.slow
@pytest.mark.parametrize(("degree", "most"), [(1, 16), (2, 20)])
def test_iterations_on_more_squeezed_polygons(degree: int, most: int) -> None:
    for ratio in (1e-3, 1e-6):
        mesh = squeezed(samples.voronoi(5000, seed=FRESH), ratio)
        assert solved(mesh, degree).iterations <= most, f"seed {FRESH}"


@pytest.mark.parametrize(("degree", "most"), [(1, 14), (2, 15)])
def test_a_sixth_of_the_polygons_flat(degree: int, most: int) -> None:
    mesh = squeezed(samples.voronoi(1600, seed=FRESH), 1.0, 3.0)
    found = solved(mesh, degree)
    assert found.iterations <= most, f"seed {FRESH}"


def test_plain_polygons_are_not_flat() -> None:
    mesh = samples.voronoi(1600, seed=FRESH)
    assert flat_part(mesh, 0.05) < 0.002
    assert "continuous space" in solved(mesh, 1).choice


@pytest.mark.parametrize("degree", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("layers", "height", "growth"), [(10, 1e-5, 1.0), (10, 1e-5, 1.8), (30, 1e-5, 1.0)])
def test_wedges_under_tetrahedra(layers: int, height: float, growth: float, degree: int) -> None:
    found = solved(wedge_layers(4, layers, height, FRESH, growth), degree)
    assert found.iterations <= 19, f"seed {FRESH}"
    assert "groups" in found.choice


def test_coefficients_of_the_layers_do_not_matter() -> None:
    mesh = wedge_layers(4, 10, 1e-5, FRESH)
    for factor in (1e-6, 1e6):
        kappa = np.where(mesh.cell_centroids[:, 2] < 0.0, factor, 1.0)
        assert solved(mesh, 1, kappa).iterations <= 19, f"seed {FRESH}"


def test_columns_are_layers_with_one_tetrahedron() -> None:
    mesh = wedge_layers(3, 10, 1e-5, FRESH)
    found, cut = columns(mesh)
    assert cut == 0.0
    sizes = np.diff(found.offsets)
    assert (sizes == 11).sum() == 18  # the triangles of the lower side
    assert columns(wedge_layers(2, 100, 1e-5, FRESH))[1] > 0.0


def test_flat_tetrahedra_without_columns_take_patches() -> None:
    mesh = samples.random_tetrahedra(150, seed=FRESH)
    flat = Mesh(mesh.points * [1.0, 1.0, 1e-3], mesh.face_offsets, mesh.face_vertices, mesh.face_cells)
    assert columns(flat)[1] > 0.05
    found = solved(flat, 1)
    assert "patches" in found.choice
    assert found.iterations <= 14, f"seed {FRESH}"
