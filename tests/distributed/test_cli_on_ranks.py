"""The command line under mpiexec: one table, one message, one exit code, whatever happens on which rank."""

from __future__ import annotations

import io
import json
import os
import signal
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from command_line import Agglo
from on_ranks import Ended, by_open_mpi, ended, launch, on_ranks, started

from agglo_core import quality, read, read_hierarchy
from agglo_core.cli import main
from agglo_core.cli.ranks.launch import Launched, find_launch

RUN = ("run", "voronoi:n=200,seed=2", "--bisector", "coordinate", "--no-polish")

FAULTY = """
import os, signal, sys, time
from pathlib import Path
import agglo_core.distributed.files.writing as writing
from agglo_core.cli import main
from agglo_core.cli.ranks.launch import find_launch

rank, how, kept = find_launch(os.environ).rank, sys.argv.pop(), writing.write_pieces

def faulty(*arguments, **options):
    kept(*arguments, **options)
    if how == "waits":
        Path(f"ready-{rank}").touch()
        time.sleep(60)
    if rank != 1:
        return
    if how == "raises":
        raise ValueError("a bug")
    if how == "dies":
        os._exit(9)
    os.kill(os.getpid(), {"interrupted": signal.SIGINT, "terminated": signal.SIGTERM}[how])
    time.sleep(60)

writing.write_pieces = faulty
main()
"""
"""The command line, in which rank 1 fails when all pieces are written, but not yet put in place."""


def faulty(folder: Path, how: str) -> Ended:
    return launch(2, *RUN, "--parts", "4", "-o", "out.pvtu", how, cwd=folder, program=FAULTY, seconds=60.0)


def left(folder: Path) -> list[str]:
    """All there is now, hidden folders too."""
    return sorted(each.name for each in folder.iterdir() if not each.name.startswith("ready"))


def test_launchers_say_how_many_ranks_there_are() -> None:
    assert find_launch({}) is None
    assert find_launch({"PMI_RANK": "0", "PMI_SIZE": "1"}) is None
    assert find_launch({"PMI_RANK": "2", "PMI_SIZE": "4"}) == Launched(2, 4)
    assert find_launch({"OMPI_COMM_WORLD_RANK": "0", "OMPI_COMM_WORLD_SIZE": "3"}) == Launched(0, 3)
    assert find_launch({"SLURM_PROCID": "0", "SLURM_NTASKS": "3"}) is None  # a script that runs no srun


def test_a_run_on_two_ranks_prints_one_table_and_writes_its_levels(tmp_path: Path) -> None:
    done = launch(2, *RUN, "--parts", "40,8", "-o", "out.pvtu", cwd=tmp_path)
    assert done.code == 0, done.err
    head, *_, last = done.out.splitlines()
    assert head.startswith("voronoi n=200 seed=2: 200 cells on 2 ranks, h0 = ")
    assert last == "wrote out.pvtu"
    assert done.out.count("40 parts") == done.out.count("8 parts") - done.out.count("wrote") + 1 == 1
    mesh, hierarchy = read_hierarchy(tmp_path / "out.pvtu")
    assert hierarchy is not None
    assert (mesh.n_cells, hierarchy.parts, hierarchy.nested) == (200, [40, 8], True)
    assert (quality(mesh, hierarchy.levels[0], ["components"])["components"] == 1).all()
    coarse = read(tmp_path / "out_level1.pvtu")
    assert coarse.n_cells == 8
    assert coarse.cell_measures.sum() == pytest.approx(mesh.cell_measures.sum(), rel=1e-12)


def run_commands(commands: Sequence[Sequence[str]], folder: str) -> list[Ended]:
    """What this rank prints and its exit code, for each of several commands."""
    from mpi4py import MPI

    answers = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name in {"PMI_SIZE", "OMPI_COMM_WORLD_SIZE"} & os.environ.keys():
            patch.setenv(name, str(MPI.COMM_WORLD.size))
        for arguments in commands:
            out, err = io.StringIO(), io.StringIO()
            with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as done:
                main(arguments)
            assert isinstance(done.value.code, int)
            answers.append(Ended(done.value.code, out.getvalue(), err.getvalue(), 0.0))
    return answers


def on_two(commands: Sequence[Sequence[str]], folder: Path) -> list[Ended]:
    """What two ranks print together, for each of several commands."""
    answers = on_ranks(2, run_commands, commands, str(folder))
    assert [each.code for each in answers[0]] == [each.code for each in answers[1]]
    return [
        Ended(one.code, one.out + other.out, one.err + other.err, 0.0)
        for one, other in zip(*answers, strict=True)
    ]


def test_one_process_makes_the_same_parts_where_ranks_do_not_matter(agglo: Agglo, tmp_path: Path) -> None:
    """The same command on one rank and on two, and what both write."""
    pytest.importorskip("mpi4py")
    options = ("--parts", "30", "--independent-of-ranks", "--json")
    one = agglo(*RUN, *options, "-o", "one.pvtu")
    assert one.code == 0, one.err
    (two,) = on_two([(*RUN, *options, "-o", "two.pvtu")], tmp_path)
    assert two.code == 0, two.err
    told = [json.loads(text) for text in (one.out, two.out)]
    assert [each["ranks"] for each in told] == [1, 2]
    assert told[0]["mesh"] == told[1]["mesh"]
    (_, first), (_, second) = (read_hierarchy(tmp_path / f"{name}.pvtu") for name in ("one", "two"))
    assert first is not None
    assert second is not None
    assert first.levels[0].tolist() == second.levels[0].tolist()


