"""PETSc on two and three ranks, launched by mpiexec with a time limit; skipped visibly without it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from on_ranks import ended, launch, started

from agglo_core import samples, write
from agglo_core.io.vtk.xml_read import parse

pytest.importorskip("petsc4py", reason="PETSc tests skipped: no petsc4py here")
BESIDE = Path(sys.executable).parent / "mpiexec"
LAUNCHER = str(BESIDE) if BESIDE.exists() else shutil.which("mpiexec")
SCRIPT = Path(__file__).with_name("petsc_ranks.py")
SECONDS = 240


@pytest.fixture(scope="module", params=[2, 3], ids="{} ranks".format)
def answers(request):
    if LAUNCHER is None:
        pytest.skip("PETSc tests on several ranks skipped: no mpiexec here")
    command = [LAUNCHER, "-n", str(request.param), sys.executable, str(SCRIPT)]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    ) as running:
        try:
            out, err = running.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            running.kill()
            raise AssertionError(f"ranks hang: no end after {SECONDS} s") from None
    assert running.returncode == 0, err[-2000:]
    return json.loads(out)


@pytest.mark.parametrize("smoother", ["sweeps", "patches", "blocks", "sor"])
def test_ranks_take_as_many_iterations_as_one(answers, smoother):
    one, all_, gap, converged = answers["polydg"][smoother]
    assert converged
    assert abs(all_ - one) <= max(1, 0.1 * one)
    assert gap < 1e-6


def test_linear_systems_are_divided_too(answers):
    residual, converged = answers["systems"]
    assert converged
    assert residual < 1e-6


def test_assembled_elasticity_is_divided(answers):
    one, all_, residual = answers["elasticity"]
    assert max(one, all_) <= 30
    assert residual < 1e-6


def test_a_rank_may_have_nothing(answers):
    gap, iterations, coarsest = answers["own_rows"]
    assert gap < 1e-8
    assert iterations < 15
    assert coarsest == 10


def test_errors_are_raised_on_all_ranks(answers):
    spread, short = answers["wrong"]
    assert spread.startswith("rank 1: aggregates[0] are 0 to 0 on this rank; expected 1 to 1")
    assert "aggregates[0] must be 6 whole numbers" in short


def test_sweeps_across_ranks_are_those_of_one_in_another_order(answers):
    missed, mirrored = answers["sweep"]
    assert missed < 1e-12
    assert mirrored < 1e-12


@pytest.mark.parametrize("smoother", ["sweeps", "patches", "blocks"])
def test_a_mesh_that_no_rank_has_whole(answers, smoother):
    one, all_, gap, levels = answers["across"][smoother]
    assert abs(all_ - one) <= max(1, 0.1 * one)
    assert gap < 1e-6
    assert levels == 4


def test_patches_across_ranks_are_those_of_the_whole_mesh(answers):
    assert answers["patches"] == [True, True]


SOLVE = (
    "solve",
    "voronoi:n=600,seed=8",
    "--parts",
    "75,12,3",
    "--bisector",
    "coordinate",
    "--json",
    "--no-cg",
)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    done = launch(1, *SOLVE, "--solver", "petsc_mg", cwd=tmp_path_factory.mktemp("alone"))
    assert done.code == 0, done.err
    return json.loads(done.out)


@pytest.mark.parametrize("size", [2, 3])
def test_the_command_solves_as_in_one_process(alone, size, tmp_path):
    done = launch(size, *SOLVE, "--solver", "petsc_mg", cwd=tmp_path)
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["ranks"] == size
    assert told["converged"]
    assert abs(told["iterations"] - alone["iterations"]) <= 1
    assert told["energy"] == pytest.approx(alone["energy"], rel=1e-6)
    assert [each["cells"] for each in told["levels"]] == [600, 75, 12, 3]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "u.vtu"), "u.vtu: distributed meshes and solutions are written as .pvtu, given '.vtu'"),
        (("--plot", "u.png"), "--plot cannot be used on a mesh distributed over several processes"),
        (("--levels", "9"), "levels = 9, but with the mesh there are 4"),
    ],
)
def test_what_the_command_cannot_do_is_said_once(options, message, tmp_path):
    done = launch(2, *SOLVE, "--solver", "petsc_mg", *options, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.count("error: ") == 1
    assert message in done.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [2, 3])
def test_norms_of_the_error_are_those_of_one_process(size, tmp_path):
    exact = (*SOLVE, "--solver", "petsc_mg", "--problem", "sine", "--tol", "1e-12")
    alone, found = (launch(each, *exact, cwd=tmp_path) for each in (1, size))
    assert (alone.code, found.code) == (0, 0), alone.err + found.err
    assert "boundary" not in found.err
    one, all_ = json.loads(alone.out), json.loads(found.out)
    for name in ("error_l2", "error_dg"):
        assert all_[name] == pytest.approx(one[name], rel=1e-10)


@pytest.mark.parametrize("size", [2, 3])
def test_problems_by_tag_are_solved_where_a_rank_has_none_of_it(size, tmp_path):
    mesh = samples.squares(8).with_tags(corner=lambda x: (x.sum(axis=1) < 0.2).astype(int))
    write(tmp_path / "m.vtu", mesh.with_face_tags(boundary=lambda x: x[:, 0] < 1e-9))
    (tmp_path / "tags.toml").write_text("[kappa.corner]\n0 = 1.0\n1 = 10.0\n[dirichlet]\n1 = 2.0\n")
    asked = (
        "m.vtu",
        "--parts",
        "4",
        "--solver",
        "petsc_mg",
        "--problem",
        "tags.toml",
        "--tol",
        "1e-12",
        "--json",
    )
    alone, found = (launch(each, "solve", *asked, cwd=tmp_path) for each in (1, size))
    assert (alone.code, found.code) == (0, 0), alone.err + found.err
    assert json.loads(found.out)["energy"] == pytest.approx(json.loads(alone.out)["energy"], rel=1e-9)


def test_what_is_wrong_with_a_problem_is_said_once(tmp_path):
    write(tmp_path / "m.vtu", samples.squares(8))
    (tmp_path / "typo.toml").write_text("kapa = 1.0\n")
    asked = ("m.vtu", "--parts", "4", "--solver", "petsc_mg", "--problem", "typo.toml")
    done = launch(2, "solve", *asked, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.count("error: ") == 1


FAULTY = """
import os, sys, time
from agglo_core.cli import main
from agglo_petsc.ranks.patch_sweeps import PatchSweeps

