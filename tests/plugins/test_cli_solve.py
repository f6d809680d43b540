"""``agglo solve``."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import Agglo

from agglo_core import FileError, read, samples, write
from agglo_core.io.vtk.xml_read import parse

H_STAR = "0.17677669529663687,0.35355339059327373,0.7071067811865476"


def test_json_of_the_papers_case(agglo: Agglo) -> None:
    asked = ("--h-star", H_STAR, "--levels", "3", "--degree", "2", "--solver", "polydg_mg_paper", "--json")
    done = agglo("solve", "paper:triangles", *asked)
    assert done.code == 0
    data = done.data
    assert list(data) == [
        "dofs",
        "levels",
        "iterations",
        "converged",
        "reason",
        "relative_residual",
        "energy_error",
        "tests_met",
        "residuals",
        "error_l2",
        "error_dg",
        "energy",
        "operator_complexity",
        "cg_iterations",
        "seconds",
        "cpu_seconds",
        "grid_complexity",
        "contraction",
        "asymptotic_contraction",
        "memory",
        "choice",
        "advice",
        "tolerance",
        "energy_errors",
        "outcome",
        "backward_error",
        "integral",
    ]
    assert (data["dofs"], data["iterations"], data["converged"]) == (768, 10, True)
    assert [(each["cells"], each["dofs"]) for each in data["levels"]] == [(n, 6 * n) for n in (128, 64, 16)]
    assert sum(each["nonzeros"] for each in data["levels"]) == pytest.approx(
        data["operator_complexity"] * data["levels"][0]["nonzeros"]
    )
    assert data["cg_iterations"] == pytest.approx(355, rel=0.02)
    assert len(data["residuals"]) == 11
    assert data["relative_residual"] == data["residuals"][-1] / data["residuals"][0] <= 1e-6
    assert data["error_l2"] is data["error_dg"] is None
    assert 64 * 0.0350 < data["energy"] < 64 * 0.0352  # ∫ f u = 64 · 0.03514 on the unit square
    assert 1 < data["operator_complexity"] < 2
    assert data["grid_complexity"] == (128 + 64 + 16) / 128
    assert data["contraction"] == pytest.approx(data["relative_residual"] ** 0.1)
    assert 0.0 < data["asymptotic_contraction"] < 1.0
    for seconds in (data["seconds"], data["cpu_seconds"]):
        assert list(seconds) == ["hierarchy", "assemble", "setup", "solve"]
    assert data["tolerance"] == 1e-6
    assert (data["outcome"], data["backward_error"]) == ("converged", None)


def test_levels_without_agglomerates_print_their_unknowns(agglo: Agglo) -> None:
    data = agglo("solve", "voronoi:n=900", "--json", "--no-cg").data
    cells, dofs = ([level[name] for level in data["levels"]] for name in ("cells", "dofs"))
    assert (cells[0], dofs[0], set(cells[1:])) == (900, 2700, {None})
    done = agglo("solve", "voronoi:n=900", "--no-cg")
    assert f"cells 900, unknowns {' → '.join(f'{n:,}' for n in dofs)}" in " ".join(done.out.split())
    assert max(map(len, done.out.splitlines())) <= 80
    patches = agglo("solve", "voronoi:n=900", "--solver", "polydg_mg:recipe=patches", "--no-cg")
    assert "2,700 unknowns, cells 900 → 1" in patches.out


def test_errors_of_the_sine_fall_with_the_degree(agglo: Agglo) -> None:
    asked = ("squares:n=8", "--problem", "sine", "--tol", "1e-9", "--no-cg", "--json")
    found = [agglo("solve", *asked, "--degree", degree).data for degree in "123"]
    for error in ("error_l2", "error_dg"):
        first, second, third = (data[error] for data in found)
        assert first > 4 * second > 16 * third > 0
    assert [data["cg_iterations"] for data in found] == [None, None, None]
    assert found[2]["energy"] == pytest.approx(math.pi**2 / 2, rel=1e-3)


def test_text_files_and_pictures(agglo: Agglo) -> None:
    pytest.importorskip("matplotlib")
    done = agglo("solve", "voronoi:n=60", "--problem", "sine", "-o", "u.vtu", "--plot", "u.png")
    assert done.code == 0
    for part in (": cells 60, unknowns 180 → ", "converged after", "error: L2", "wrote u.vtu", "wrote u.png"):
        assert part in done.out
    assert Path("u.png").read_bytes().startswith(b"\x89PNG")
    assert read("u.vtu").n_cells > 60


def test_fluxes_go_to_a_file_and_are_summed_by_boundary_tag(agglo: Agglo) -> None:
    asked = ("solve", "squares:n=8", "--fluxes", "f.vtu", "--no-cg")
    done = agglo(*asked)
    assert (done.code, done.out.splitlines()[-1]) == (0, "wrote f.vtu")
    assert "flux out of the boundary with tag 0: 8" in done.out
    data = agglo(*asked, "--json", "--tol", "1e-10").data
    assert data["boundary_fluxes"] == {"0": pytest.approx(8.0, rel=1e-9)}
    assert data["integral"] == pytest.approx(data["energy"] / 8.0)
    assert agglo("solve", "squares:n=8", "--fluxes", "f.csv").code == 2


def test_forces_on_the_boundary_are_summed_by_tag(agglo: Agglo) -> None:
    """The held boundary bears the weight of the unit square."""
    Path("weight.toml").write_text('kind = "elasticity"\nforce = [0.0, -1.0]\n', encoding="utf-8")
    arguments = ("solve", "squares:n=8", "--problem", "weight.toml", "--fluxes", "f.vtu", "--no-cg")
    assert "force on the boundary with tag 0: (" in agglo(*arguments).out
    data = agglo(*arguments, "--json", "--tol", "1e-10").data
    assert data["boundary_fluxes"]["0"] == pytest.approx([0.0, 1.0], abs=1e-8)
    assert data["integral"] == pytest.approx([0.0, -data["energy"]], abs=1e-9)


def test_convergence_is_drawn(agglo: Agglo) -> None:
    pytest.importorskip("matplotlib")
    done = agglo("solve", "squares:n=8", "--plot-convergence", "c.svg", "--no-cg", "--degree", "2")
    data = agglo("solve", "squares:n=8", "--json", "--no-cg", "--degree", "2").data
    assert (done.code, done.out.splitlines()[-1]) == (0, "wrote c.svg")
    comments = re.findall("<!-- (.*) -->", Path("c.svg").read_text())  # the texts that are drawn as paths
    assert f"polydg_mg: residual, contraction {data['contraction']:.3g}" in comments
    assert "polydg_mg: energy error, estimated" in comments
    assert {"tolerance 1e-06", "iteration", "squares 8x8, constant"} <= set(comments)


def test_a_report_of_what_was_solved(agglo: Agglo) -> None:
    for more in ((), ("--parts", "16"), ("--solver", "direct")):
        done = agglo("solve", "squares:n=8", "--report", "r.html", "--no-cg", *more)
        assert (done.code, done.out.splitlines()[-1]) == (0, "wrote r.html")
        page = Path("r.html").read_text()
        assert re.search(r"Converged after \d+ iterations: tolerance met by residual and energy error", page)
        assert page.count('<h2 id="solve-title">') == 1
        assert ("<canvas" in page) == ("--parts" in more)
        assert ('<th scope="row">hierarchy</th>' in page) == ("--parts" in more)
    assert agglo("solve", "squares:n=8", "--report", "r.txt").code == 2


def test_components_targets_and_levels_that_do_not_nest(agglo: Agglo) -> None:
    pytest.importorskip("pymetis")
    done = agglo(
        "solve",
        "paper:squares",
        *("--bisector", "metis:edge_weights=false,vertex_weights=false", "--method", "kway"),
        *("--not-nested", "--refiner", "none", "--parts", "64,16", "--seed", "3"),
        *("--solver", "polydg_mg_paper:penalty=12,coarse_solver=dense", "--smoothing-steps", "5", "--json"),
    )
    assert done.code == 0
    data = done.data
    assert [level["cells"] for level in data["levels"]] == [256, 64, 16]


def test_a_problem_of_a_file(agglo: Agglo) -> None:
    Path("problem.toml").write_text("kappa = 2.0\nsource = 16.0\n")
    ours = agglo("solve", "squares:n=4", "--problem", "problem.toml", "--json").data
    constant = agglo("solve", "squares:n=4", "--json").data
    assert ours["energy"] == pytest.approx(2 * constant["energy"], rel=1e-5)


def test_smoother_and_coarse_solver_are_chosen_by_name(agglo: Agglo) -> None:
    asked = ("solve", "squares:n=8", "--json", "--no-cg", "--tol", "1e-9", "--solver")
    found = {
        (smoother, coarse): agglo(*asked, f"polydg_mg_paper:smoother={smoother},coarse_solver={coarse}").data
        for smoother in ("schwarz", "block_jacobi")
        for coarse in ("lu", "dense")
    }
    assert len({round(data["energy"], 6) for data in found.values()}) == 1
    steps = {names: data["iterations"] for names, data in found.items()}
    assert abs(steps["schwarz", "lu"] - steps["schwarz", "dense"]) <= 1  # rounding differs
    assert steps["block_jacobi", "lu"] > 2 * steps["schwarz", "lu"]


def test_plain_conjugate_gradients_are_a_solver_of_their_own(agglo: Agglo) -> None:
    data = agglo("solve", "paper:squares", "--solver", "polydg_cg:degree=2", "--json").data
    assert data["iterations"] == data["cg_iterations"] == pytest.approx(365, rel=0.01)
    (level,) = data["levels"]
    assert (level["cells"], level["dofs"]) == (256, 6 * 256)
    assert len(data["energy_errors"]) == data["iterations"] + 1
    done = agglo("solve", "squares:n=8", "--solver", "polydg_cg:max_iterations=5")
    assert done.code == 3
    assert "of 5, required 1.0e-06; the solution is from iteration" in " ".join(done.out.split())
    assert "plain conjugate gradients" not in done.out


def test_energy_is_the_work_of_the_loads(agglo: Agglo) -> None:
    """u = 1 on the boundary adds 1 to u, and with it ∫ f to the energy; b holds the penalty of 1 as well."""
    Path("shifted.toml").write_text("source = 8.0\n[dirichlet]\n0 = 1.0\n")
    asked = ("solve", "squares:n=8", "--tol", "1e-10", "--json", "--no-cg")
    shifted, plain = (agglo(*asked, *more).data for more in (("--problem", "shifted.toml"), ()))
    assert shifted["energy"] == pytest.approx(plain["energy"] + 8.0, rel=1e-6)


def test_a_strong_contrast_is_solved_or_said_not_to_be(agglo: Agglo) -> None:
    mesh = samples.squares(8)
    left = mesh.points[mesh.face_pairs][:, :, 0] == 0.0
    right = mesh.points[mesh.face_pairs][:, :, 0] == 1.0
    sides = left.all(axis=1) + 2 * right.all(axis=1)
    material = 1 + (mesh.cell_centroids[:, 0] > 0.5)
    write("m.npz", replace(mesh, cell_tags={"material": material}, face_tags={"boundary": sides.astype(int)}))
    Path("jump.toml").write_text("source = 0\n[kappa.material]\n1 = 1\n2 = 1e6\n[dirichlet]\n1 = 0\n2 = 1\n")
    for solver in ("polydg_mg", "polydg_mg_paper", "polydg_cg"):
        more = ("--solver", solver)
        data = agglo("solve", "m.npz", "--problem", "jump.toml", "--json", *more).data
        assert data["converged"]
        assert data["relative_residual"] <= 1e-6
        assert data["cg_iterations"] > 50
        assert data["tests_met"] == ["residual", "energy error"]
        assert 0.0 < data["energy_error"] <= 1e-6
        assert data["energy"] == 0.0


def test_the_report_of_what_did_not_converge(agglo: Agglo) -> None:
    done = agglo("solve", "squares:n=8", "--solver", "polydg_mg_paper:max_iterations=2", "--json")
    data = done.data
    assert (done.code, data["converged"], data["iterations"]) == (3, False, 2)
    assert len(data["residuals"]) == 3
    assert data["relative_residual"] == data["residuals"][2] / data["residuals"][0] > 1e-6
    assert "after 2 iterations, required" in data["reason"]


def test_energy_and_errors_are_those_of_the_function(agglo: Agglo) -> None:
    """∫ f u_h with f = 2π² sin πx sin πy, and the norms of u − u_h, by quadrature of the file's values."""
    data = agglo("solve", "squares:n=16", "--problem", "sine", "--json", "-o", "u.vtu").data
    document = parse(Path("u.vtu").read_bytes())
    arrays = {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}
    corners = arrays["connectivity"].reshape(-1, 3)
    x, y, _ = arrays["Points"].reshape(-1, 3)[corners].mean(axis=1).T
    exact, found = np.sin(np.pi * x) * np.sin(np.pi * y), arrays["u"][corners].mean(axis=1)
    area = 1.0 / len(corners)
    assert data["energy"] == pytest.approx(2 * np.pi**2 * (exact * found).sum() * area, rel=0.01)
    assert data["error_l2"] == pytest.approx(math.sqrt(((exact - found) ** 2).sum() * area), rel=0.2)
    assert data["error_dg"] > data["error_l2"]


