"""The direct solver: right with every backend, honest about its error, and what precondition others."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Agglo
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import cg, spsolve

import agglo_core as agglo
from agglo_core import AggloError, OptionError, agglomerate, samples
from agglo_core.problems import Diffusion, Linear
from agglo_core.solvers import backends as direct_backends
from agglo_core.solvers.backends import BACKENDS, choose_backend, superlu
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.plain_cg import PlainCG

RNG = np.random.default_rng


class PyPardisoError(Exception):
    """What pypardiso raises."""


class FakePardiso:
    """Takes what PARDISO takes: the upper triangle with its whole diagonal, by sorted rows, columns of b."""

    alive = 0

    def __init__(self, mtype: int = 11) -> None:
        self.mtype, self.held = mtype, False
        FakePardiso.alive += 1

    def factorize(self, A: sparse.csr_matrix) -> None:
        assert self.mtype in (2, -2)
        assert (A.format, A.dtype, A.has_sorted_indices) == ("csr", np.float64, True)
        rows, columns = np.repeat(np.arange(A.shape[0]), np.diff(A.indptr)), A.indices
        assert (rows <= columns).all()
        assert np.count_nonzero(rows == columns) == A.shape[0]
        whole = (A + sparse.triu(A, 1).T).toarray()
        if self.mtype == 2 and np.linalg.eigvalsh(whole).min() <= 0:
            raise PyPardisoError(-4)
        self.matrix, self.whole = A, whole

    def solve(self, A: sparse.csr_matrix, b: np.ndarray) -> np.ndarray:
        assert A is self.matrix
        assert b.flags.f_contiguous
        return np.linalg.solve(self.whole, b)

    def free_memory(self, everything: bool = False) -> None:
        assert everything
        FakePardiso.alive -= 1


class CholmodError(Exception):
    """What CHOLMOD raises."""


def dense_cholesky(A: sparse.csc_matrix) -> object:
    """Factors that solve when called, as in scikit-sparse 0.4, or by a method, as since 0.5."""
    assert (A.format, A.has_sorted_indices) == ("csc", True)
    try:
        factors = cho_factor(A.toarray())
    except np.linalg.LinAlgError as error:
        raise CholmodError(str(error)) from error
    return lambda b: cho_solve(factors, b)


FAKES = {
    "pardiso": ("pypardiso", {"PyPardisoSolver": FakePardiso, "PyPardisoError": PyPardisoError}),
    "cholmod": ("sksparse", {"cholesky": dense_cholesky, "CholmodError": CholmodError}),
    "cholmod 0.5": (
        "sksparse",
        {"cho_factor": lambda A: SimpleNamespace(solve=dense_cholesky(A)), "CholmodError": CholmodError},
    ),
}


@pytest.fixture(params=[*FAKES, "superlu"])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a backend, installed for as long as the test lasts."""
    if request.param != "superlu":
        package, names = FAKES[request.param]
        module = "pypardiso.pardiso_wrapper" if package == "pypardiso" else "sksparse.cholmod"
        monkeypatch.setitem(sys.modules, package, SimpleNamespace(__path__=[]))
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**names))
    return str(request.param).split()[0]


@pytest.fixture
def _nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    _uninstall(monkeypatch, "pypardiso", "sksparse")


