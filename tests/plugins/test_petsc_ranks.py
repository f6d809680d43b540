"""PETSc on two and three ranks, launched by mpiexec with a time limit; skipped visibly without it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from on_ranks import launch

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


def test_a_rank_may_have_nothing(answers):
    gap, iterations, coarsest = answers["own_rows"]
    assert gap < 1e-8
    assert iterations < 15
    assert coarsest == 10


def test_errors_are_raised_on_all_ranks(answers):
    spread, short = answers["wrong"]
    assert spread.startswith("rank 1: aggregates[0] are 0 to 0 here; expected 1 to 1")
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
        (("-o", "u.vtu"), "-o cannot be had of a mesh that lies on several processes"),
        (("--levels", "9"), "levels = 9 with the mesh; there are 4"),
    ],
)
def test_what_the_command_cannot_do_is_said_once(options, message, tmp_path):
    done = launch(2, *SOLVE, "--solver", "petsc_mg", *options, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.count("error: ") == 1
    assert message in done.err


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
