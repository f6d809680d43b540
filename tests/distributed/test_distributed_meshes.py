"""Distributed meshes on 1, 2, 3 and 4 ranks: scripts of this folder, run under ``mpiexec``."""

from __future__ import annotations

import doctest
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mpi4py", reason="distributed meshes need the extra mpi")

from agglo_core.distributed import cell_values

HERE = Path(__file__).parent


def run(script: str, ranks: int, seconds: float = 100) -> None:
    """Run a script of this folder on some ranks; if one of them fails, the test shows its traceback."""
    mpiexec = shutil.which(
        "mpiexec", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    )
    if mpiexec is None:
        pytest.skip("there is no mpiexec")
    command = [mpiexec, "-n", str(ranks), sys.executable, "-m", "mpi4py", str(HERE / script)]
    path = os.pathsep.join(each for each in sys.path if each)
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=seconds, env={**os.environ, "PYTHONPATH": path}
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-6000:]


@pytest.mark.parametrize(
    "ranks", [pytest.param(1, marks=pytest.mark.slow), 2, 3, pytest.param(4, marks=pytest.mark.slow)]
)
def test_meshes_do_not_depend_on_the_number_of_ranks(ranks: int) -> None:
    run("meshes_of_ranks.py", ranks)


def test_what_is_wrong_on_one_rank_is_told_on_all() -> None:
    run("faults_of_ranks.py", 3)


def test_the_examples_of_values_do_what_they_say() -> None:
    found = doctest.testmod(cell_values)
    assert found.attempted
    assert not found.failed
