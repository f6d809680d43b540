"""Measure the resident memory of a whole run from file to files, stage by stage.

    python tests/benchmarks/memory.py [CELLS] [--meshes NAME ...] [--no-measure]

A mesh is read from VTU, agglomerated into N/16 parts with default components, measured with the default
metrics, and written to VTU with its coarse mesh, after a warm-up with a small mesh in the same process. One
thread. ``held`` is the growth of the process at the end of a stage, ``peak`` the largest growth during the
stage, in bytes per cell (Linux only). The last row is the overall peak.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.measure import measure_levels

MESHES: dict[str, Callable[[int], Mesh]] = {
    "triangles": lambda n: samples.random_triangles(n // 2, seed=0),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "tetrahedra": lambda n: samples.tetrahedra(max(1, round((n / 6) ** (1 / 3)))),
}
STATUS, FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def stages(file: Path, measured: bool) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield names and calls, each of which needs the previous calls."""
    made: dict[str, Any] = {}

    def keep(name: str, call: Callable[[], Any]) -> tuple[str, Callable[[], Any]]:
        return name, lambda: made.update({name: call()})

    yield keep("read", lambda: agglo.read(file))
    mesh = made["read"]
    yield keep("graph", lambda: mesh.graph)
    yield keep("agglomerate", lambda: agglo.agglomerate(mesh, n_parts=max(2, mesh.n_cells // 16)))
    if measured:
        yield keep("measure", lambda: measure_levels(mesh, made["agglomerate"]))
    yield keep("write", lambda: agglo.write(file.with_name("out.vtu"), mesh, made["agglomerate"]))


def resident(line: str) -> int:
    """Return a process status line in bytes."""
    return 1024 * int(STATUS.read_text().split(f"{line}:")[1].split()[0])


def one(file: Path, measured: bool, solid: bool) -> None:
    """Print held and peak bytes of each stage as JSON."""
    small = file.with_name("small.vtu")
    agglo.write(small, samples.tetrahedra(3) if solid else samples.voronoi(300))
    for _, call in stages(small, measured):
        call()
    before, rows = resident("VmRSS"), []
    for name, call in stages(file, measured):
        FORGET.write_text("5")  # reset the peak
        call()
        rows.append((name, resident("VmRSS") - before, resident("VmHWM") - before))
    print(json.dumps(rows))


def main() -> None:
    """Read the arguments and print a table per mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cells", type=int, nargs="?", default=1_000_000)
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=["triangles", "voronoi"])
    parser.add_argument("--no-measure", action="store_true", help="leave the metrics out")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(options.one, not options.no_measure, options.meshes == ["tetrahedra"])
        return
    for name in options.meshes:
        mesh = MESHES[name](options.cells)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "mesh.vtu"
            agglo.write(file, mesh)
            command = [sys.executable, __file__, "--one", str(file), "--meshes", name]
            command += ["--no-measure"] if options.no_measure else []
            rows = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        print(f"\n{mesh.n_cells} {name}\n{'':14}{'held':>10}{'peak':>10}  B/cell")
        for stage, held, peak in rows:
            print(f"{stage:14}{held / mesh.n_cells:10.0f}{peak / mesh.n_cells:10.0f}")
        print(f"{'all':24}{max(peak for _, _, peak in rows) / mesh.n_cells:10.0f}", flush=True)


if __name__ == "__main__":
    main()
