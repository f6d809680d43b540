"""Measure a million tetrahedra from file to file: CPU seconds and peak memory of each step.

    python tests/benchmarks/solids_at_scale.py [--points N] [--cells-per-part M ...] [--metrics NAME ...]

The file is made first, in a child process, and not counted: Delaunay tetrahedra of random points in a cube,
238,000 points for about a million cells. Then, with one thread: read the VTU file, build its dual graph,
agglomerate with defaults to parts of 32 cells and two nested coarser levels, measure the finest level, and
write VTU with all levels. Kernels are compiled before on a small mesh. ``MB`` is the peak process memory.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agglo_core import Hierarchy, Mesh, agglomerate, quality, read, samples, write

METRICS = ("UF", "CR", "CRc", "J", "isoperimetric", "convexity")


class Steps:
    """Runs steps, prints their cost and sums their CPU seconds."""

    def __init__(self, loud: bool) -> None:
        self.loud, self.total = loud, 0.0

    def __call__(self, name: str, step: Callable[[], Any]) -> Any:
        """Run a step and return its result."""
        start = time.process_time()
        found = step()
        seconds = time.process_time() - start
        self.total += seconds
        if self.loud:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            print(f"{name:24}{seconds:8.2f} s{peak:9.0f} MB", flush=True)
        return found


def whole_road(file: Path, sizes: list[int], metrics: list[str], loud: bool = True) -> float:
    """Run from a VTU file to a VTU file with levels.

    Returns the CPU seconds of all steps.
    """
    step = Steps(loud)
    mesh: Mesh = step("read", lambda: read(file))
    step("graph", lambda: mesh.graph)
    hierarchy: Hierarchy = step("agglomerate", lambda: agglomerate(mesh, cells_per_part=sizes))
    finest = hierarchy.levels[0]
    coarse: Mesh = step("coarse mesh", lambda: hierarchy.mesh(0))
    table = {}
    for name in metrics:
        table |= step(f"metric {name}", lambda name=name: quality(mesh, finest, metrics=(name,)))
    out = file.with_name(f"{file.stem}_levels.vtu")
    step("write", lambda: write(out, mesh, hierarchy))
    if loud:
        parts = ", ".join(f"{each.max() + 1:,}" for each in hierarchy.levels)
        print(f"{mesh.n_cells:,} tetrahedra, {parts} parts")
        print(", ".join(f"{name} {values.mean():.3f}" for name, values in table.items()))
        print(f"{coarse.n_faces:,} faces of parts; {out.stat().st_size / 1e6:.0f} MB written")
    return step.total


def main() -> None:
    """Make the file, warm up and run all steps."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=238_000)
    parser.add_argument("--cells-per-part", type=int, nargs="+", default=[32, 256, 2048])
    parser.add_argument("--metrics", nargs="+", default=list(METRICS))
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.make:
        write(given.make, samples.random_tetrahedra(given.points))
        return
    with tempfile.TemporaryDirectory() as folder:
        small, large = Path(folder) / "small.vtu", Path(folder) / "large.vtu"
        write(small, samples.random_tetrahedra(300))
        whole_road(small, [8, 64], given.metrics, loud=False)
        made = [sys.executable, __file__, "--points", str(given.points), "--make", str(large)]
        subprocess.run(made, check=True)
        total = whole_road(large, given.cells_per_part, given.metrics)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0**2
    print(f"{'all':24}{total:8.2f} s{peak:9.2f} GB at most")


if __name__ == "__main__":
    main()