name = sys.argv.pop()
kept, calls = getattr(PatchSweeps, name), []

def faulty(self, *arguments, **options):
    calls.append(1)
    if os.environ["PMI_RANK"] == "1" and len(calls) == {"_sweep": 5, "setUp": 2}[name]:
        raise ValueError("a bug in a callback")
    return kept(self, *arguments, **options)

setattr(PatchSweeps, name, faulty)
main()
"""


@pytest.mark.parametrize(("size", "method"), [(2, "_sweep"), (3, "_sweep"), (2, "setUp")])
def test_an_error_in_a_callback_of_petsc_ends_all_ranks(size, method, tmp_path):
    done = launch(size, *SOLVE, "--solver", "petsc_mg", method, cwd=tmp_path, program=FAULTY, seconds=60.0)
    assert done.code != 0
    assert "converged" not in done.out  # mpiexec may say there whom it has killed
    assert "rank 1: " in done.err
    assert "ValueError: a bug in a callback" in done.err


def test_scripts_end_that_abort_as_the_guide_says(tmp_path):
    (tmp_path / "script.py").write_text(FAULTY.replace("main()", SCRIPTED))
    done = ended(started(2, ["script.py", "_sweep"], cwd=tmp_path), 60.0)
    assert done.code != 0
    assert "ValueError: a bug in a callback" in done.err


SCRIPTED = """
import agglo_core as agglo
import agglo_petsc
from agglo_core import distributed
from mpi4py import MPI

def abort(*error):
    sys.__excepthook__(*error)
    time.sleep(1.0)
    MPI.COMM_WORLD.Abort(1)

