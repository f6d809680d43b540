"""Measure distributed agglomeration on 1 to 4 ranks of this machine, and extrapolate to more ranks.

    python tests/benchmarks/scale.py [MESH ...] [--cells N] [--ranks 1 2 3 4]

Meshes: triangles, voronoi, tetrahedra. Each mesh is made once, read by rank 0 and scattered; levels of 16,
256 and 4,096 cells per part, and by size h* = (2, 4, 8) h. ``seconds`` are CPU seconds of the slowest rank
for the counts, with compiled kernels; ranks wait in loops, so more ranks than cores cost more than their
work. ``same`` is true if all labels equal those on one rank: cells are agglomerated in coordinate blocks,
and a rank has whole blocks. The row ``lying`` is ``independent_of_ranks=False``: each rank agglomerates its
own cells as distributed. Then weak scaling with a fixed number of cells per rank, and a model fitted to
both: seconds, messages and bytes of a rank. Below each run, the messages and kB of the busiest rank for each
level, finest first; for a level on fewer ranks this includes the transferred graph and the returned labels.

Borders of blocks and ranks change parts like another seed. The first table therefore shows shapes on
``--seeds`` meshes with a tenth of the triangles each, for both ways: means, and the standard error of the
difference to the whole mesh without borders.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported

import numpy as np
from scipy.optimize import nnls

import agglo_core as agglo
from agglo_core import Mesh, Pipeline, samples
from agglo_core.distributed import DistributedMesh, Ranks, agglomerate

MESHES: Mapping[str, Callable[[int], Mesh]] = {
    "triangles": lambda n: samples.random_triangles(n // 2, seed=0),
    "voronoi": lambda n: samples.voronoi(n, seed=0),
    "tetrahedra": lambda n: samples.tetrahedra(max(1, round((n / 6) ** (1 / 3)))),
}
COUNTS = Pipeline(cells_per_part=(16, 256, 4096))
SIZES = Pipeline(h_factor=(2, 4, 8))
FAR = ((100_000_000, 16), (1_000_000_000, 1024))


def arrays_of(*owners: Any) -> int:
    """Return the bytes of all arrays held by objects, counting each array once."""
    found = {}
    for owner in owners:
        for value in vars(owner).values():
            for each in value if isinstance(value, tuple) else (value,):
                if isinstance(each, np.ndarray):
                    base = each if each.base is None or not isinstance(each.base, np.ndarray) else each.base
                    found[id(base)] = base.nbytes
    return sum(found.values())


def digest(mesh: DistributedMesh, levels: Sequence[Any]) -> str:
    return hashlib.sha256(b"".join(np.asarray(mesh.gather(each)).tobytes() for each in levels)).hexdigest()


def on_rank(file: str, full: bool) -> None:
    """Run one rank.

    Rank 0 prints all results as JSON.
    """
    ranks = Ranks()
    mesh = DistributedMesh.scatter(agglo.read(file) if ranks.rank == 0 else None, ranks)
    # Compile all kernels on a small mesh.
    warm = DistributedMesh.scatter(samples.squares(16) if mesh.local.dim == 2 else samples.boxes(6), ranks)
    for pipeline in (COUNTS, SIZES):
        agglomerate(warm, pipeline)
    assert mesh.local.graph.n
    # Time both ways, then collect sizes and messages.
    start = time.process_time()
    lying = agglomerate(mesh, COUNTS, independent_of_ranks=False)
    middle = time.process_time()
    made = agglomerate(mesh, COUNTS)
    seconds = time.process_time() - middle
    told: dict[str, Any] = {
        "cells": mesh.n_cells,
        "own": len(mesh.own),
        "ghosts": len(mesh.owners) - len(mesh.own),
        "seconds": seconds,
        "lying": middle - start,
        "messages": made.statistics["messages"],
        "bytes": made.statistics["bytes"],
        "by_level": made.statistics["sent_by_level"],
        "memory": arrays_of(mesh, mesh.local, mesh.local.graph),
    }
    # Bytes of one halo exchange.
    before = ranks.traffic.bytes
    mesh.exchange(made.levels[0])
    told["halo"] = ranks.traffic.bytes - before
    if full:
        told |= quality(mesh, made) | {"lying shapes": shapes_of(mesh, lying, False)}
    every = ranks.gathered(told)
    if ranks.rank == 0:
        print("RESULT" + json.dumps(every), flush=True)


def shapes_of(mesh: DistributedMesh, made: Any, independent: bool | None) -> list[float]:
    """Return UF and CR of the finest level by counts, part count and CR by sizes."""
    sized, found = agglomerate(mesh, SIZES, independent_of_ranks=independent), made.quality(0, ["UF", "CR"])
    return [found["UF"], found["CR"], sized.parts[0], sized.quality(0, ["CR"])["CR"]]


def quality(mesh: DistributedMesh, made: Any) -> dict[str, Any]:
    """Return counts, sizes, halos and labels over all ranks."""
    mesh.check()
    sized = agglomerate(mesh, SIZES)
    counts = [max(1, round(mesh.n_cells / c)) for c in (16, 256, 4096)]
    found = made.quality(0, ["UF", "CR"])
    sizes = [sized.quality(k, ["CR"]) for k in range(3)]
    kept = all(
        q["max_diameter"] <= t["h_star"] * (1 + 1e-9) for q, t in zip(sizes, sized.targets, strict=True)
    )
    connected = min(found["connected"], *(q["connected"] for q in sizes))
    return {
        "parts": made.parts,
        "kept": kept and made.parts == counts,
        "UF": found["UF"],
        "CR": found["CR"],
        "sized": sized.parts,
        "sized CR": sizes[0]["CR"],
        "connected": connected,
        "labels": digest(mesh, [*made.levels, *sized.levels]),
    }


def shapes_on_rank(cells: int, seeds: int) -> None:
    """Measure shapes for both ways, mesh by mesh.

    Rank 0 prints the rows as JSON.
    """
    ranks = Ranks()
    rows = []
    for seed in range(1, seeds + 1):
        whole = samples.random_triangles(cells // 2, seed=seed) if ranks.rank == 0 else None
        mesh = DistributedMesh.scatter(whole, ranks)
        ways = [(each, agglomerate(mesh, COUNTS, independent_of_ranks=each)) for each in (None, False)]
        rows.append([shapes_of(mesh, made, each) for each, made in ways])
    if ranks.rank == 0:
        print("RESULT" + json.dumps(rows), flush=True)


def shapes(cells: int, seeds: int, sizes: Sequence[int]) -> None:
    """Print means over random meshes, and differences to the whole mesh on one rank."""
    print(f"\n{seeds} meshes of {cells:,} triangles: mean (difference to no borders ± standard error)")
    print("ranks                    UF                      CR                sizes: CR        parts")
    asked = ["--shapes-of", str(cells), "--seeds", str(seeds)]
    rows = {size: np.array(launched(size, asked)) for size in {1: None} | dict.fromkeys(sizes)}
    for way, name in enumerate(("blocks", "lying")):
        for size in sizes:
            there = rows[size][:, way]
            off = there - rows[1][:, 1]
            error = off.std(axis=0, ddof=1) / np.sqrt(seeds)
            told = [f"{there[:, k].mean():.3f} ({off[:, k].mean():+.4f} ± {error[k]:.4f})" for k in (0, 1, 3)]
            parts = f"{there[:, 2].mean():8.0f} ({off[:, 2].mean():+.0f} ± {error[2]:.0f})"
            print(f"{size:5} {name:>6}  " + "  ".join(told) + parts, flush=True)


def launched(size: int, arguments: Sequence[str]) -> Any:
    """Run ``size`` ranks and return the result printed by rank 0."""
    own = Path(sys.executable).parent / "mpiexec"
    mpiexec = str(own) if own.exists() else shutil.which("mpiexec")
    if mpiexec is None:
        raise SystemExit("there is no mpiexec: pip install 'agglo[mpi]'")
    command = [mpiexec, "-n", str(size), sys.executable, "-m", "mpi4py", __file__, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT")]
    if done.returncode or not lines:
        raise SystemExit(done.stdout + done.stderr)
    return json.loads(lines[0].removeprefix("RESULT"))


def strong(name: str, mesh: Mesh, sizes: Sequence[int], folder: Path) -> list[list[dict[str, Any]]]:
    """Measure one mesh on an increasing number of ranks."""
    file = folder / f"{name}.npz"
    agglo.write(file, mesh)
    print(f"\n{name}, {mesh.n_cells:,} cells")
    heads = "ranks  seconds    parts     UF    CR  kept  connected   sizes: parts     CR  same  messages"
    print(heads + "   kB sent  halo kB  B/cell")
    every = []
    for size in sizes:
        ranks = launched(size, ["--rank-of", str(file), "--full"])
        every.append(ranks)
        first = ranks[0]
        # Row of the slowest or busiest rank.
        row = {key: max(each[key] for each in ranks) for key in ("seconds", "messages", "bytes", "halo")}
        memory = max(each["memory"] / each["own"] for each in ranks)
        same = first["labels"] == every[0][0]["labels"]
        print(
            f"{size:5} {row['seconds']:8.2f} {first['parts'][0]:8,} {first['UF']:6.3f} {first['CR']:5.3f} "
            f"{'yes' if first['kept'] else 'NO':>5} {100 * first['connected']:8.1f} % "
            f"{first['sized'][0]:14,} "
            f"{first['sized CR']:6.3f} {'yes' if same else 'NO':>5} {row['messages']:9} "
            f"{row['bytes'] / 1e3:9.1f} {row['halo'] / 1e3:8.1f} {memory:7.0f}",
            flush=True,
        )
        # Row without independence of ranks, then messages by level.
        UF, CR, parts, sized = first["lying shapes"]
        seconds = max(each["lying"] for each in ranks)
        print(f"lying {seconds:8.2f} {'':8} {UF:6.3f} {CR:5.3f} {'':16}{parts:14,} {sized:6.3f}")
        for level in range(len(first["by_level"])):
            most = {key: max(each["by_level"][level][key] for each in ranks) for key in ("messages", "bytes")}
            print(
                f"{'':6}level {level}: {most['messages']:6} messages {most['bytes'] / 1e3:9.1f} kB",
                flush=True,
            )
    return every


def weak(cells: int, sizes: Sequence[int], folder: Path) -> list[list[dict[str, Any]]]:
    """Measure triangles with a fixed number per rank."""
    print(f"\nweak scaling, {cells:,} triangles on each rank\nranks  seconds  messages   kB sent")
    every = []
    for size in sizes:
        file = folder / f"weak{size}.npz"
        agglo.write(file, MESHES["triangles"](cells * size))
        ranks = launched(size, ["--rank-of", str(file)])
        every.append(ranks)
        row = {key: max(each[key] for each in ranks) for key in ("seconds", "messages", "bytes")}
        print(f"{size:5} {row['seconds']:8.2f} {row['messages']:9} {row['bytes'] / 1e3:9.1f}", flush=True)
    return every


def model(runs: Sequence[list[dict[str, Any]]]) -> None:
    """Fit and extrapolate seconds, messages and bytes per rank.

    The model depends on the cells of a rank and on the number of ranks.
    """
    # Seconds and memory are proportional to cells, ghosts to the square root of cells.
    ranks = [each for run in runs for each in run]
    per_cell = float(np.median([each["seconds"] / each["own"] for each in ranks]))
    border = [each["ghosts"] / each["own"] ** 0.5 for each in ranks if each["ghosts"]]
    memory = float(np.median([each["memory"] / each["own"] for each in ranks]))
    # Messages and bytes are nonnegative combinations of P - 1 and log2 P.
    size = np.array([float(len(run)) for run in runs for _ in run])
    turns = np.stack((size - 1, np.ceil(np.log2(size))), axis=1)

    def fitted(key: str) -> Any:
        return nnls(turns, np.array([float(each[key]) for each in ranks]))[0]  # nonnegative coefficients

    messages, sent = fitted("messages"), fitted("bytes")
    print("\nmodel of one rank with n cells, of P, fitted to the runs on triangles")
    print(f"  seconds   {1e6 * per_cell:.2f} us n")
    print(f"  messages  {messages[0]:.1f} (P - 1) + {messages[1]:.1f} log2 P")
    print(f"  bytes     {sent[0]:.0f} (P - 1) + {sent[1]:.0f} log2 P")
    print(f"  ghosts    {np.mean(border):.1f} sqrt(n)" if border else "  ghosts    none seen")
    print(f"  memory    {memory:.0f} B n")
    # Extrapolate to large runs.
    for cells, many in FAR:
        n, more = cells / many, np.array([many - 1.0, np.ceil(np.log2(many))])
        print(
            f"  {cells:.0e} cells on {many:,} ranks: {per_cell * n:.1f} s, {messages @ more:,.0f} messages, "
            f"{sent @ more / 1e6:.2f} MB of a rank, {memory * n / 1e9:.2f} GB; "
            f"one rank that reads the whole mesh: {memory * cells / 1e9:,.0f} GB"
        )
    print("  what breaks first: one file read by one rank; then messages of everybody to everybody")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="*", default=["triangles", "voronoi", "tetrahedra"])
    parser.add_argument("--cells", type=int, default=1_000_000, help="tetrahedra: three tenths of it")
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--seeds", type=int, default=12, help="meshes whose shapes are compared")
    parser.add_argument("--shapes-of", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--rank-of", help=argparse.SUPPRESS)
    parser.add_argument("--full", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.rank_of:
        on_rank(options.rank_of, options.full)
        return
    if options.shapes_of:
        shapes_on_rank(options.shapes_of, options.seeds)
        return
    shapes(options.cells // 10, options.seeds, options.ranks)
    with tempfile.TemporaryDirectory() as name:
        runs: list[list[dict[str, Any]]] = []
        for mesh in options.meshes:
            cells = int(options.cells * (0.3 if mesh == "tetrahedra" else 1))
            found = strong(mesh, MESHES[mesh](cells), options.ranks, Path(name))
            runs += found if mesh == "triangles" else []
        runs += weak(options.cells // max(options.ranks), options.ranks, Path(name))
        model(runs)


if __name__ == "__main__":
    main()