def test_a_failed_picture_costs_no_result(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise FileError("u.png: no space left")

    monkeypatch.setattr("agglo_core.draw.solution.draw_solution", fail)
    done = agglo("solve", "squares:n=4", "-o", "u.vtu", "--plot", "u.png")
    assert (done.code, list(Path().iterdir())) == (3, [Path("u.vtu")])
    assert "converged after" in done.out
    assert "wrote u.vtu" in done.out
    assert "error: u.png: no space left" in done.err


def test_problems_that_have_no_solution(agglo: Agglo) -> None:
    Path("flux.toml").write_text("[neumann]\n0 = 1.0\n")
    done = agglo("solve", "squares:n=4", "--problem", "flux.toml")
    assert (done.code, done.out) == (2, "")
    assert "source and fluxes must balance; they integrate to 5, their magnitudes to 5" in done.err


def test_convection_is_solved_without_plain_cg(agglo: Agglo) -> None:
    Path("flow.toml").write_text("kappa = 0.01\nconvection = [1.0, 2.0]\n")
    arguments = "solve", "squares:n=4", "--problem", "flow.toml"
    for solver in ("polydg_mg", "direct"):
        data = agglo(*arguments, "--solver", solver, "--json").data
        assert data["converged"]
        assert data["cg_iterations"] is None
    done = agglo(*arguments, "--solver", "polydg_cg")
    assert done.code == 2
    assert "its matrix is not symmetric, but this solver requires a symmetric matrix" in done.err


def test_levels_that_do_not_coarsen_are_skipped_with_a_notice(agglo: Agglo) -> None:
    done = agglo("solve", "squares:n=4", "--parts", "16,4", "--solver", "polydg_mg_paper", "--json")
    assert [level["cells"] for level in done.data["levels"]] == [16, 4]
    assert "level 0 is skipped: its 16 parts are not fewer than the 16 of the finer level" in done.err


def test_not_converged_is_exit_code_3(agglo: Agglo) -> None:
    done = agglo("solve", "squares:n=8", "--solver", "polydg_mg_paper:max_iterations=1")
    assert done.code == 3
    assert "NOT CONVERGED: relative residual" in done.out
    said = " ".join(done.out.split())
    assert "after 1 iterations, required 1.0e-06; the solution is from iteration 1" in said
    assert max(map(len, done.out.splitlines())) <= 80


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["squares:n=4", "--degree", "9"], "degree must be a whole number, 1..6; given 9"),
        (["squares:n=4", "--degree", "0"], "degree must be a whole number, 1..6; given 0"),
        (["squares:n=4", "--degree", "2.5"], "'2.5' is not a valid integer"),
        (["squares:n=4", "--solver", "polydg_mg_paper:degree=2.5"], "given 2.5"),
        (["squares:n=4", "--solver", "polydg_mg_paper:tolerance=small"], "given 'small'"),
        (
            ["squares:n=4", "--solver", "polydg_mg_paper:smoother=sor"],
            "one of schwarz, block_jacobi, chebyshev, gauss_seidel, vertex_patches; given 'sor'",
        ),
        (["squares:n=4", "--tol", "nan"], "tolerance must be a number between 0 and 1; given nan"),
        (
            ["squares:n=4", "--solver", "polydg_mg_paper", "--smoothing-steps", "0"],
            "smoothing_steps must be a whole number, at least 1",
        ),
        (["squares:n=4", "--smoothing-steps", "5"], "solver 'polydg_mg' "),
        (["squares:n=4", "--parts", "4", "--levels", "3"], "levels must lie in 2..2"),
        (["squares:n=4", "--levels", "1"], "levels must be a whole number, at least 2; given 1"),
        (["squares:n=4", "--refiner", "none", "--refiner", "interface"], "--refiner none cannot be combined"),
        (["squares:n=4", "--parts", "-4"], "each number must be positive"),
        (["squares:n=4", "--bisector", "nosuch"], "no bisector is named 'nosuch'"),
        (["squares:n=4", "--plot", "no/u.png"], "there is no folder no"),
        (["squares:n=4", "--plot-convergence", "no/c.png"], "there is no folder no"),
        (["squares:n=4", "--plot-convergence", "c.gif"], "pictures end in .png"),
        (["squares:n=4", "--report", "r.pdf"], "reports end in .html"),
        (["squares:n=4", "-o", "u.vtu", "--plot", "no/u.png"], "there is no folder no"),
        (["squares:n=4", "--degree", "2", "--solver", "polydg_mg_paper:degree=3"], "degree is given twice"),
        (["squares:n=4", "--solver", "nosuch"], "nosuch"),
        (["squares:n=4", "--solver", "polydg_mg_paper:degre=3"], "did you mean 'degree'"),
        (["squares:n=4", "--solver", "polydg_mg_paper:degree"], "not of the form option=value"),
        (["squares:n=4", "--solver", "polydg_mg_paper", "--levels", "7"], "levels must lie in 2..2"),
        (["squares:n=4", "--parts", "16"], "no level of the hierarchy is coarser than its 16 cells"),
        (["squares:n=4", "--parts", "4", "--h-star", "0.5"], "--h-star and --parts cannot be combined"),
        (["squares:n=4", "--parts", "4.5"], "not a comma-separated list of whole numbers"),
        (["squares:n=4", "--problem", "none.toml"], "no such file"),
        (["squares:n=4", "-o", "u.vtk"], "u.vtk: solutions are written as .vtu"),
        (["squares:n=4", "-o", "no/u.vtu"], "no/u.vtu"),
        (["squares:n=4", "--plot", "u.gif"], "pictures end in .png"),
        (["nosuch.vtu"], "nosuch.vtu"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(agglo: Agglo, arguments: list[str], message: str) -> None:
    done = agglo("solve", *arguments)
    assert done.code == 2
    assert done.out == ""
    assert message in done.err
    assert done.err.startswith("error: ") or "\nerror: " in done.err
    assert list(Path().iterdir()) == []


def test_adapted_meshes_are_reported_step_by_step(agglo: Agglo, tmp_path: Path) -> None:
    file = tmp_path / "u.vtu"
    asked = ("solve", "voronoi:n=800", "--adapt", "--problem", "sine")
    done = agglo(*asked, "--tolerance", "0.2", "--max-unknowns", "1500", "-o", str(file), "--json")
    assert (done.code, list(done.data)) == (0, ["mesh", "reason", "steps"])
    assert done.data["reason"] == "tolerance"
    *before, last = done.data["steps"]
    assert list(last) == [
        "parts",
        "unknowns",
        "estimate",
        "relative",
        "oscillation",
        "iterations",
        "converged",
        "seconds",
        "errors",
    ]
    assert last["relative"] <= 0.2 < before[-1]["relative"]
    assert last["errors"]["dg"] <= last["estimate"]
    assert file.stat().st_size > 1000
    done = agglo(*asked, "--max-unknowns", "300", "--estimator", "gradient_jump", "--parts", "200,60,12")
    assert done.code == 0
    assert "ended after" in done.out
    assert "the largest number of unknowns is reached" in done.out
    done = agglo(*asked, "--discretisation", "vem", "--max-unknowns", "300")
    assert done.code == 0
    assert "error ENERGY" in done.out
    assert agglo("solve", "squares:n=4", "--adapt", "--tolerance", "1e-4").code == 3


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--tolerance", "0.1"), "--tolerance is an option of --adapt; the solver's tolerance is --tol"),
        (("--adapt",), "--adapt needs a bound: give --tolerance, --max-unknowns or both"),
        (("--adapt", "--tolerance", "0.1", "--levels", "3"), "--levels is not available with --adapt"),
        (("--adapt", "--tolerance", "0.1", "--fluxes", "f.vtu"), "--fluxes is not available with --adapt"),
        (("--adapt", "--tolerance", "3"), "tolerance must be a number above 0"),
        (("--adapt", "--tolerance", "0"), "tolerance must be a number above 0"),
        (("--adapt", "--tolerance", "0.1", "-o", "u.png"), "solutions are written as .vtu"),
        (("--adapt", "--tolerance", "0.1", "-o", "none/u.vtu"), "the folder none does not exist"),
        (("--adapt", "--tolerance", "0.1", "--report", "r.txt"), "reports end in .html"),
        (("--adapt", "--tolerance", "0.1", "--estimator", "residuum"), "did you mean 'residual'"),
        (("--adapt", "--tolerance", "0.1", "--problem", "elasticity"), "given a problem of kind elasticity"),
    ],
)
def test_options_that_do_not_fit_adaptation_are_refused(
    agglo: Agglo, options: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output = () if "-o" in options else ("-o", "w.vtu")
    done = agglo("solve", "squares:n=4", *options, *output)
    assert (done.code, done.out) == (2, "")
    assert says in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sample", ["voronoi:n=300", "random_tetrahedra:n=300"])
def test_a_problem_file_is_adapted_with_a_report(
    agglo: Agglo, sample: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text('kind = "diffusion"\nsource = 8.0\nreaction = 2.0\n', encoding="utf-8")
    asked = ("solve", sample, "--adapt", "--problem", "p.toml", "--max-unknowns", "400", "-o", "u.vtu")
    done = agglo(*asked, "--report", "r.html", "--json")
    assert (done.code, done.data["reason"]) == (0, "max_unknowns")
    page = Path("r.html").read_text(encoding="utf-8")
    assert "Estimates" in page
    assert "uniform levels" in page
    assert '"estimate"' in page
    assert Path("u.vtu").stat().st_size > 1000
    done = agglo(*asked, "--tolerance", "1e-3", "--json")
    assert (done.code, done.data["reason"]) == (3, "max_unknowns")
