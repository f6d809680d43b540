"""``agglo solve`` with solvers, discretisations and kinds of problem of one's own; systems in files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cell_values import CellValues, Fluxes, Ring
from command_line import Agglo
from scipy import sparse
from scipy.io import mmwrite
from scipy.sparse.linalg import spsolve

from agglo_core import (
    Component,
    FileError,
    Hierarchy,
    OptionError,
    PluginError,
    Registry,
    agglomerate,
    hookimpl,
    samples,
)
from agglo_core.io.vtk.xml_read import parse
from agglo_core.problems import (
    Diffusion,
    Discretisation,
    Linear,
    Solution,
    discretisation_of,
    named_problem,
    read_problem,
    require_accepted,
)
from agglo_core.registry import default
from agglo_core.solvers.solution_report import report

COMPONENTS = [
    Component("solver", "fluxes", "cell_values:Fluxes"),
    Component("solver", "bare", "cell_values:Bare"),
    Component("problem", "ring", "cell_values:Ring"),
]
PLUGIN = SimpleNamespace(agglo_components=hookimpl(lambda: COMPONENTS))


@pytest.fixture(autouse=True)
def _strangers() -> Iterator[None]:
    default().register(PLUGIN, "strangers")
    yield
    default().unregister("strangers")


def test_json_of_a_stranger_has_the_same_keys_and_its_own_norms(agglo: Agglo) -> None:
    asked = ("solve", "squares:n=16", "--problem", "sine", "--json")
    theirs = json.loads(agglo(*asked, "--solver", "fluxes:tolerance=1e-9").out)
    ours = json.loads(agglo(*asked).out)
    assert [key for key in theirs if key != "error_max"] == list(ours)
    assert theirs["dofs"] == 256
    assert theirs["error_l2"] < theirs["error_max"] < 0.01
    assert theirs["error_dg"] is None
    assert theirs["energy"] == pytest.approx(np.pi**2 / 2, rel=0.01)
    assert theirs["cg_iterations"] == 1  # the sine is an eigenvector


def test_the_measure_of_residuals_and_the_energy_are_the_discretisations(agglo: Agglo) -> None:
    Path("shifted.toml").write_text("source = 8.0\n[dirichlet]\n0 = 1.0\n")
    asked = ("solve", "squares:n=8", "--no-cg", "--json", "--solver")
    shifted = ("--problem", "shifted.toml")
    theirs, bare = (json.loads(agglo(*asked, name, *shifted).out) for name in ("fluxes", "bare"))
    plain = json.loads(agglo(*asked, "fluxes", "--problem", "constant").out)
    assert theirs["energy"] == pytest.approx(plain["energy"] + 8.0, rel=1e-6)
    assert bare["energy"] > 2 * theirs["energy"]  # bᵀx, with what the boundary puts there
    assert theirs["relative_residual"] != bare["relative_residual"]


def test_files_and_pictures_of_a_stranger(agglo: Agglo) -> None:
    pytest.importorskip("matplotlib")
    done = agglo(
        "solve", "squares:n=6", "--solver", "fluxes", "--parts", "4", "-o", "u.vtu", "--plot", "u.png"
    )
    assert done.code == 0
    assert "squares 6x6, fluxes: 36 unknowns, cells 36 → 4" in done.out
    assert "wrote u.vtu" in done.out
    assert Path("u.png").read_bytes().startswith(b"\x89PNG")
    document = parse(Path("u.vtu").read_bytes())
    arrays = {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}
    mesh = samples.squares(6)
    solution = Fluxes().solve(Diffusion(source=8.0), agglomerate(mesh, n_parts=4))
    assert len(arrays["cell"]) == 2 * 36  # two triangles each
    assert arrays["u"] == pytest.approx(np.repeat(solution.x, 4), rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--solver", "bare", "-o", "u.vtu"], "bare has no discretisation to interpret its unknowns"),
        (["--solver", "fluxes", "--degree", "2"], "has no option 'degree'; accepted: tolerance, most"),
        (
            ["--solver", "fluxes", "--problem", "ring"],
            "takes problems of kind diffusion, linear; given one of",
        ),
        (
            ["--problem", "ring:turns=2"],
            "polydg_mg takes problems of kind diffusion, elasticity, linear; given one",
        ),
        (["--problem", "ring.toml"], "ring.toml: turns must be a whole number, and the only key"),
        (["--problem", "what.toml"], "what.toml: no problem is named 'rings' (did you mean 'ring'?)"),
        (["--problem", "kind.toml"], "kind must be the name of a problem kind, given 3"),
        (["--problem", "named.toml"], "cannot be read from a file: select it by its name instead"),
        (["--problem", "sine:n=2"], "problem 'sine' (plugin 'defaults', distribution agglo"),
        (
            ["--problem", "nosuch:n=2"],
            "no problem is named 'nosuch' (constant, diffusion, elasticity, linear, ring, sine)",
        ),
        (
            ["--problem", "diffusion:source=x"],
            "source must be a number, an array with one value per cell, or a callable; given",
        ),
        (
            ["--problem", "diffusion:neumann=1"],
            "neumann must be a mapping from boundary tags to data; given 1: write neumann={0: data} on",
        ),
        (["--problem", "system.toml", "-o", "u.vtu"], "unknowns of problem kind linear: -o, --fluxes and"),
    ],
)
def test_what_does_not_fit_is_one_line(agglo: Agglo, arguments: list[str], message: str) -> None:
    Path("ring.toml").write_text("kind = 'ring'\nturns = 'many'\n")
    Path("what.toml").write_text("kind = 'rings'\n")
    Path("kind.toml").write_text("kind = 3\n")
    Path("named.toml").write_text("kind = 'sine'\n")
    write_system(Path(), samples.squares(4).graph.n)
    before = sorted(Path().iterdir())
    done = agglo("solve", "squares:n=4", *arguments)
    assert (done.code, done.out) == (2, "")
    assert message in done.err
    assert sorted(Path().iterdir()) == before


def test_a_plane_discretisation_refuses_a_solid_mesh(agglo: Agglo) -> None:
    assert "cell values are for the plane" in agglo("solve", "boxes:n=2", "--solver", "fluxes").err
    assert agglo("solve", "boxes:n=3", "--solver", "bare", "--parts", "4").code == 0


def write_system(folder: Path, n: int, width: int = 1) -> tuple[sparse.csr_array, np.ndarray]:
    """``system.toml`` of a tridiagonal matrix."""
    size = n * width
    A = sparse.diags_array([-np.ones(size - 1), np.full(size, 2.5), -np.ones(size - 1)], offsets=[-1, 0, 1])
    b = np.linspace(1, 2, size)
    mmwrite(folder / "A.mtx", A)
    np.save(folder / "b.npy", b)
    (folder / "system.toml").write_text('kind = "linear"\nmatrix = "A.mtx"\nrhs = "b.npy"\n')
    return sparse.csr_array(A), b


@pytest.mark.parametrize("solver", ["polydg_mg_paper", "polydg_cg", "fluxes", "bare"])
@pytest.mark.parametrize("width", [1, 3])
def test_a_linear_system_of_files(agglo: Agglo, solver: str, width: int) -> None:
    Path("files").mkdir()
    A, b = write_system(Path("files"), 64, width)
    done = agglo(
        *("solve", "squares:n=8", "--problem", "files/system.toml", "--solver", solver),
        *("--tol", "1e-9", "--parts", "4", "--json"),
    )
    data = json.loads(done.out)
    assert (done.code, data["converged"], data["dofs"]) == (0, True, 64 * width)
    assert data["error_l2"] is data["error_dg"] is None
    assert data["energy"] == pytest.approx(b @ np.linalg.solve(A.toarray(), b), rel=1e-7)


def test_matrices_and_vectors_in_other_files(tmp_path: Path) -> None:
    mesh = samples.squares(3)
    A, b = write_system(tmp_path, 9, 2)
    sparse.save_npz(tmp_path / "A.npz", A)
    np.savetxt(tmp_path / "b.txt", b)
    mmwrite(tmp_path / "b.mtx", b[:, None])
    for matrix, rhs in (("A.npz", "b.txt"), ("A.mtx", "b.mtx")):
        problem = Linear.from_table({"matrix": matrix, "rhs": rhs, "unknowns": 2}, mesh, tmp_path)
        assert abs(problem.A - A).max() < 1e-12
        assert problem.b == pytest.approx(b)
        assert problem.block_offsets.tolist() == list(range(0, 19, 2))


BAD_SYSTEMS = {
    "key": (
        {"matrx": "A.mtx"},
        "unknown key 'matrx' (did you mean 'matrix'?); accepted: matrix, rhs, unknowns",
    ),
    "no rhs": ({"rhs": None}, "rhs must be the name of a file, not given"),
    "no name": ({"matrix": 3}, "matrix must be the name of a file, given 3"),
    "suffix": ({"matrix": "A.mat"}, "matrix must end in .mtx, .npz, given 'A.mat'"),
    "missing": ({"matrix": "B.mtx"}, "B.mtx: no such file"),
    "nonsense": ({"matrix": "bad.mtx"}, "bad.mtx: line 1: expected %%MatrixMarket"),
    "not an archive": ({"matrix": "bad.npz"}, "bad.npz: not an npz archive"),
    "text": ({"rhs": "bad.txt"}, "bad.txt: line 1: expected a number, found 'what'"),
    "short": ({"rhs": "short.npy"}, "short.npy has 4 numbers; the matrix has 9 rows"),
    "nan": ({"rhs": "nan.npy"}, "nan.npy: holds values that are not finite"),
    "complex": (
        {"rhs": "complex.npy"},
        "complex.npy: array 'complex' has dtype complex128 and shape (9,), expected real numbers",
    ),
    "oblong": ({"matrix": "oblong.npz"}, "must be square, given 9 x 4"),
    "unknowns": ({"unknowns": 2}, "unknowns = 2 on 9 cells gives 18 unknowns, but the matrix has 9 rows"),
    "half": ({"unknowns": 0.5}, "unknowns must be a whole number, at least 1; given 0.5"),
}


@pytest.mark.parametrize("name", BAD_SYSTEMS)
def test_bad_systems_are_refused(tmp_path: Path, name: str) -> None:
    changes, message = BAD_SYSTEMS[name]
    write_system(tmp_path, 9)
    for bad in ("bad.mtx", "bad.npz", "bad.txt"):
        (tmp_path / bad).write_text("what is this?")
    np.save(tmp_path / "short.npy", np.ones(4))
    np.save(tmp_path / "nan.npy", np.full(9, np.nan))
    np.save(tmp_path / "complex.npy", np.ones(9, complex))
    sparse.save_npz(tmp_path / "oblong.npz", sparse.csr_array(np.ones((9, 4))))
    table = {key: value for key, value in ({"matrix": "A.mtx", "rhs": "b.npy"} | changes).items() if value}
    with pytest.raises((OptionError, FileError)) as refused:
        Linear.from_table(table, samples.squares(3), tmp_path)
    assert message in str(refused.value)


def test_rows_that_cells_cannot_share(tmp_path: Path) -> None:
    write_system(tmp_path, 10)
    with pytest.raises(
        FileError, match=r"system\.toml: matrix: its 10 rows cannot be divided equally among 9"
    ):
        read_problem(tmp_path / "system.toml", samples.squares(3))


@pytest.mark.parametrize("mesh", [samples.squares(1), samples.boxes(3), samples.disconnected(4)], ids=repr)
def test_examples_have_one_solution(mesh: object) -> None:
    system = Linear.example(mesh)
    assert np.linalg.cond(system.A.toarray()) < 1e3
    assert Diffusion.example(mesh).kind == "diffusion"


def test_names_are_looked_up_in_the_registry_given(tmp_path: Path) -> None:
    registry, mesh = Registry(), samples.squares(2)
    registry.register(PLUGIN, "mine")
    assert named_problem("ring", mesh, {"turns": 3}, registry) == Ring(3)
    with pytest.raises(FileError, match=r"sine: no such file, and no problem of that name \(ring\)"):
        named_problem("sine", mesh, registry=registry)
    (tmp_path / "r.toml").write_text("kind = 'ring'\nturns = 4\n")
    assert read_problem(tmp_path / "r.toml", mesh, registry) == Ring(4)
    registry.block("mine")
    with pytest.raises(PluginError, match="blocked"):
        named_problem("ring", mesh, registry=registry)


def test_posed_on_drops_an_exact_solution_without_its_data() -> None:
    square, ring = samples.squares(4), samples.boxes(2)
    everywhere = Diffusion(exact=lambda x: np.prod(x * (1 - x), axis=1))
    assert everywhere.posed_on(square) is everywhere
    assert everywhere.posed_on(ring) is everywhere
    elsewhere = Diffusion(exact=lambda x: x[:, 0])
    assert elsewhere.posed_on(square).exact is None
    held = Diffusion(exact=lambda x: x[:, 0], dirichlet={0: lambda x: x[:, 0]})
    assert held.posed_on(square) is held


def test_missing_methods_of_a_discretisation_are_named() -> None:
    half = SimpleNamespace(discretisation=SimpleNamespace(accepts=("diffusion",), sample=len))
    with pytest.raises(OptionError, match="lacks assemble, check, coarse_operator, errors, evaluate"):
        discretisation_of(half, Diffusion())


def test_who_accepts_and_who_tells() -> None:
    solver, linear = Fluxes(), Linear(sparse.eye_array(4), np.ones(4), np.arange(5))
    assert isinstance(solver.discretisation, Discretisation)
    assert isinstance(discretisation_of(solver, Diffusion()), CellValues)
    assert discretisation_of(solver, linear) is None
    assert discretisation_of(object(), Diffusion()) is None
    require_accepted(object(), Ring())
    with pytest.raises(
        OptionError, match="Fluxes takes problems of kind diffusion, linear; given one of kind r"
    ):
        require_accepted(solver, Ring())


def test_the_command_stands_without_polydg(tmp_path: Path) -> None:
    source = f"""
