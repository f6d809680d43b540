"""Damage valid files at random and read them.

``PYTHONPATH=tests python tests/fuzz/fuzz_files.py --vtu 1000 --npz 500 --msh 500 --seed 0``, or
``--all 2000`` for this number of files per suffix.

Mesh files (including formats read through meshlane), graphs, linear systems, TOML files of runs and
problems, model files and GeoJSON. Each file must be read, or refused by an AggloError that names the file
and is not a PluginError, within 10 s and 200 MB beyond the memory for valid files. A mesh that can be read
also goes through ``agglo run FILE -o out.vtu``, and so does every 20th other mesh (``--every``) in a child
process: exit code 0 with all output files, or 2 without output files and without traceback. Failing files
are kept in the folder ``--keep``; ``--replay FILE`` judges one file again.
"""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import faulthandler
import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from fuzz.bombs import bombs
from fuzz.corpus import valid_files
from fuzz.damage import damaged
from fuzz.foreign_corpus import FOREIGN, without_new_processes
from fuzz.graph_corpus import PLACES, graph_files
from fuzz.memory import ALLOWED, Memory, restrict
from fuzz.several import lay_out
from numba.core.compiler_lock import global_compiler_lock

from agglo_core import AggloError, Mesh, OptionError, Pipeline, PluginError, samples
from agglo_core.cli import main
from agglo_core.interchange import (
    from_geojson,
    graph_from_metis,
    graph_from_scotch,
    parts_from_metis,
    parts_from_scotch,
)
from agglo_core.io import read_hierarchy
from agglo_core.io.system_files import read_system
from agglo_core.problems import Linear, System, read_problem
from agglo_gnn.plane.fast import FastGNN

SECONDS = 10  # CPU time
_WAIT = 12
FIELD = (
    ".typ1",
    ".typ2",
    ".mat",
    ".foam",
    ".hedra",
    ".ele",
    ".off",
    ".obj",
    ".pvtu",
    ".ovm",
    ".ply",
    ".vtk",
    ".vtp",
)
FIELD = (*FIELD, ".vtkhdf") if importlib.util.find_spec("h5py") else FIELD
MESHES = (".vtu", ".npz", ".msh", *FIELD, *FOREIGN)
GRAPHS = (".graph", ".xyz", ".part.4", ".grf", ".map")
SYSTEMS = (".mtx", ".system.npz", ".linear.toml")
SUFFIXES = (*MESHES, *GRAPHS, *SYSTEMS, ".toml", ".problem.toml", ".safetensors", ".geojson")


class Verdict(NamedTuple):
    """Result for a file: ``read``, ``refused``, or a fault of another kind."""

    kind: str
    text: str = ""

    @property
    def fault(self) -> bool:
        """Return True if the file caused a fault."""
        return self.kind not in ("read", "refused")


class _Hang(BaseException):
    """Timeout.

    No Exception, so that no handler on the way catches it.
    """


@contextmanager
def _alarm(seconds: int) -> Iterator[None]:
    def start() -> None:
        signal.setitimer(signal.ITIMER_PROF, seconds)
        signal.alarm(_WAIT * seconds)  # wall-clock limit for a waiting process on a busy machine

    def ring(*_: object) -> None:
        if not global_compiler_lock.is_locked():
            raise _Hang
        start()  # an exception inside LLVM would crash the process

    before = [(each, signal.signal(each, ring)) for each in (signal.SIGPROF, signal.SIGALRM)]
    start()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for each, handler in before:
            signal.signal(each, handler)


def judge(file: Path, command: bool) -> Verdict:
    """Read a file, and run the command on a mesh that can be read.

    With ``command`` the command runs in a child process, even for a refused mesh.
    """
    suffix = file.name[file.name.index(".") :]
    try:
        # Read the file; a refusal must name the file.
        with _alarm(SECONDS):
            _read(file, suffix)
            verdict = Verdict("read")
    except AggloError as error:
        if (suffix in MESHES and isinstance(error, PluginError)) or _is_bug(error):
            return Verdict("leak", str(error))
        verdict = Verdict("refused", str(error))
        if suffix != ".geojson" and not isinstance(error, OptionError | PluginError):
            named = str(error).startswith(str(file))
            verdict = verdict if named else Verdict("nameless", str(error))
    except _Hang:
        return Verdict("hang")
    except Exception as error:
        return Verdict("leak", f"{type(error).__name__}: {error}")
    # Run the command.
    if suffix in MESHES and not verdict.fault and (command or verdict.kind == "read"):
        return _command(file, by_process=command) or verdict
    return verdict


