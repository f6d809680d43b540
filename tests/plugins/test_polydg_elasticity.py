"""Elasticity: rigid motions, exactness, orders, coercivity, iterations, refusals, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import eigh

import agglo_core as agglo
from agglo_core import AggloError, Elasticity, Mesh, OptionError, samples
from agglo_core.problems import read_problem, require_accepted
from agglo_petsc.solver.petsc_multigrid import PetscMultigrid
from agglo_polydg_mg.elasticity.discretisation import PolyDGElasticity
from agglo_polydg_mg.elasticity.forms import cell_blocks, matrix
from agglo_polydg_mg.elasticity.levels import exact_for_linear
from agglo_polydg_mg.elasticity.material import Material, along, face_weights
from agglo_polydg_mg.elasticity.penalty import elastic_penalty
from agglo_polydg_mg.elasticity.vectors import coordinates, joined, rigid_motions
from agglo_polydg_mg.forms.face_quadrature import all_faces, face_rule
from agglo_polydg_mg.forms.sharp_penalty import MARGIN
from agglo_polydg_mg.space.basis import Basis

Array = NDArray[np.float64]


def agglomerates(mesh: Mesh, parts: int) -> Mesh:
    """The mesh of the agglomerates."""
    return mesh.coarsen(agglo.agglomerate(mesh.graph, n_parts=parts).levels[0])


MESHES = {
    "voronoi": lambda: samples.voronoi(60, seed=1),
    "random triangles": lambda: samples.random_triangles(40, seed=1),
    "agglomerates": lambda: agglomerates(samples.voronoi(200, seed=2), 25),
    "tetrahedra": lambda: samples.tetrahedra(2),
    "polyhedra": lambda: samples.voronoi3d(12, seed=1),
    "solid agglomerates": lambda: agglomerates(samples.tetrahedra(2), 8),
}


def rough(mesh: Mesh, seed: int = 0, decades: float = 3.0) -> Material:
    """Lamé parameters that jump from cell to cell."""
    rng = np.random.default_rng(seed)
    mu = 10.0 ** rng.uniform(-decades, decades, mesh.n_cells)
    return Material(mu * rng.uniform(-0.5, 100.0, mesh.n_cells), mu)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_rigid_motions_have_no_energy_and_no_others_do(name: str, degree: int) -> None:
    mesh = MESHES[name]()
    basis, material = Basis(mesh, degree, True), Material(*Elasticity().lame(mesh.n_cells))
    penalised = mesh.face_cells[:, 1] >= 0  # no face of the boundary is held
    sigma = elastic_penalty(basis, material, penalised)
    A = matrix(basis, material, np.zeros(mesh.n_cells), sigma).toarray()
    motions = rigid_motions(basis)
    assert np.abs(A @ motions).max() <= 1e-11 * np.abs(A).max() * np.abs(motions).max()
    values = np.linalg.eigvalsh(A)
    k = motions.shape[1]
    assert np.linalg.matrix_rank(motions) == k == mesh.dim * (mesh.dim + 1) // 2
    assert values[k] > 1e-9 * values[-1] > np.abs(values[:k]).max()


def slow_form(basis: Basis, material: Material, sigma: Array, u: Array, v: Array) -> float:
    """a(u, v) point by point, from displacements, their gradients and stresses."""
    mesh, dim, m = basis.mesh, basis.mesh.dim, basis.n_local

    def fields(x: Array, c: int, points: Array) -> tuple[Array, Array]:
        cells = np.full(len(points), c)
        own = x.reshape(mesh.n_cells, dim, m)[c]
        return basis.values(cells, points) @ own.T, np.einsum(
            "qjk,ak->qaj", basis.gradients(cells, points), own
        )

    def stress(slope: Array, c: int) -> Array:
        trace = np.trace(slope, axis1=1, axis2=2)[:, None, None] * np.eye(dim)
        return material.mu[c] * (slope + slope.transpose(0, 2, 1)) + material.lame[c] * trace

    total = 0.0
    from agglo_core.fields.rules import inside

    for batch in inside(mesh, 2 * basis.degree):
        for c in range(mesh.n_cells):
            here = batch.cells == c
            points = batch.points[here]
            product = stress(fields(u, c, points)[1], c) * fields(v, c, points)[1]
            total += float(batch.weights[here] @ product.sum(axis=(1, 2)))
    rule = face_rule(mesh, all_faces(mesh), basis.degree + 2)
    weights = face_weights(mesh, material, all_faces(mesh))
    for f, points, factors, n in zip(*rule, strict=True):
        if sigma[f] == 0.0:
            continue
        jumps = [np.zeros_like(points), np.zeros_like(points)]
        means = [np.zeros_like(points), np.zeros_like(points)]
        for side, c in enumerate(mesh.face_cells[f]):
            if c < 0:
                continue
            W = along(weights.average[f : f + 1, side], n[None])[0]
            for k, x in enumerate((u, v)):
                values, slope = fields(x, c, points)
                jumps[k] += -values if side else values
                means[k] += stress(slope, c) @ n @ W
        stiff = sigma[f] * along(weights.mean[f : f + 1], n[None])[0]
        products = jumps[0] @ stiff * jumps[1] - means[0] * jumps[1] - means[1] * jumps[0]
        total += float(factors @ products.sum(axis=1))
    return total


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_the_matrix_is_the_bilinear_form(name: str, degree: int) -> None:
    mesh = MESHES[name]()
    basis, material = Basis(mesh, degree, True), rough(mesh, decades=0.5)
    penalised = np.ones(mesh.n_faces, bool)
    penalised[np.flatnonzero(mesh.face_cells[:, 1] < 0)[::2]] = False
    sigma = elastic_penalty(basis, material, penalised)
    A = matrix(basis, material, np.zeros(mesh.n_cells), sigma)
    rng = np.random.default_rng(1)
    u, v = rng.normal(size=(2, A.shape[0]))
    assert u @ (A @ v) == pytest.approx(slow_form(basis, material, sigma, u, v), rel=1e-9)
    assert abs(A - A.T).max() <= 1e-12 * abs(A).max()
    reaction = rng.random(mesh.n_cells)
    added = matrix(basis, material, reaction, sigma) @ v - A @ v
    mass = PolyDGElasticity(degree).mass(mesh) @ (np.repeat(reaction, v.size // mesh.n_cells) * v)
    assert np.abs(added - mass).max() <= 1e-9 * abs(A).max() * np.abs(v).max()


def least_ratio(mesh: Mesh, degree: int, material: Material, held: Array) -> float:
    """The smallest a(v, v) / ‖v‖², with the norm made independently from points on the faces."""
    basis = Basis(mesh, degree, True)
    sigma = elastic_penalty(basis, material, held)
    A = matrix(basis, material, np.zeros(mesh.n_cells), sigma).toarray()
    width, dim, m = A.shape[0] // mesh.n_cells, mesh.dim, basis.n_local
    norm = np.zeros_like(A)
    for c, block in enumerate(cell_blocks(basis, material, np.zeros(mesh.n_cells))):
        norm[c * width : (c + 1) * width, c * width : (c + 1) * width] = block
    rule, weights = (
        face_rule(mesh, all_faces(mesh), degree + 2),
        face_weights(mesh, material, all_faces(mesh)),
    )
    for f, points, factors, n in zip(*rule, strict=True):
        jump = np.zeros((len(points), dim, mesh.n_cells, dim, m))
        for side, c in enumerate(mesh.face_cells[f]):
            if c >= 0:
                values = basis.values(np.full(len(points), c), points)
                for axis in range(dim):
                    jump[:, axis, c, axis] += -values if side else values
        flat = jump.reshape(len(points), dim, -1)
        stiff = sigma[f] * along(weights.mean[f : f + 1], n[None])[0]
        norm += np.einsum("q,qia,ij,qjb->ab", factors, flat, stiff, flat, optimize=True)
    scale = 1.0 / np.sqrt(np.diag(norm))
    scaled = norm * scale[:, None] * scale
    shift = 1e-13 * np.eye(len(norm))
    return float(eigh(A * scale[:, None] * scale + MARGIN * shift, scaled + shift, eigvals_only=True)[0])


@pytest.mark.parametrize("name", MESHES)
def test_the_form_is_coercive_with_its_margin(name: str) -> None:
    mesh = MESHES[name]()
    held = np.ones(mesh.n_faces, bool)
    assert least_ratio(mesh, 1, rough(mesh, decades=1.0), held) >= MARGIN * (1.0 - 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_the_form_is_coercive_on_random_meshes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = seed % 5
    if kind == 0:
        mesh = samples.voronoi(int(rng.integers(4, 25)), seed=seed)
    elif kind == 1:
        mesh = samples.random_triangles(int(rng.integers(3, 12)), seed=seed)
    elif kind == 2:
        mesh = agglomerates(samples.voronoi(80, seed=seed), int(rng.integers(4, 12)))
    elif kind == 3:
        mesh = samples.random_tetrahedra(int(rng.integers(1, 4)), seed=seed)
    else:
        mesh = samples.voronoi3d(int(rng.integers(2, 6)), seed=seed)
    mesh = replace(mesh, points=mesh.points * (10.0 ** rng.uniform(-1, 1, mesh.dim)))
    degree = int(rng.integers(1, 4 if mesh.dim == 2 else 3))
    if mesh.n_cells * mesh.dim * Basis(mesh, degree).n_local > 1500:
        degree = 1
    held = (mesh.face_cells[:, 1] >= 0) | (rng.random(mesh.n_faces) < 0.7)
    held[np.flatnonzero(mesh.face_cells[:, 1] < 0)[0]] = True
    assert least_ratio(mesh, degree, rough(mesh, seed), held) >= MARGIN * (1.0 - 1e-5)


def affine(dim: int) -> Elasticity:
    """A linear displacement, held on the whole boundary."""
    slope = np.arange(1.0, dim * dim + 1).reshape(dim, dim) ** 2 / 7.0

    def exact(x: Array) -> Array:
        return np.asarray(x @ slope.T + np.arange(1.0, dim + 1))

    return Elasticity(poisson=0.3, displacement={0: exact}, exact=exact)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("solver", ["direct", "polydg_mg"])
def test_linear_displacements_are_exact(name: str, degree: int, solver: str) -> None:
    mesh = MESHES[name]()
    options = {"tolerance": 1e-12} if solver == "polydg_mg" else {}
    solution = agglo.solve(mesh, affine(mesh.dim), solver, degree=degree, **options)
    size = float(np.abs(solution.samples().values).max())
    errors = solution.errors()
    assert errors["l2"] <= 1e-10 * size
    assert errors["energy"] <= 1e-8 * size  # the exact gradient comes from differences


def test_a_bar_of_two_materials_is_exact() -> None:
    """Pulled along x without lateral motion: 2μ + λ jumps by 1e6, and the traction is continuous."""
    mesh = samples.squares(4)
    left = mesh.cell_centroids[:, 0] < 0.5
    mu = np.where(left, 1.0, 1e6)
    x = mesh.face_centroids[:, 0]
    ends = np.where(x < 1e-9, 1, np.where(x > 1 - 1e-9, 2, 3))

    def exact(points: Array) -> Array:
        stretch = np.where(points[:, 0] < 0.5, points[:, 0], 0.5 + (points[:, 0] - 0.5) * 1e-6)
        return np.stack((stretch, np.zeros(len(points))), axis=1)

    problem = Elasticity(
        lame_lambda=0.0,
        lame_mu=mu,
        displacement={1: (0.0, 0.0)},
        traction={2: (2.0, 0.0)},
    )
    solution = agglo.solve(mesh.with_face_tags(boundary=ends), problem, "direct", degree=1)
    points = mesh.cell_centroids
    found = solution.discretisation.evaluate(mesh, solution.x, points)
    assert np.abs(found - exact(points)).max() <= 1e-9


def waves(dim: int, nu: float = 0.3) -> Elasticity:
    """Sines with tractions on the right side, and displacements elsewhere."""
    lame, mu = (float(each[0]) for each in Elasticity(poisson=nu).lame(1))

    def phases(x: Array) -> tuple[Array, Array]:
        return np.sin(x + 0.3), np.cos(x + 0.3)

    def exact(x: Array) -> Array:
        s, c = phases(x)
        first = s[:, 0] * c[:, 1]
        second = 0.5 * c[:, 0] * s[:, 1]
        return np.stack([first, second, *([s[:, 0] * s[:, 2]] if dim == 3 else [])], axis=1)

    def gradient(x: Array, h: float = 1e-4) -> Array:
        steps = h * np.eye(dim)
        return np.stack(
            [
                (exact(x - 2 * e) - 8 * exact(x - e) + 8 * exact(x + e) - exact(x + 2 * e)) / (12 * h)
                for e in steps
            ],
            axis=2,
        )

    def force(x: Array) -> Array:
        s, c = phases(x)
        u = exact(x)
        if dim == 2:
            # div u = 1.5 cos cos; ∇div u = −1.5 (sin cos, cos sin); Δu = −2 u
            slope = -1.5 * np.stack((s[:, 0] * c[:, 1], c[:, 0] * s[:, 1]), axis=1)
        else:
            # div u = 1.5 cos cos + sin x cos z
            slope = np.stack(
                (
                    -1.5 * s[:, 0] * c[:, 1] + c[:, 0] * c[:, 2],
                    -1.5 * c[:, 0] * s[:, 1],
                    -s[:, 0] * s[:, 2],
                ),
                axis=1,
            )
        return np.asarray(2.0 * mu * u - (lame + mu) * slope)

    def pull(x: Array) -> Array:
        slope = gradient(x)
        trace = np.trace(slope, axis1=1, axis2=2)[:, None] * np.eye(dim)[0]
        return np.asarray(mu * (slope[:, :, 0] + slope[:, 0]) + lame * trace)

    return Elasticity(poisson=nu, force=force, displacement={1: exact}, traction={2: pull}, exact=exact)


def right_side_free(mesh: Mesh) -> Mesh:
    """The mesh with boundary tag 2 on the side x = 1, and 1 elsewhere."""
    return mesh.with_face_tags(boundary=np.where(mesh.face_centroids[:, 0] > 1 - 1e-9, 2, 1))


ORDERS = {
    "voronoi": lambda k: samples.voronoi(50 * 4**k, seed=3),
    "random triangles": lambda k: samples.random_triangles(20 * 4**k, seed=3),
    "agglomerates": lambda k: agglomerates(samples.triangles(12 * 2**k), 36 * 4**k),
}


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("degree", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_orders_are_those_of_the_theory(name: str, degree: int) -> None:
    found, sizes = [], []
    for k in range(3):
        mesh = right_side_free(ORDERS[name](k))
        errors = agglo.solve(mesh, waves(2), "direct", degree=degree).errors()
        found.append((errors["l2"], errors["energy"]))
        sizes.append(mesh.n_cells**-0.5)
    l2, energy = np.diff(np.log(np.array(found)), axis=0)[-1] / np.diff(np.log(sizes))[-1]
    assert l2 >= degree + 1 - 0.3
    assert energy >= degree - 0.2


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_the_orders_in_space_are_those_of_the_theory(degree: int) -> None:
    found = []
    for n in (2, 4):
        mesh = right_side_free(samples.tetrahedra(n))
        errors = agglo.solve(mesh, waves(3), "direct", degree=degree).errors()
        found.append((errors["l2"], errors["energy"]))
    l2, energy = np.log2(np.array(found[0]) / found[1])
    assert l2 >= degree + 1 - 0.35
    assert energy >= degree - 0.25


def test_nearly_incompressible_bodies_do_not_lock() -> None:
    mesh = right_side_free(samples.triangles(8))
    errors = [agglo.solve(mesh, waves(2, nu), "direct", degree=2).errors()["l2"] for nu in (0.3, 0.49999)]
    assert errors[1] <= 5.0 * errors[0]


def beam(n: int) -> Mesh:
    """A beam 20 long and 1 high of squares, with boundary tag 1 at the left end, 2 at the right, else 0."""
    square = samples.squares(n)
    mesh = samples.strip(20)
    assert square.dim == mesh.dim
    j, i = np.divmod(np.arange(20 * n * n), 20 * n)
    corner = j * (20 * n + 1) + i
    y, x = np.divmod(np.arange((20 * n + 1) * (n + 1)), 20 * n + 1)
    cells = np.stack((corner, corner + 1, corner + 20 * n + 2, corner + 20 * n + 1), axis=1)
    made = Mesh.from_polygons(np.stack((x, y), axis=1) / n, cells)
    ends = np.where(
        made.face_centroids[:, 0] < 1e-9, 1, np.where(made.face_centroids[:, 0] > 20 - 1e-9, 2, 0)
    )
    return made.with_face_tags(boundary=ends)


PULLED = Elasticity(displacement={1: (0.0, 0.0)}, traction={2: (0.0, -1e-3)})


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("n", [1600, pytest.param(16000, marks=pytest.mark.slow)])
def test_multigrid_takes_few_iterations(degree: int, n: int) -> None:
    weight = Elasticity(force=(0.0, -1.0))
    bodies = [
        (samples.squares(round(n**0.5)), weight),
        (samples.voronoi(n, seed=1), weight),
        (beam(round((n / 20) ** 0.5)), PULLED),
    ]
    for mesh, problem in bodies:
        solution = agglo.solve(mesh, problem, degree=degree)
        assert solution.converged, mesh
        assert solution.iterations <= 20, mesh


def test_the_deflection_of_a_slender_beam_is_that_of_bernoulli() -> None:
    solution = agglo.solve(beam(4), PULLED, degree=2, tolerance=1e-8)
    tip = solution.discretisation.evaluate(solution.mesh, solution.x, np.array([[20.0, 0.5]]))[0, 1]
    stiffness = 1.0 / (1.0 - 0.3**2) / 12.0  # plane strain: E / (1 − ν²) times 1/12
    assert tip == pytest.approx(-1e-3 * 20.0**3 / (3.0 * stiffness), rel=0.01)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("degree", [1, 2])
def test_the_continuous_space_contains_the_rigid_motions(name: str, degree: int) -> None:
    from agglo_polydg_mg.auxiliary.conforming_space import conforming_space
    from agglo_polydg_mg.auxiliary.solid_space import solid_space

    mesh = MESHES[name]()
    basis, ones = Basis(mesh, degree, True), np.ones(mesh.n_cells)
    material = Material(ones, ones)
    sigma = elastic_penalty(basis, material, np.ones(mesh.n_faces, bool))
    space = conforming_space(basis, sigma, ones) if mesh.dim == 2 else solid_space(basis)
    space, values = exact_for_linear(space, basis)
    P, x = space.prolongation(), coordinates(basis)
    for axis in range(mesh.dim):
        assert np.abs(P @ values[:, 1 + axis] - x[:, axis].ravel()).max() <= 1e-9 * np.abs(x).max()


def test_the_levels_use_the_agglomerates_of_a_hierarchy() -> None:
    mesh = samples.voronoi(3000, seed=1)
    hierarchy = agglo.agglomerate(mesh, n_parts=(300, 40))
    with_levels = agglo.solve(hierarchy, Elasticity(force=(0.0, -1.0)))
    without = agglo.solve(mesh, Elasticity(force=(0.0, -1.0)))
    assert with_levels.converged
    assert with_levels.levels.unknowns != without.levels.unknowns
    for recipe in ("conforming", "agglomerates"):
        assert agglo.solve(hierarchy, Elasticity(force=(0.0, -1.0)), recipe=recipe).converged


@pytest.mark.parametrize("cycle", ["auto", "K"])
@pytest.mark.parametrize("degree", [1, 2])
def test_single_precision_serves_slender_beams(degree: int, cycle: str) -> None:
    solution = agglo.solve(beam(14), PULLED, degree=degree, cycle=cycle)
    assert solution.converged
    assert "float32" in solution.choice
    assert "double" not in solution.choice


def test_units_of_any_size_are_solved() -> None:
    mesh = samples.squares(8)
    base = agglo.solve(mesh, Elasticity(force=(0.0, -1.0)), tolerance=1e-9)
    for young, force in ((2e11, 1e4), (1e-30, 1e-140), (1e80, 1e120)):
        for solver in ("polydg_mg", "direct"):
            found = agglo.solve(mesh, Elasticity(young=young, force=(0.0, -force)), solver, tolerance=1e-9)
            assert found.converged
            assert np.abs(found.x * young / force - base.x).max() <= 1e-7 * np.abs(base.x).max()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("reaction", [1e-3, 1.0, 1e3, 1e8])
def test_reactions_take_no_more_iterations(reaction: float, degree: int) -> None:
    mesh = samples.voronoi(1000, seed=1)
    problem = Elasticity(force=lambda x: np.sin(9.0 * x), reaction=reaction)
    without = agglo.solve(mesh, replace(problem, reaction=0.0), degree=degree)
    solution = agglo.solve(mesh, problem, degree=degree)
    assert solution.converged
    assert solution.iterations <= without.iterations + 1


def test_repeated_solves_reuse_the_levels() -> None:
    from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

    mesh = samples.squares(16)
    steps = PolyDGMultigrid().repeated(agglo.agglomerate(mesh, n_parts=(32,)))
    found = [steps.solve(Elasticity(young=1.0 + 0.1 * k, force=(0.0, -1.0))) for k in range(3)]
    assert all(each.converged for each in found)
    assert steps.setups == 1


@pytest.mark.slow
def test_scattered_cells_are_renumbered_and_numbered_back() -> None:
    mesh = samples.squares(110)
    order = np.random.default_rng(0).permutation(mesh.n_cells)
    young = 1.0 + mesh.cell_centroids[:, 0]
    weight = np.stack((mesh.cell_centroids[:, 1], -1.0 - mesh.cell_centroids[:, 0]), axis=1)
    plain = agglo.solve(mesh, Elasticity(young=young, force=weight), tolerance=1e-9)
    mixed = agglo.solve(
        mesh.renumbered(order), Elasticity(young=young[order], force=weight[order]), tolerance=1e-9
    )
    assert "renumbered" in mixed.choice
    points = np.random.default_rng(1).random((50, 2))
    values = [each.discretisation.evaluate(each.mesh, each.x, points) for each in (plain, mixed)]
    assert np.abs(values[0] - values[1]).max() <= 1e-7 * np.abs(values[0]).max()


def test_displacements_are_evaluated_sampled_and_written_as_vectors(tmp_path: Path) -> None:
    mesh, how = samples.voronoi(30, seed=1), PolyDGElasticity(2)

    def turn(x: Array) -> Array:
        return np.stack((-x[:, 1], x[:, 0]), axis=1)

    x = how.project(mesh, turn)
    points = np.array([[0.2, 0.7], [3.0, 3.0]])
    assert how.evaluate(mesh, x, points)[0] == pytest.approx([-0.7, 0.2])
    assert np.isnan(how.evaluate(mesh, x, points)[1]).all()
    found = how.sample(mesh, x)
    assert np.abs(found.values - turn(found.points)).max() <= 1e-12
    assert found.sizes == pytest.approx(np.linalg.norm(found.points, axis=1))
    basis = how.basis(mesh)
    assert joined(basis, [basis.project(lambda p: -p[:, 1]), basis.project(lambda p: p[:, 0])]) == (
        pytest.approx(x)
    )
    solution = agglo.solve(mesh, Elasticity(force=(0.0, -1.0)))
    solution.write(tmp_path / "u.vtu")
    assert b'Name="u" NumberOfComponents="3"' in (tmp_path / "u.vtu").read_bytes()
    assert solution.plot().get_xlabel() == "x"


def test_a_problem_file_is_read(tmp_path: Path) -> None:
    mesh = beam(1).with_tags(material=np.arange(20) % 2)
    path = tmp_path / "beam.toml"
    path.write_text(
        'kind = "elasticity"\npoisson = 0.25\nforce = [0.0, -1.0]\n[young.material]\n0 = 1.0\n1 = 10.0\n'
        "[displacement]\n1 = [0.0, 0.0]\n[traction]\n2 = [0.5, 0.0]\n"
    )
    problem = read_problem(path, mesh)
    assert isinstance(problem, Elasticity)
    lame, mu = problem.lame(mesh.n_cells)
    assert lame == pytest.approx(mu)
    assert mu[:2] == pytest.approx([0.4, 4.0])
    assert agglo.solve(mesh, problem).converged


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"traction": {2: (0.0, 1.0)}}, ["cell 0", "rigidly", "[2]", "[0, 1, 2]"]),
        ({"displacement": {7: (0.0, 0.0)}}, ["tag 7", "[0, 1, 2]"]),
        ({"displacement": {1: (0.0, 0.0)}, "traction": {1: (0.0, 1.0)}}, ["tag 1", "both"]),
        ({"poisson": 0.5}, ["poisson", "0.5 in cell 0"]),
        ({"poisson": np.where(np.arange(20) == 3, -1.5, 0.3)}, ["-1.5 in cell 3"]),
        ({"young": np.where(np.arange(20) == 5, -2.0, 1.0)}, ["young", "-2 in cell 5"]),
        ({"reaction": -np.ones(20)}, ["reaction must not be negative", "-1 in cell 0"]),
        ({"young": np.ones(3)}, ["young", "(3,)", "(20,)"]),
        ({"young": np.nan}, ["young", "nan", "cell 0"]),
        ({"lame_lambda": -1.0, "lame_mu": 1.0}, ["3 lame_lambda + 2 lame_mu", "-1 in cell 0"]),
        ({"force": (0.0, 1.0, 2.0)}, ["force", "(3,)", "(2,)"]),
        ({"force": lambda x: x[:, 0]}, ["force", "(q, 2)"]),
        ({"displacement": {1: lambda x: x * np.nan}}, ["displacement of tag 1", "nan"]),
        ({"displacement": {1: (0.0, 0.0)}, "exact": lambda x: x + 1.0}, ["exact contradicts", "component 0"]),
        ({"boundary": "ends"}, ["'ends'", "boundary"]),
    ],
)
@pytest.mark.parametrize("solver", ["direct", "polydg_mg"])
def test_wrong_data_are_refused_by_name(options: dict[str, object], words: list[str], solver: str) -> None:
    with pytest.raises(AggloError) as caught:
        agglo.solve(beam(1), Elasticity(**options), solver)
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lame_mu": 1.0}, ["lame_lambda", "given lame_mu"]),
        ({"young": 1.0, "lame_mu": 1.0, "lame_lambda": 1.0}, ["lame_lambda, lame_mu, young"]),
        ({"young": lambda x: x[:, 0]}, ["young", "callable", "cell_centroids"]),
        ({"displacement": (0.0, 0.0)}, ["displacement", "mapping"]),
        ({"force": "down"}, ["force"]),
        ({"exact": 1.0}, ["exact", "callable"]),
    ],
)
def test_wrong_problems_are_refused_at_once(options: dict[str, object], words: list[str]) -> None:
    with pytest.raises(OptionError) as caught:
        Elasticity(**options)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_options_without_meaning_are_refused() -> None:
    mesh = samples.squares(3)
    with pytest.raises(OptionError, match=r"penalty = 7\.0"):
        agglo.solve(mesh, Elasticity(), "direct", penalty=7.0)
    with pytest.raises(OptionError, match="recipe 'patches'"):
        agglo.solve(mesh, Elasticity(force=(0.0, 1.0)), recipe="patches")


def test_solvers_of_matrices_name_the_way_to_them() -> None:
    """The assembled system, with rigid motions, is solved by them."""
    mesh, problem = samples.squares(16), Elasticity(force=(0.0, -1.0))
    hierarchy = agglo.agglomerate(mesh, n_parts=(64, 8))
    for refuse in (
        lambda: agglo.solve(hierarchy, problem, "multigrid"),
        lambda: require_accepted(PetscMultigrid, problem, "petsc_mg"),
    ):
        with pytest.raises(OptionError, match="kind elasticity; assemble it, and give Linear") as caught:
            refuse()
        assert "near_null=system.near_null" in str(caught.value)
    with pytest.raises(OptionError, match="on a distributed mesh petsc_mg takes problems of kind diffusion"):
        PetscMultigrid().solve_across(problem, hierarchy)
    system = PolyDGElasticity(1).assemble(problem, mesh)
    linear = agglo.Linear(system.A, system.b, near_null=system.near_null)
    solution, expected = agglo.solve(hierarchy, linear, "multigrid"), agglo.solve(mesh, problem)
    assert solution.converged
    np.testing.assert_allclose(solution.x, expected.x, atol=1e-5 * np.abs(expected.x).max())
