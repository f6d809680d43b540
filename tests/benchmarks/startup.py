"""Measure the plugin listing with many installed plugins, next to ``agglo --version``.

python tests/benchmarks/startup.py [PLUGINS]
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

DECLARATION = """
from agglo_core import Component, hookimpl

@hookimpl
def agglo_components():
    return [Component("bisector", "b{i}", "crowd_{i}:B", requires=("numpy",), summary="Number {i}.")]
"""


def install(folder: Path, count: int) -> None:
    """Create distributions like pip, each with a plugin of one component."""
    for i in range(count):
        (folder / f"crowd_{i}.py").write_text(DECLARATION.format(i=i))
        info = folder / f"crowd_{i}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: crowd-{i}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[agglo]\ncrowd_{i} = crowd_{i}\n")


def cpu(folder: Path, *arguments: str) -> float:
    """Return the CPU seconds of a command, the best of five runs after a run that compiles."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    }
    seconds = []
    for _ in range(6):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "agglo_core", *arguments]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(seconds[1:])


def main(count: int) -> None:
    """Print the results."""
    with tempfile.TemporaryDirectory() as empty, tempfile.TemporaryDirectory() as full:
        install(Path(full), count)
        print(f"agglo --version                     {cpu(Path(empty), '--version'):.2f} CPU s")
        print(f"agglo plugins                       {cpu(Path(empty), 'plugins'):.2f} CPU s")
        print(f"agglo plugins, {count} more installed   {cpu(Path(full), 'plugins'):.2f} CPU s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