sys.excepthook = abort
ranks = distributed.Ranks()
squares = agglo.samples.squares(16) if ranks.rank == 0 else None
mesh = distributed.DistributedMesh.scatter(squares, ranks)
pipeline = agglo.Pipeline(n_parts=(32,), bisector="coordinate", refiners=(), polish=False)
agglo_petsc.solve_across(agglo.Diffusion(), distributed.agglomerate(mesh, pipeline))
"""


def _sampled(file, corners=3):
    """Points and values of a written solution at the corners of its simplices, by cell."""
    document = parse(file.read_bytes())
    arrays = {each.get("Name"): document.array(each, 1 << 24) for each in document.root.iter("DataArray")}
    simplices = arrays["connectivity"].reshape(-1, corners)
    assert (np.diff(arrays["offsets"], prepend=0) == corners).all()
    values = np.column_stack((arrays["Points"].reshape(-1, 3), arrays["u"]))
    return {cell: values[simplices[arrays["cell"] == cell].ravel()] for cell in np.unique(arrays["cell"])}


@pytest.mark.parametrize("size", [2])
def test_a_solution_is_written_piece_by_piece(size, tmp_path):
    exact = (*SOLVE, "--solver", "petsc_mg:degree=2", "--tol", "1e-9")
    alone = launch(1, *exact, "-o", "alone.vtu", cwd=tmp_path)
    assert alone.code == 0, alone.err
    (tmp_path / "u").mkdir()
    (tmp_path / "u" / "u_7.vtu").write_bytes((tmp_path / "alone.vtu").read_bytes())  # of more ranks
    done = launch(size, *exact, "-o", "u.pvtu", cwd=tmp_path)
    assert done.code == 0, done.err
    files = sorted(each.relative_to(tmp_path).as_posix() for each in tmp_path.rglob("*") if each.is_file())
    pieces = [f"u/u_{rank}.vtu" for rank in range(size)]
    assert files == ["alone.vtu", "u.pvtu", *pieces]
    listed = ElementTree.parse(tmp_path / "u.pvtu").getroot()
    assert [each.get("Source") for each in listed.iter("Piece")] == pieces
    assert [each.get("Name") for each in listed.iter("PDataArray")] == ["u", "cell", "gradient", "Points"]
    _compare_pieces(tmp_path, pieces, 3)


@pytest.mark.parametrize("mesh", ["tetrahedra:n=3", "boxes:n=4"])
def test_a_solution_in_space_is_written_piece_by_piece(mesh, tmp_path):
    asked = ("solve", mesh, "--parts", "12", "--bisector", "coordinate", "--no-cg", "--solver", "petsc_mg")
    for size, file in ((1, "alone.vtu"), (2, "u.pvtu")):
        done = launch(size, *asked, "--problem", "sine", "--tol", "1e-9", "-o", file, cwd=tmp_path)
        assert done.code == 0, done.err
    _compare_pieces(tmp_path, ["u/u_0.vtu", "u/u_1.vtu"], 4)


def _compare_pieces(folder, pieces, corners):
    """The pieces hold each cell once, with points and values of ``alone.vtu``."""
    whole, found = _sampled(folder / "alone.vtu", corners), {}
    for piece in pieces:
        own = _sampled(folder / piece, corners)
        assert own
        assert not found.keys() & own.keys()
        found |= own
    assert found.keys() == whole.keys()
    largest = max(np.abs(each[:, 3]).max() for each in whole.values())
    for cell, each in whole.items():
        np.testing.assert_allclose(found[cell][:, :3], each[:, :3], atol=1e-12)
        np.testing.assert_allclose(found[cell][:, 3], each[:, 3], rtol=0.0, atol=1e-6 * largest)


def test_dolfinx_ranks_agglomerate_their_own_cells(answers):
    if "dolfinx_poisson" not in answers:
        pytest.skip("DOLFINx tests skipped: no dolfinx here")
    iterations, converged = answers["dolfinx_poisson"]
    assert converged
    assert iterations < 20


@pytest.mark.parametrize("name", ["plex", "dolfinx_mesh"])
def test_meshes_that_others_have_divided_are_taken_where_they_lie(answers, name):
    if name not in answers:
        pytest.skip("DOLFINx tests skipped: no dolfinx here")
    assert answers[name] == pytest.approx([1.0, 1.0, 1.0, 1.0], rel=1e-12)