REFUSED = {
    ("compare", "squares:n=4"): "agglo compare works in one process, but 2 processes were",
    ("run", "squares:n=4", "--plot", "a.png", "--report", "b.html"): "--plot and --report cannot be used",
    ("run", "squares:n=4", "-o", "out.vtu"): "out.vtu: distributed meshes and solutions are written as .pvtu",
    ("run", "boxes:n=2", "-o", "out.foam"): (
        "out.foam: distributed meshes and solutions are written as .pvtu, given '.foam'; to convert a mesh "
        "use one process: agglo.write('out.foam', *agglo.read_hierarchy('NAME.pvtu'))"
    ),
    ("run", "nowhere.vtu"): "'nowhere.vtu' is neither an existing file",
    ("run", "squares:n=4", "--parts", "x"): "Invalid value for '--parts'",
    ("solve", "squares:n=4"): "the solver polydg_mg works in one process, but 2 processes were",
    ("run", "squares:n=4", "-o", "nowhere/out.pvtu"): "nowhere/out.pvtu: the folder nowhere does not exist",
}


def test_what_cannot_be_had_is_refused_once(tmp_path: Path) -> None:
    for arguments, done in zip(REFUSED, on_two(list(REFUSED), tmp_path), strict=True):
        assert (done.code, done.out) == (2, ""), arguments
        assert done.err.count("error: ") == 1
        assert f"error: {REFUSED[arguments]}" in done.err.replace("\n", " ")
    assert left(tmp_path) == []


def test_a_piecewise_input_file_is_not_replaced(agglo: Agglo) -> None:
    pytest.importorskip("mpi4py")
    assert agglo("run", "squares:n=4", "--parts", "2", "-o", "in.pvtu").code == 0
    done = agglo("run", "in.pvtu", "--parts", "4", "-o", "in.pvtu")
    assert (done.code, done.out) == (2, "")
    assert "in.pvtu is the input file" in done.err


@pytest.mark.slow
def test_an_error_on_one_rank_ends_all_with_its_traceback(tmp_path: Path) -> None:
    """Rank 0 waits for a message that never comes: the run is aborted, and nothing stays behind."""
    done = faulty(tmp_path, "raises")
    assert done.code != 0
    assert done.err.count("ValueError: a bug") == 1
    assert left(tmp_path) == []


PLUGIN = """
import os, sys
from types import SimpleNamespace
import numpy as np
from agglo_core.cli import main
from agglo_core.cli.ranks.launch import find_launch
from agglo_core.registry import Component, default, hookimpl

class Toy:
    def bisect(self, graph, rng):
        if find_launch(os.environ).rank == 1 and graph.n > 60:
            raise ZeroDivisionError("a plugin's bug")
        order = np.argsort(np.argsort(graph.centroids[:, 0], kind="stable"))
        return order >= graph.n // 2

sys.modules["toy_on_ranks"] = SimpleNamespace(Toy=Toy)
made = [Component(kind="bisector", name="toy", target="toy_on_ranks:Toy", summary="Halves.")]
default().register(SimpleNamespace(agglo_components=hookimpl(lambda: made)), "toy_on_ranks")
main()
"""


@pytest.mark.slow
def test_a_plugin_that_fails_on_one_rank_is_named_once(tmp_path: Path) -> None:
    arguments = ("run", "squares:n=64", "--bisector", "toy", "--parts", "200", "-o", "out.pvtu")
    done = launch(2, *arguments, cwd=tmp_path, program=PLUGIN)
    assert done.code == 2
    assert done.err.count("a plugin's bug") == 1
    assert "error: rank 1: PluginError: bisector 'toy'" in done.err
    assert left(tmp_path) == []


@pytest.mark.slow
def test_a_rank_that_dies_ends_all(tmp_path: Path) -> None:
    """The temporary folder of pieces stays, hidden, and goes with the next writing."""
    done = faulty(tmp_path, "dies")
    assert done.code == 9
    assert all(name.startswith(".out.pvtu.agglo-") for name in left(tmp_path))
    assert launch(2, *RUN, "--parts", "4", "-o", "out.pvtu", cwd=tmp_path).code == 0
    assert left(tmp_path) == ["out", "out.pvtu", "out_level0", "out_level0.pvtu"]


@pytest.mark.slow
@pytest.mark.parametrize(("how", "code"), [("interrupted", 130), ("terminated", 143)])
def test_a_signal_to_one_rank_ends_all(tmp_path: Path, how: str, code: int) -> None:
    done = faulty(tmp_path, how)
    assert done.code == code
    # Open MPI sends SIGTERM to the other rank when one aborts, which then says so, too
    assert done.err.count(how) in ((1, 2) if how == "terminated" and by_open_mpi() else (1,))
    assert left(tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_mpiexec_ends_all(tmp_path: Path, number: signal.Signals) -> None:
    """As Ctrl-C in a terminal, or the end of a batch job."""
    running = started(2, ["-c", FAULTY, *RUN, "--parts", "4", "-o", "out.pvtu", "waits"], cwd=tmp_path)
    until = time.monotonic() + 60.0
    while len(list(tmp_path.glob("ready-*"))) < 2 and time.monotonic() < until:
        time.sleep(0.05)
    running.send_signal(number)
    done = ended(running, 20.0)
    assert done.code != 0
    assert left(tmp_path) == []