def _uninstall(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    """Make imports of packages fail, those of modules that are imported already, too."""
    for name in packages:
        for module in [name, *(each for each in sys.modules if each.startswith(f"{name}."))]:
            monkeypatch.setitem(sys.modules, module, None)


def definite(n: int, seed: int = 0) -> sparse.csr_array:
    """A matrix like those of diffusion, its diagonal far from constant."""
    rng = RNG(seed)
    links = sparse.random_array((n, n), density=0.05, rng=rng, format="csr")
    links = links + links.T
    scale = sparse.diags_array(10 ** rng.uniform(-2, 2, n))
    return sparse.csr_array(scale @ (sparse.diags_array(links.sum(axis=1) + 0.1) - links) @ scale)


def test_one_or_several_right_hand_sides(backend: str) -> None:
    A, B = definite(90), RNG(1).standard_normal((90, 3))
    solves = BACKENDS[backend](A)
    wanted = np.linalg.solve(A.toarray(), B)
    assert solves(B) == pytest.approx(wanted, rel=1e-8)
    assert solves(B[:, 1]) == pytest.approx(wanted[:, 1], rel=1e-8)


def test_the_whole_solver(backend: str) -> None:
    mesh = samples.voronoi(60, seed=4)
    kappa = 10 ** RNG(5).uniform(-3, 3, mesh.n_cells)
    it = Direct(degree=2, backend=backend).solve(Diffusion(kappa), agglomerate(mesh, n_parts=6))
    assert it.converged
    assert it.tests == ("residual", "energy error")
    assert it.iterations == 1
    assert it.residuals[-1] == np.linalg.norm(it.b - it.A @ it.x) < 1e-9 * it.residuals[0]
    x = np.linalg.solve(it.A.toarray(), it.b)
    assert it.x == pytest.approx(x, rel=1e-7, abs=1e-9 * abs(x).max())
    assert set(it.seconds) == {"assemble", "setup", "solve"}


def test_matrices_that_are_not_definite(backend: str) -> None:
    """PARDISO and SuperLU solve with them, a zero on the diagonal too; CHOLMOD says no."""
    mesh = samples.squares(5)
    A = sparse.csr_array(mesh.graph.to_scipy() * np.sqrt(2.0) - 1.3 * sparse.eye_array(25))
    A[3, 3] = 0.0
    A.eliminate_zeros()
    b = RNG(2).standard_normal(25)
    it = Direct(backend=backend).solve(Linear(A, b, np.arange(26)), agglomerate(mesh, n_parts=4))
    if backend == "cholmod":
        assert not it.converged
        assert "CHOLMOD: the matrix is not positive definite" in it.reason
    else:
        assert it.converged
        assert it.x == pytest.approx(np.linalg.solve(A.toarray(), b))


def test_memory_of_mkl_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pypardiso", SimpleNamespace(__path__=[]))
    names = SimpleNamespace(**FAKES["pardiso"][1])
    monkeypatch.setitem(sys.modules, "pypardiso.pardiso_wrapper", names)
    gc.collect()  # the factors of other tests
    before = FakePardiso.alive
    solves = BACKENDS["pardiso"](definite(8) - 5.0 * sparse.eye_array(8))
    assert FakePardiso.alive == before + 1  # the Cholesky factors that failed are gone
    del solves
    gc.collect()
    assert FakePardiso.alive == before


def test_pypardiso_is_given_the_path_of_mkl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Otherwise each of its solvers searches the environment, which outweighs small factorisations."""
    metadata = tmp_path / "mkl-2099.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: mkl\nVersion: 2099.0\n")
    (metadata / "RECORD").write_text("lib/libmkl_core.so.3,,\nlib/libmkl_rt.so.3,,\n")
    (tmp_path / "lib").mkdir()
    for name in ("libmkl_core.so.3", "libmkl_rt.so.3"):  # Python 3.12 and later list only files that exist
        (tmp_path / "lib" / name).touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv("PYPARDISO_MKL_RT", raising=False)
    direct_backends._mkl_from_package.cache_clear()
    paths: list[str | None] = []

    class Searching(FakePardiso):
        def __init__(self, mtype: int = 11) -> None:
            super().__init__(mtype)
            paths.append(os.environ.get("PYPARDISO_MKL_RT"))

    names = {"PyPardisoSolver": Searching, "PyPardisoError": PyPardisoError}
    monkeypatch.setitem(sys.modules, "pypardiso", SimpleNamespace(__path__=[]))
    monkeypatch.setitem(sys.modules, "pypardiso.pardiso_wrapper", SimpleNamespace(**names))
    try:
        BACKENDS["pardiso"](definite(8))
        assert paths == [str(tmp_path / "lib/libmkl_rt.so.3")]
        assert "PYPARDISO_MKL_RT" not in os.environ
        monkeypatch.setenv("PYPARDISO_MKL_RT", "the user's")
        BACKENDS["pardiso"](definite(8))
        assert paths[1] == os.environ["PYPARDISO_MKL_RT"] == "the user's"
    finally:
        direct_backends._mkl_from_package.cache_clear()


@pytest.mark.usefixtures("_nothing_installed")
def test_what_is_not_installed_is_named() -> None:
    assert choose_backend("auto") == "superlu"
    with pytest.raises(OptionError, match=r"backend 'pardiso' needs pypardiso: pip install pypardiso"):
        Direct(backend="pardiso")
    with pytest.raises(OptionError, match=r"needs scikit-sparse: pip install scikit-sparse"):
        Direct(backend="cholmod")
    with pytest.raises(
        OptionError, match=r"backend must be one of auto, pardiso, cholmod, superlu; given 'm"
    ):
        Direct(backend="mumps")


def test_the_fastest_that_is_installed_is_taken(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {"pardiso": "pypardiso", "cholmod": "sksparse", "superlu": ""}[backend]
    _uninstall(monkeypatch, *({"pypardiso", "sksparse"} - {kept}))
    assert choose_backend("auto") == backend


def rough(A: sparse.csr_array) -> object:
    """A factorisation of another matrix: refinement has to work."""
    return superlu(A + 1e-3 * sparse.diags_array(A.diagonal()))


def test_a_rough_factorisation_is_refined(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agglo_core.solvers.direct.BACKENDS", {**BACKENDS, "superlu": rough})
    hierarchy = agglomerate(samples.squares(6), n_parts=4)
    found = {
        most: Direct(backend="superlu", max_refinements=most, tolerance=1e-8).solve(Diffusion(), hierarchy)
        for most in (0, 1, 20)
    }
    assert [each.converged for each in found.values()] == [False, False, True]
    assert found[0].iterations == 1
    assert "after 1 iterations, required 1.0e-08" in found[0].reason
    wanted = spsolve(sparse.csc_array(found[20].A), found[20].b)
    for it in found.values():
        e = it.x - wanted
        error = np.sqrt(e @ (it.A @ e) / (wanted @ it.b))
        assert it.energy_error == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize("factorise", [superlu, rough])
def test_factors_in_use_again_take_one_solve_and_bound_the_error(
    monkeypatch: pytest.MonkeyPatch, factorise: Callable[[object], Callable[[object], object]]
) -> None:
    calls: list[int] = []

    def counted(A: object) -> Callable[[object], object]:
        solves = factorise(A)
        return lambda b: (calls.append(1), solves(b))[1]

    monkeypatch.setattr("agglo_core.solvers.direct.BACKENDS", {"superlu": counted})
    mesh = samples.voronoi(200, seed=4)
    problem = Diffusion(10 ** RNG(5).uniform(-1, 1, mesh.n_cells), reaction=100.0)
    steps = Direct(2, 1e-6, 99, backend="superlu").repeated(agglomerate(mesh, n_parts=6))
    counts, sharpness = [], []
    for k in range(6):
        load = RNG(k).standard_normal(6 * mesh.n_cells) if k else np.zeros(6 * mesh.n_cells)
        calls.clear()
        it = steps.solve_again(load) if k else steps.solve(problem)
        counts.append(len(calls))
        assert it.converged
        e = it.x - spsolve(sparse.csc_array(it.A), it.b)
        sharpness.append(it.energy_error / np.sqrt(e @ (it.A @ e) / (it.x @ it.b)))
    if factorise is superlu:
        assert counts == [2, 5, 1, 1, 1, 1]  # with four inverse iterations
        assert min(sharpness) > 1.0
    else:  # every answer needs refinement, and a solve that estimates its error
        assert min(counts) > 2
        assert min(sharpness) > 0.5


def test_factors_of_a_matrix_that_is_not_definite_are_used_again() -> None:
    mesh = samples.squares(5)
    A = sparse.csr_array(mesh.graph.to_scipy() * np.sqrt(2.0) - 1.3 * sparse.eye_array(25))
    for sign in (1.0, -1.0):
        steps = Direct(backend="superlu").repeated(agglomerate(mesh, n_parts=4))
        for k in range(3):
            b = RNG(k).standard_normal(25)
            it = steps.solve(Linear(sign * A, b, np.arange(26)))
            assert it.converged
            assert it.x == pytest.approx(np.linalg.solve(sign * A.toarray(), b))
        assert steps.setups == 1


def test_a_singular_matrix_is_flagged() -> None:
    mesh = samples.squares(4)
    links = mesh.graph.to_scipy()
    A = sparse.csr_array(sparse.diags_array(links.sum(axis=1)) - links)
    for b in (np.ones(16), np.arange(16.0)):
        it = Direct(backend="superlu").solve(Linear(A, b, np.arange(17)), agglomerate(mesh, n_parts=4))
        assert not it.converged
        assert "singular" in it.reason
    empty = Linear(sparse.csr_array((16, 16)), np.ones(16), np.arange(17))
    with pytest.raises(OptionError, match="cannot precondition with the inverse"):
        Direct(backend="superlu").aspreconditioner(empty, agglomerate(mesh, n_parts=4))


def test_preconditioners() -> None:
    hierarchy = agglomerate(samples.voronoi(50, seed=1), n_parts=5)
    it = Direct(backend="superlu").solve(Diffusion(), hierarchy)
    counts = []
    for solver in (Direct(backend="superlu"), PlainCG()):
        M, steps = solver.aspreconditioner(Diffusion(), hierarchy), []
        x, failed = cg(it.A, it.b, rtol=1e-10, M=M, callback=steps.append)
        assert failed == 0
        assert x == pytest.approx(it.x, rel=1e-6)
        counts.append(len(steps))
    assert counts[0] == 1 < counts[1]
    B = RNG(0).standard_normal((len(it.b), 3))
    inverse = Direct(backend="superlu").aspreconditioner(Diffusion(), hierarchy)
    assert it.A @ (inverse @ B) == pytest.approx(B, abs=1e-8)
    with pytest.raises(OptionError, match="makes it nonlinear"):
        PaperMultigrid().aspreconditioner(Diffusion(), hierarchy)


def test_on_the_command_line_no_levels_are_made(agglo: Agglo) -> None:
    done = agglo("solve", "squares:n=8", "--solver", "direct:backend=superlu", "--degree", "2", "--json")
    data = json.loads(done.out)
    assert (done.code, data["converged"], data["iterations"]) == (0, True, 1)
    assert data["levels"] == [{"cells": 64, "dofs": 384, "nonzeros": (64 + 2 * 112) * 36}]
    assert data["cg_iterations"] > 50
    asked = ("squares:n=8", "--degree", "2", "--tol", "1e-9", "--solver", "polydg_mg_paper", "--json")
    paper = agglo("solve", *asked).data
    assert data["energy"] == pytest.approx(paper["energy"], rel=1e-7)
    assert agglo("solve", "squares:n=8", "--solver", "direct", "--parts", "99").code == 2


@pytest.mark.parametrize("backend", ["auto", "superlu"])
def test_nonsymmetric_matrices_are_solved_on_request(backend: str) -> None:
    mesh, rng = samples.voronoi(60, seed=1), np.random.default_rng(0)
    dense, b = rng.normal(size=(120, 120)), rng.normal(size=120)  # without a definite symmetric part
    solver = Direct(tolerance=1e-10, backend=backend)
    solution = solver.solve(Linear(dense, b, 2, symmetric=False), agglomerate(mesh, n_parts=4))
    assert solution.converged
    assert solution.energy_error is None
    assert solution.tests == ("residual",)
    assert solution.x == pytest.approx(np.linalg.solve(dense, b), rel=1e-8)


@pytest.mark.parametrize("solver", ["direct", "polydg_mg", "multigrid"])
def test_nonsymmetric_matrices_are_refused_with_the_option(solver: str) -> None:
    mesh = samples.voronoi(60, seed=1)
    A = sparse.csr_array(np.eye(60, k=1) + 4.0 * np.eye(60))
    hierarchy = agglomerate(mesh, n_parts=4)
    with pytest.raises(
        AggloError,
        match=r"A must be symmetric: .*; give Linear\(A, b, symmetric=False\) to",
    ):
        agglo.solve(hierarchy, Linear(A, np.ones(60)), solver=solver)
    if solver == "multigrid":
        with pytest.raises(AggloError, match="A must be symmetric: the entry"):
            agglo.solve(hierarchy, Linear(A, np.ones(60), symmetric=False), solver=solver)


def test_singular_nonsymmetric_matrices_do_not_converge() -> None:
    A = np.eye(4, k=1) + np.diag([1.0, 1.0, 1.0, 0.0])
    solution = Direct(backend="superlu").solve(
        Linear(A, np.ones(4), symmetric=False), agglomerate(samples.squares(2), n_parts=2)
    )
    assert not solution.converged
    with pytest.raises(OptionError, match="symmetric must be True or False, given 'no'"):
        Linear(A, np.ones(4), symmetric="no")  # type: ignore[arg-type]
