"""CPU seconds of README's command on its first and second run, and the kernels that cost most to compile.

python tests/benchmarks/first_run.py
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

COMMAND = "run voronoi:n=5000,seed=3 --bisector kmeans --bisector metis -o out.vtu --plot out.png"


class Compilation(NamedTuple):
    """One signature of one function: seconds without, and with, the functions that it calls."""

    function: str
    own: float
    seconds: float


class Run(NamedTuple):
    """CPU seconds of the whole process, those of compilation, and what was compiled."""

    total: float
    compiling: float
    compiled: list[Compilation]


def watched_run(arguments: list[str], report: Path) -> None:
    """Run the command in this process and write to ``report`` what numba compiled."""
    from numba.core import event

    compiled: list[tuple[str, float, float]] = []
    running: list[list[float]] = []  # when it began, seconds of those inside

    class Compilations(event.Listener):
        def on_start(self, event: Any) -> None:
            running.append([time.process_time(), 0.0])

        def on_end(self, event: Any) -> None:
            began, inside = running.pop()
            seconds = time.process_time() - began
            if running:
                running[-1][1] += seconds
            function = event.data["dispatcher"].py_func
            compiled.append((f"{function.__module__}.{function.__qualname__}", seconds - inside, seconds))

    event.register("numba:compile", Compilations())
    from agglo_core.cli import main

    try:
        main(arguments)
    finally:
        report.write_text(json.dumps(compiled))


def measured(cache: Path, folder: Path) -> Run:
    """README's command in a new process that keeps compiled kernels in ``cache``."""
    report = folder / "compiled.json"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), str(report), *COMMAND.split()],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    total = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    compiled = [Compilation(*row) for row in json.loads(report.read_text())]
    return Run(total, sum(one.own for one in compiled), compiled)


def main() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as name:
        cache, folder = Path(name, "cache"), Path(name, "run")
        folder.mkdir()
        first, second = measured(cache, folder), measured(cache, folder)
    ours = [one for one in first.compiled if one.function.startswith("agglo_")]
    print(f"first run   {first.total:6.2f} CPU s, {first.compiling:.2f} of them compiling")
    print(f"second run  {second.total:6.2f} CPU s, {len(second.compiled)} compilations")
    print(f"compiled    {len(ours)} of ours, {len(first.compiled) - len(ours)} of numba's; the dearest:")
    for one in sorted(ours, key=lambda one: -one.own)[:10]:
        print(f"{one.own:6.2f} {one.seconds:6.2f} with what it calls  {one.function}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        watched_run(sys.argv[2:], Path(sys.argv[1]))
    else:
        main()