import io, json, sys
sys.path.append({str(Path(__file__).parents[2])!r})
from contextlib import redirect_stderr, redirect_stdout
from types import SimpleNamespace
from agglo_core import Component, hookimpl
from agglo_core.cli import main
from agglo_core.solvers.solution_report import report
from agglo_core.registry import default
theirs = [Component("solver", "fluxes", "cell_values:Fluxes")]

def run(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main(["solve", *arguments])
        except SystemExit as end:
            return end.code, out.getvalue(), err.getvalue()

done = [run("--help"), run("squares:n=4")]
default().register(SimpleNamespace(agglo_components=hookimpl(lambda: theirs)), "theirs")
done.append(run("squares:n=4", "--solver", "fluxes", "--parts", "4"))
print(json.dumps(done))
"""
    environment = {**os.environ, "AGGLO_BLOCK": "polydg_mg"}
    command = [sys.executable, "-c", source]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
    (code, *_), refused, solved = json.loads(done.stdout)
    assert code == 0
    assert refused[:2] == [2, ""]
    assert "no solver is named 'polydg_mg'; available: " in refused[2]
    assert "blocked by AGGLO_BLOCK; choose another component with --solver" in refused[2]
    assert "converged after" in solved[1]


class Direct:
    """A solver of one method, which has no levels to tell of."""

    def solve(self, problem: Linear, hierarchy: Hierarchy) -> Solution:
        """By elimination."""
        x = spsolve(problem.A.tocsc(), problem.b)
        return Solution(x, problem.A, problem.b, [], np.zeros(1), True, "solved", 0, {})


def test_a_solver_without_levels_is_reported_as_one_level() -> None:
    mesh = samples.squares(4)
    weights = mesh.graph.to_scipy()
    A = sparse.csr_array(sparse.diags_array(weights.sum(axis=1) + 1) - weights)
    problem = Linear(A, np.ones(16), np.arange(17))
    data = report(mesh, problem, Direct().solve(problem, agglomerate(mesh, n_parts=4)))
    assert (data["dofs"], data["operator_complexity"]) == (16, 1.0)
    assert data["levels"] == [{"cells": 16, "dofs": 16, "nonzeros": A.nnz}]
    assert data["relative_residual"] < 1e-12