def _read(file: Path, suffix: str) -> None:
    """Use a file as its suffix implies."""
    if suffix in MESHES:
        read_hierarchy(file)
    elif suffix == ".toml":
        Pipeline.from_toml(file).run(_mesh())
    elif suffix == ".problem.toml":
        read_problem(file, _mesh())
    elif suffix == ".linear.toml":
        problem = read_problem(file, samples.squares(4))
        if isinstance(problem, Linear):
            System(problem.A, problem.b, near_null=problem.near_null)
    elif suffix in SYSTEMS:
        read_system(file)
    elif suffix == ".graph":
        graph_from_metis(file, PLACES)
    elif suffix == ".xyz":
        whole = file.with_name("whole.graph")
        whole.write_bytes(graph_files()[".graph"][0])
        graph_from_metis(whole, file)
    elif suffix == ".part.4":
        parts_from_metis(file)
    elif suffix == ".grf":
        graph_from_scotch(file, PLACES)
    elif suffix == ".map":
        parts_from_scotch(file)
    elif suffix == ".safetensors":
        FastGNN(weights=file)
    else:
        try:
            content = json.loads(file.read_bytes())
        except (ValueError, RecursionError):  # an error of the caller, who parses the file
            return
        from_geojson(content)


@cache
def _mesh() -> Mesh:
    """Return the mesh for runs and problems."""
    mesh = samples.squares(5)
    x = mesh.points[mesh.face_pairs].mean(axis=1)[:, 0]
    left = np.where(mesh.face_cells[:, 1] < 0, np.where(x < 1e-9, 1, 2), 0)
    return replace(
        mesh,
        cell_tags={"material": np.arange(mesh.n_cells) % 2},
        face_tags={"boundary": left, "left": np.where(left == 1, 1, 0)},
    )


def _is_bug(error: BaseException | None) -> bool:
    """Return True if an error was caused by an exception other than an AggloError."""
    while error is not None:
        cause = error.__cause__
        if isinstance(error, PluginError) and cause is not None and not isinstance(cause, AggloError):
            return True
        error = cause
    return False


