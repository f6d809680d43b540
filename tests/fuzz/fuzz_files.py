"""Damages valid mesh files at random and reads them: a mesh or an AggloError, soon, and nothing else.

``PYTHONPATH=tests python tests/fuzz/fuzz_files.py --vtu 1000 --npz 500 --msh 500 --seed 0``

Each damaged file must be read, or refused by an AggloError that names it and is no PluginError, within
10 s. One that is read goes through ``agglo run FILE -o out.vtu`` as well, and so does every 20th of the
others, in a process of its own: exit code 0 with the files, or 2 with none of them and no traceback. What
fails is kept in the folder ``--keep``; ``--replay FILE`` judges one file again.
"""

# ruff: noqa: T201
from __future__ import annotations

import argparse
import faulthandler
import io
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
from fuzz.corpus import valid_files
from fuzz.damage import damaged

from agglo_core import AggloError, PluginError
from agglo_core.cli import main
from agglo_core.io import read_hierarchy

SECONDS = 10


class Verdict(NamedTuple):
    """What became of a file: ``mesh`` or ``refused``; anything else is a fault."""

    kind: str
    text: str = ""

    @property
    def fault(self) -> bool:
        """Whether the promise is broken."""
        return self.kind not in ("mesh", "refused")


class _Hang(BaseException):
    """Not an Exception: nothing on the way may take it for its own."""


@contextmanager
def _alarm(seconds: int) -> Iterator[None]:
    def ring(*_: object) -> None:
        raise _Hang

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def judge(file: Path, command: bool) -> Verdict:
    """Read a file, and run the command on it if it is read; ``command``: in any case, in a process."""
    try:
        with _alarm(SECONDS):
            read_hierarchy(file)
            verdict = Verdict("mesh")
    except PluginError as error:  # what a format raises that is no refusal
        return Verdict("leak", str(error))
    except AggloError as error:
        verdict = Verdict("refused", str(error))
        if not str(error).startswith(str(file)):
            return Verdict("nameless", str(error))
    except _Hang:
        return Verdict("hang")
    except Exception as error:
        return Verdict("leak", f"{type(error).__name__}: {error}")
    if command or verdict.kind == "mesh":
        return _command(file, by_process=command) or verdict
    return verdict


def _command(file: Path, *, by_process: bool) -> Verdict | None:
    """Fault of ``agglo run FILE -o out.vtu``, if any."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.vtu"
        arguments = ["run", str(file), "--bisector", "coordinate", "-o", str(out)]
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
        program, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=6 * SECONDS, check=False
    )
    return done.returncode, done.stdout.decode(errors="replace")


def fuzz(
    counts: dict[str, int], seed: int, keep: Path | None, every: int = 20
) -> Iterator[tuple[str, Verdict]]:
    """Suffix and verdict of each damaged file; the same for the same seed."""
    valid = valid_files()
    with tempfile.TemporaryDirectory() as folder:
        for suffix, count in counts.items():
            for i in range(count):
                rng = np.random.default_rng([seed, ord(suffix[1]), i])
                content = damaged(rng, suffix, valid[suffix][i % len(valid[suffix])])
                file = Path(folder) / f"m{suffix}"
                file.write_bytes(content)
                verdict = judge(file, command=i % every == every - 1)
                if verdict.fault and keep is not None:
                    keep.mkdir(exist_ok=True)
                    (keep / f"seed{seed}_{i}{suffix}").write_bytes(content)
                yield suffix, verdict


def _main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    for suffix in ("vtu", "npz", "msh"):
        parser.add_argument(f"--{suffix}", type=int, default=0, help="number of damaged files")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-faults"))
    parser.add_argument("--replay", type=Path)
    given = parser.parse_args()
    if given.replay:
        print(judge(given.replay, command=True))
        return 0
    counts = {f".{suffix}": getattr(given, suffix) for suffix in ("vtu", "npz", "msh")}
    total: Counter[tuple[str, str]] = Counter()
    slowest, start = 0.0, time.perf_counter()
    for suffix, verdict in fuzz(counts, given.seed, given.keep):
        faulthandler.dump_traceback_later(12 * SECONDS, exit=True)  # a compiled loop ignores the alarm
        slowest, start = max(slowest, time.perf_counter() - start), time.perf_counter()
        total[suffix, verdict.kind] += 1
        if verdict.fault:
            print(suffix, sum(n for (s, _), n in total.items() if s == suffix) - 1, *verdict)
    for (suffix, kind), n in sorted(total.items()):
        print(f"{suffix} {kind}: {n}")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    print(f"slowest file {slowest:.1f} s (its command included), memory at most {memory} MiB")
    return int(any(Verdict(kind).fault for _, kind in total))


if __name__ == "__main__":
    sys.exit(_main())
