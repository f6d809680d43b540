"""The solver petsc_mg and the functions for a user's own KSP, where petsc4py is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

pytest.importorskip("petsc4py", reason="PETSc tests skipped: no petsc4py here")

import agglo_core as agglo
import agglo_petsc
from agglo_core.errors import OptionError
from agglo_core.problems import Diffusion, Linear
from agglo_core.registry import default
from agglo_petsc.matrices import petsc, rows_of, vector

PETSc = petsc()
STRAIGHT = {"bisector": "coordinate", "refiners": (), "polish": False}  # little to compile


def solver(**options):
    return default().build("solver", "petsc_mg", **options)


def voronoi(n, seed, *sizes):
    mesh = agglo.samples.voronoi(n, seed=seed)
    return agglo.agglomerate(mesh, cells_per_part=sizes, **STRAIGHT)


def path(n):
    return sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsr()


@pytest.fixture(scope="module")
def hierarchy():
    return voronoi(500, 21, 8, 64)


@pytest.mark.parametrize("smoother", ["sweeps", "patches", "blocks", "sor"])
@pytest.mark.parametrize("degree", [1, 2])
def test_solution_is_that_of_elimination_in_few_iterations(hierarchy, smoother, degree):
    found = solver(degree=degree, smoother=smoother).solve(Diffusion(source=lambda x: x[:, 0]), hierarchy)
    wanted = spsolve(sparse.csc_array(found.A), found.b)
    e = found.x - wanted
    energy = np.sqrt((e @ (found.A @ e)) / (wanted @ (found.A @ wanted)))
    assert found.converged
    assert energy < 1e-6
    assert 0.3 * energy < found.energy_error < 3 * energy
    assert found.iterations <= (9 if smoother in ("sweeps", "patches") else 16)
    assert found.memory > found.A.nnz * 12


def test_as_many_iterations_as_our_own_recipe_on_the_same_levels():
    hierarchy = voronoi(900, 22, 8, 64)
    ours = default().build("solver", "polydg_mg", recipe="patches", precision="double", cycle="V")
    there = [each.solve(Diffusion(), hierarchy).iterations for each in (ours, solver())]
    assert abs(there[0] - there[1]) <= 1


def test_coarse_functions_are_the_polynomials_of_agglomerates(hierarchy):
    """Unsmoothed, P has a quadratic on the coarsest level as its exact image."""
    how = default().build("solver", "polydg_cg", degree=2, scaled_basis=True).discretisation
    mesh = hierarchy.fine
    A = agglo_petsc.to_petsc(how.assemble(Diffusion(), mesh).A, 6)
    fields = [
        lambda x, k=k: np.stack([x[:, 0] ** 0, *x.T, *(x**2).T, x[:, 0] * x[:, 1]])[k] for k in range(6)
    ]
    B = np.stack([how.project(mesh, field) for field in fields], axis=1)
    levels = agglo_petsc.aggregate_levels(A, agglo_petsc.nested_aggregates(hierarchy.levels), B, smooth=False)
    P, Q = (agglo_petsc.to_scipy(each) for each in levels.prolongations)
    assert P.shape[1] == 6 * hierarchy.parts[0]
    x = how.project(mesh, lambda x: 1 + 3 * x[:, 0] * x[:, 1] - x[:, 1] ** 2)
    whole = (P @ Q).toarray()
    assert np.linalg.norm(x - whole @ np.linalg.lstsq(whole, x)[0]) < 1e-10 * np.linalg.norm(x)


def test_linear_system_takes_near_null_vectors():
    """Two components whose sum and difference are constant on a path: found with them, hardly without."""
    n = 400
    turn = np.kron(np.eye(n), [[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2)
    A = sparse.csr_array(turn.T @ sparse.kron(path(n), np.diag([1.0, 1e-3])).toarray() @ turn)
    B = turn.T @ np.kron(np.ones((n, 1)), np.eye(2))
    mesh = agglo.samples.squares(20)
    hierarchy = agglo.agglomerate(mesh, cells_per_part=4, **STRAIGHT)
    b = np.random.default_rng(3).standard_normal(2 * n)
    found = solver().solve(Linear(A, b, np.arange(n + 1) * 2, B), hierarchy)
    assert found.converged
    assert np.linalg.norm(A @ found.x - b) < 1e-6 * np.linalg.norm(b)
    assert found.iterations < 30


def test_true_residual_is_looked_at(hierarchy):
    found = solver(tolerance=1e-12).solve(Diffusion(), hierarchy)
    r = float(np.linalg.norm(found.b - found.A @ found.x))
    assert found.converged
    assert found.residuals[-1] == pytest.approx(r, rel=1e-6)
    asked = solver(tolerance=1e-9, max_iterations=3).solve(Diffusion(), hierarchy)
    assert not asked.converged
    assert asked.iterations == 3
    assert "after 3 iterations" in asked.reason


def test_indefinite_matrix_is_not_called_solved():
    A = path(36) - 1.5 * sparse.eye_array(36)
    hierarchy = agglo.agglomerate(agglo.samples.squares(6), cells_per_part=4, **STRAIGHT)
    problem = Linear(A, np.ones(36), np.arange(37))
    with pytest.raises(OptionError, match="not positive definite"):
        solver(coarsening="agglomerates").solve(problem, hierarchy)
    found = solver(coarsening="matrix").solve(problem, hierarchy)
    assert not found.converged
    assert found.reason


def test_options_of_petsc_change_the_solver_and_leave_no_trace(hierarchy):
    few = solver(smoother="sor", petsc_options="-mg_levels_ksp_max_it 4").solve(Diffusion(), hierarchy)
    many = solver(smoother="sor", petsc_options={"mg_levels_ksp_max_it": 1}).solve(Diffusion(), hierarchy)
    assert few.iterations < many.iterations
    assert not [name for name in PETSc.Options().getAll() if "mg_" in name]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"petsc_options": "-mg_levels_kps_type cg"}, "mg_levels_kps_type"),
        ({"petsc_options": "-ksp_rtol 1e-3"}, "tolerance"),
        ({"smoother": "jacobi"}, "smoother"),
        ({"tolerance": 2.0}, "tolerance"),
        ({"levels": 9}, "levels"),
    ],
)
def test_what_cannot_be_meant_is_refused(hierarchy, options, told):
    with pytest.raises(OptionError, match=told):
        solver(**options).solve(Diffusion(), hierarchy)


@pytest.mark.parametrize("kind", ["aij", "baij", "sbaij"])
def test_matrices_of_petsc_are_read(kind):
    A = path(12)
    mat = agglo_petsc.to_petsc(A)
    mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    mat = mat.convert(kind)
    assert abs(agglo_petsc.to_scipy(mat) - A).max() == 0.0
    assert abs(rows_of(mat) - A).max() == 0.0


def test_a_matrix_without_entries_is_refused():
    shell = PETSc.Mat().createPython(4, context=object(), comm=PETSc.COMM_SELF)
    shell.setUp()
    with pytest.raises(OptionError, match="python has no accessible entries"):
        agglo_petsc.to_scipy(shell)


def test_linear_problem_of_a_users_matrix_solved_by_our_solvers():
    mat = agglo_petsc.to_petsc(path(64))
    b = mat.createVecLeft()
    b.set(1.0)
    mat.setNearNullSpace(PETSc.NullSpace().create(constant=True, comm=PETSc.COMM_SELF))
    problem = agglo_petsc.linear(mat, b)
    assert problem.near_null.tolist() == [[1.0]] * 64
    hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=8, **STRAIGHT)
    for name in ("direct", "petsc_mg"):
        found = default().build("solver", name, tolerance=1e-10).solve(problem, hierarchy)
        assert np.linalg.norm(path(64) @ found.x - 1.0) < 1e-8
    with pytest.raises(OptionError, match=r"rhs must have shape \(64,\)"):
        agglo_petsc.linear(mat, np.ones(63))


def test_users_ksp_keeps_what_is_its_own(hierarchy):
    how = default().build("solver", "polydg_cg", degree=1).discretisation
    system = how.assemble(Diffusion(), hierarchy.fine)
    mat = agglo_petsc.to_petsc(system.A, 3)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(mat)
    ksp.setType("cg")
    ksp.setOptionsPrefix("mine_")
    ksp.setTolerances(rtol=1e-9, max_it=77)
    PETSc.Options()["mine_mg_levels_pc_type"] = "jacobi"  # the user's own word
    try:
        agglo_petsc.setup(ksp, hierarchy, smoother="sor", cycle="W")
        assert ksp.getPC().getMGSmoother(1).getPC().getType() == "jacobi"
        assert PETSc.Options()["mine_mg_levels_pc_type"] == "jacobi"
    finally:
        PETSc.Options().delValue("mine_mg_levels_pc_type")
    assert ksp.getTolerances()[0] == 1e-9
    b = vector(mat, system.b)
    history = agglo_petsc.solve(ksp, b, tolerance=1e-8)
    assert history.converged
    assert (ksp.getTolerances()[0], ksp.getTolerances()[3]) == (1e-9, 77)
    x = b.duplicate()
    ksp.solve(b, x)
    assert ksp.getConvergedReason() > 0


def test_levels_follow_a_matrix_that_changes(hierarchy):
    """Galerkin products and factors of patches are made anew: twice the matrix takes as many iterations."""
    how = default().build("solver", "polydg_cg", degree=1).discretisation
    system = how.assemble(Diffusion(), hierarchy.fine)
    mat = agglo_petsc.to_petsc(system.A, 3)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(mat)
    ksp.setType("cg")
    agglo_petsc.setup(ksp, hierarchy, smoother="sweeps")
    first = agglo_petsc.solve(ksp, vector(mat, system.b))
    mat.scale(1e6)
    ksp.setOperators(mat)
    second = agglo_petsc.solve(ksp, vector(mat, system.b))
    assert second.iterations == first.iterations
    assert np.allclose(1e6 * second.x, first.x, rtol=1e-5, atol=1e-9)


def test_preconditioner_alone_is_symmetric(hierarchy):
    how = default().build("solver", "polydg_cg", degree=1).discretisation
    mat = agglo_petsc.to_petsc(how.assemble(Diffusion(), hierarchy.fine).A, 3)
    M = agglo_petsc.pc(mat, hierarchy)
    rng = np.random.default_rng(5)
    u, v = (vector(mat, rng.standard_normal(mat.getSize()[0])) for _ in range(2))
    Mu, Mv = u.duplicate(), v.duplicate()
    M.apply(u, Mu)
    M.apply(v, Mv)
    assert v.dot(Mu) == pytest.approx(u.dot(Mv), rel=1e-10)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_dolfinx_mesh_there_and_back(cell):
    dolfinx = pytest.importorskip("dolfinx", reason="DOLFINx tests skipped: no dolfinx here")
    from mpi4py import MPI

    kind = dolfinx.mesh.CellType[cell]
    make = (
        dolfinx.mesh.create_unit_square
        if cell in ("triangle", "quadrilateral")
        else dolfinx.mesh.create_unit_cube
    )
    domain = make(MPI.COMM_SELF, *([4] * (2 if make is dolfinx.mesh.create_unit_square else 3)), kind)
    mesh = agglo_petsc.from_dolfinx(domain)
    assert mesh.cell_measures.sum() == pytest.approx(1.0)
    tdim = domain.topology.dim
    there = dolfinx.mesh.compute_midpoints(domain, tdim, np.arange(mesh.n_cells, dtype=np.int32))
    assert np.allclose(there[:, :tdim], mesh.cell_centroids)
    labels = agglo.agglomerate(mesh, n_parts=4, **STRAIGHT).levels[0]
    tags = agglo_petsc.to_dolfinx(domain, labels)
    assert np.array_equal(tags.values, labels)
    with pytest.raises(OptionError, match="one for each cell of this rank"):
        agglo_petsc.to_dolfinx(domain, labels[1:])