def _command(file: Path, *, by_process: bool) -> Verdict | None:
    """Return the fault of ``agglo run FILE -o out.vtu``, or None."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.vtu"
        arguments = ["run", str(file), "--bisector", "coordinate", "--h-factor", "2,4,8", "-o", str(out)]
        try:
            code, said = _apart(arguments) if by_process else _here(arguments)
        except (_Hang, subprocess.TimeoutExpired):
            return Verdict("command hangs")
        except Exception as error:
            return Verdict("command leaks", f"{type(error).__name__}: {error}")
        left = sorted(os.listdir(folder))
    if "Traceback" in said or code not in (0, 2):
        return Verdict("command leaks", f"exit code {code}: {said}")
    if left != (["out.vtu", *(f"out_level{i}.vtu" for i in range(3))] if code == 0 else []):
        return Verdict("partial output", f"exit code {code} left {left}")
    return None


def _here(arguments: list[str]) -> tuple[int, str]:
    said = io.StringIO()
    with _alarm(3 * SECONDS), redirect_stdout(said), redirect_stderr(said):
        try:
            main(arguments)
        except SystemExit as done:
            return int(done.code or 0), said.getvalue()
    raise AssertionError("main always exits")


def _apart(arguments: list[str]) -> tuple[int, str]:
    program = [sys.executable, "-c", "from agglo_core.cli import main; main()", *arguments]
    done = subprocess.run(
        program, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=_WAIT * SECONDS, check=False
    )
    return done.returncode, done.stdout.decode(errors="replace")


def fuzz(
    counts: dict[str, int], seed: int, keep: Path | None, every: int = 20, part: tuple[int, int] = (0, 1)
) -> Iterator[tuple[str, Verdict]]:
    """Yield suffix and verdict of each damaged file, reproducible by seed.

    ``part`` selects a share of the files, for several processes.
    """
    with tempfile.TemporaryDirectory() as folder, without_new_processes():
        for suffix in counts:
            _warm_up(suffix)
        memory, largest = Memory(), 0
        for suffix, count in counts.items():
            valid = valid_files(suffix)
            for i in range(part[0], count, part[1]):
                rng = np.random.default_rng([seed, *suffix.encode(), i])
                content = damaged(rng, suffix, valid[i % len(valid)])
                file = Path(folder) / f"m{suffix}"
                lay_out(file, content)
                command = i % every == every - 1
                verdict, grown = _measured(file, command, memory)
                if verdict.fault or grown > ALLOWED + len(content):  # kernels may have been compiled: repeat
                    memory = Memory()
                    verdict, grown = _measured(file, command, memory)
                largest = max(largest, grown)
                if grown > ALLOWED + len(content) and not verdict.fault:
                    verdict = Verdict("memory", f"{grown >> 20} MiB for {len(content)} bytes")
                if verdict.fault and keep is not None:
                    keep.mkdir(exist_ok=True)
                    (keep / f"seed{seed}_{i}{suffix}").write_bytes(content)
                yield suffix, verdict
        print(f"memory at most {largest >> 20} MiB beyond that of valid files")


def _measured(file: Path, command: bool, memory: Memory) -> tuple[Verdict, int]:
    """Return the verdict for a file, and its memory in bytes."""
    memory.watch()
    return judge(file, command), memory.growth()


@cache
def _warm_up(suffix: str) -> None:
    """Read valid files and build the bombs, so that imports, compilation and caches are not charged later."""
    bombs(suffix)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"m{suffix}"
        for content in valid_files(suffix)[:12]:
            lay_out(file, content)
            judge(file, command=False)
    _largest_child()


@cache
def _largest_child() -> None:
    """Start the largest child process once."""
    with tempfile.TemporaryDirectory() as folder:
        _apart(["run", "squares:n=4", "--bisector", "coordinate", "-o", f"{folder}/out.vtu"])


def _main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    for suffix in SUFFIXES:
        parser.add_argument(f"--{suffix[1:]}", type=int, help="number of damaged files")
    parser.add_argument("--all", type=int, default=0, help="number of damaged files of every other suffix")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=20, help="how often the command runs in a process")
    parser.add_argument("--part", default="0/1", help="which of how many parts, as 0/2")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-faults"))
    parser.add_argument("--replay", type=Path)
    given = parser.parse_args()
    if given.replay:
        print(judge(given.replay, command=True))
        return 0
    # Limit the memory and read the counts per suffix.
    restrict()
    counts = {suffix: vars(given)[suffix[1:]] for suffix in SUFFIXES}
    counts = {suffix: given.all if count is None else count for suffix, count in counts.items()}
    place, parts = map(int, given.part.split("/"))
    kinds: dict[str, Counter[str]] = {suffix: Counter() for suffix, count in counts.items() if count}
    slowest = dict.fromkeys(kinds, 0.0)
    start = time.perf_counter()
    # Judge the files and count the results.
    for suffix, verdict in fuzz(
        {each: counts[each] for each in kinds}, given.seed, given.keep, given.every, (place, parts)
    ):
        faulthandler.dump_traceback_later(4 * _WAIT * SECONDS, exit=True)  # compiled loops ignore the alarm
        slowest[suffix] = max(slowest[suffix], time.perf_counter() - start)
        if verdict.fault:
            print(suffix, place + parts * kinds[suffix].total(), *verdict)
        kinds[suffix]["faults" if verdict.fault else verdict.kind] += 1
        start = time.perf_counter()
    # Print a row per suffix and the totals.
    for suffix, found in kinds.items():
        print(f"{suffix:>14} {_row(found)}, slowest {slowest[suffix]:.1f} s (its command included)")
    print(f"{'all':>14} {_row(total := sum(kinds.values(), Counter()))}")
    return int(total["faults"] > 0)


def _row(found: Counter[str]) -> str:
    return f"{found['read']:>7,} read, {found['refused']:>7,} refused, {found['faults']} faults"


if __name__ == "__main__":
    sys.exit(_main())
