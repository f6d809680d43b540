"""Measure the README command in its first and second run, and list the most expensive kernels to compile.

python tests/benchmarks/first_run.py            # a checkout: kernels are compiled on first use
python tests/benchmarks/first_run.py --wheel    # an installed wheel that contains the kernels
python tests/benchmarks/first_run.py --record   # writes the list of the kernels that a wheel has
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

ROOT = Path(__file__).parents[2]
COMMAND = "run voronoi:n=5000,seed=3 --bisector kmeans --bisector metis -o out.vtu --plot out.png"
SMALL = COMMAND.replace("5000", "60")  # uses code paths for small meshes
HEAD = "# Kernels in a wheel, the dearest first. Written by tests/benchmarks/first_run.py --record\n"


class Compilation(NamedTuple):
    """Signature of a compiled function: seconds without and with its callees."""

    function: str
    own: float
    seconds: float


class Run(NamedTuple):
    """CPU seconds of a process, compiled functions, and loaded kernels (module, name, arguments)."""

    total: float
    compiled: list[Compilation]
    loaded: list[tuple[str, str, str]]


def watched_run(arguments: list[str], report: Path) -> None:
    """Run the command in this process, and write the compiled and loaded functions to ``report``."""
    from numba.core import event

    compiled: list[tuple[str, float, float]] = []
    running: list[list[float]] = []  # start time, and seconds of nested compilations

    # Record the seconds of each compilation, with and without nested compilations.
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
        report.write_text(json.dumps({"compiled": compiled, "loaded": loaded_kernels()}))


def loaded_kernels() -> list[tuple[str, str, str]]:
    """Return module, name and argument types of the agglo kernels loaded from disk."""
    from numba.core.dispatcher import Dispatcher

    from agglo_core.compiled.ahead_of_time import write_types

    ours = [module for name, module in sys.modules.items() if name.startswith("agglo_")]
    kernels = {each for module in ours for each in vars(module).values() if isinstance(each, Dispatcher)}
    return sorted(
        (kernel.py_func.__module__, kernel.py_func.__qualname__, write_types(arguments))
        for kernel in kernels
        for arguments in kernel.stats.cache_hits
    )


def measured(command: str, folder: Path, cache: Path, packages: Path | None = None) -> Run:
    """Run a command in a new process with kernel cache ``cache``, optionally with agglo from ``packages``."""
    report = folder / "report.json"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    if packages is not None:
        environment["PYTHONPATH"] = str(packages)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), str(report), *command.split()],
        env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    total = seconds_since(before)
    found = json.loads(report.read_text())
    return Run(
        total, [Compilation(*row) for row in found["compiled"]], [tuple(row) for row in found["loaded"]]
    )


def seconds_since(before: resource.struct_rusage) -> float:
    """Return CPU seconds of the child processes that ended since ``before``."""
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def installed(folder: Path) -> Path:
    """Install a wheel of this checkout in a folder."""
    packages = folder / "packages"
    options = ["-q", "--no-build-isolation", "--no-deps", "--no-index", "--target", str(packages)]
    command = [sys.executable, "-m", "pip", "install", *options, str(ROOT)]
    level = {"AGGLO_PREBUILD": os.environ.get("AGGLO_PREBUILD", "generic")}
    subprocess.run(command, env=os.environ | level, check=True, capture_output=True)
    return packages


def record(runs: list[Run]) -> None:
    """Write the list of kernels loaded in any run, sorted by the compile time in the other runs."""
    from agglo_core.compiled.ahead_of_time import LISTED

    seconds = {one.function: one.seconds for run in runs for one in run.compiled}
    loaded = {row for run in runs for row in run.loaded}
    rows = sorted(loaded, key=lambda row: (-seconds.get(f"{row[0]}.{row[1]}", 0.0), row))
    LISTED.write_text(HEAD + "".join(" ".join(row) + "\n" for row in rows))


def main(options: list[str]) -> None:
    """Print the results."""
    with tempfile.TemporaryDirectory() as name:
        cache, folder = Path(name, "cache"), Path(name, "run")
        folder.mkdir()
        packages = None
        if "--wheel" in options:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            packages = installed(Path(name))
            print(f"building    {seconds_since(before):6.2f} CPU s")
        first, second = runs = [measured(COMMAND, folder, cache, packages) for _ in range(2)]
        if "--record" in options:
            record(runs + [measured(SMALL, folder, cache) for _ in range(2)])
    ours = [one for one in first.compiled if one.function.startswith("agglo_")]
    compiling = sum(one.own for one in first.compiled)
    print(f"first run   {first.total:6.2f} CPU s, {compiling:.2f} of them compiling")
    print(f"second run  {second.total:6.2f} CPU s, {len(second.compiled)} compilations")
    print(f"compiled    {len(ours)} of ours, {len(first.compiled) - len(ours)} of numba's; the dearest:")
    for one in sorted(ours, key=lambda one: -one.own)[:10]:
        print(f"{one.own:6.2f} {one.seconds:6.2f} with what it calls  {one.function}")


if __name__ == "__main__":
    if len(sys.argv) > 2:
        watched_run(sys.argv[2:], Path(sys.argv[1]))
    else:
        main(sys.argv[1:])
