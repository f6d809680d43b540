"""Time the k-way partition of ``gnn_paper`` on a device beside METIS and ``kmeans`` on the host.

    python tests/benchmarks/gpu.py [CELLS ...] [--device cuda] [--precision single] [--repeats N]

Random triangles, parts of 16 cells on average. Seconds are the least of the repeats, with one host thread,
after a warm-up: wall time on a GPU, CPU time otherwise. ``J`` and ``CR`` are explained in partition.py,
``interface`` is relative to METIS. ``run`` is a whole ``agglo.agglomerate``, ``partition`` the part of it in
the bisector, ``curve`` its polish from runs of a Hilbert curve instead of the network. The steps are listed
with the number of tensor operations, the bytes of their arguments and results, and the floating-point
operations in matrix products. On a GPU, the last line compares the labels with those of the CPU.
"""

from __future__ import annotations

import os

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "BLIS"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"  # before numpy is imported

# ruff: noqa: E402
import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from partition import connected, energy, metis, roundness
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

import agglo_core as agglo
from agglo_core import Graph, Target, samples
from agglo_core.agglomeration.levels.curve import connected_runs
from agglo_core.arrays import frozen_index, frozen_int
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.graph.ordering import curve_order
from agglo_gnn.device.graph import DeviceGraph
from agglo_gnn.device.polish import mend, polish
from agglo_gnn.device.recursion import bisect_to_parts
from agglo_gnn.paper.bisector import PaperGNN

QUICK = ("kmeans", {"effort": "quick"})


class Traffic(TorchDispatchMode):
    """Count tensor operations other than views, and the bytes of their arguments and results."""

    def __init__(self) -> None:
        super().__init__()
        self.operations, self.bytes = 0, 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if not func.is_view:
            self.operations += 1
            tensors = [x for x in tree_leaves((args, kwargs, result)) if isinstance(x, torch.Tensor)]
            self.bytes += sum(x.numel() * x.element_size() for x in tensors)
        return result


def clock(device: str) -> float:
    """Return wall seconds when the GPU has finished its work, or CPU seconds of the process."""
    if device == "cpu":
        return time.process_time()
    torch.cuda.synchronize()
    return time.perf_counter()


def best_of(repeats: int, device: str, call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least seconds of a call, and its result."""
    seconds = []
    for _ in range(repeats):
        start = clock(device)
        result = call()
        seconds.append(clock(device) - start)
    return min(seconds), result


def from_curve(graph: Graph, parts: int, device: str) -> Any:
    """Polish runs of the curve in rounds, for comparison with the network as the start."""
    order = curve_order(graph.centroids)
    ends = frozen_int([0, graph.n])
    ordered = graph.subgraph(order, ends)
    cells = frozen_index(np.arange(graph.n))
    runs = connected_runs(ordered, ordered.mass, cells, ends, frozen_int([parts]))
    start = torch.from_numpy(runs.copy()).to(device)
    labels = np.empty(graph.n, np.int64)
    labels[order] = polish(DeviceGraph.of(ordered, device), start, parts).cpu().numpy()
    return labels


def compare(cells: int, tool: PaperGNN, repeats: int) -> None:
    """Print the methods and the steps for one mesh."""
    mesh = samples.random_triangles(cells // 2, seed=11)
    graph, parts = mesh.graph, mesh.n_cells // 16
    counted = graph.with_mass(np.ones(graph.n))  # cells are what runs balance

    def run(bisector: Any, method: str) -> Any:
        return agglo.agglomerate(graph, bisector=bisector, n_parts=parts, method=method).levels[0]

    methods: dict[str, Callable[[], Any]] = {
        "METIS recursive": lambda: metis(recursive=True)(graph, parts),
        "kmeans": lambda: run("kmeans", "recursive"),
        "kmeans:effort=quick": lambda: run(QUICK, "kway"),
        "gnn_paper, run": lambda: run(tool, "kway"),
        "gnn_paper, partition": lambda: tool.partition(counted, Target(parts=parts), 0),
        "curve, same polish": lambda: from_curve(counted, parts, tool.device),
    }
    print(f"\n{graph.n} triangles, {parts} parts, {tool.device}")
    print(f"{'':22}{'seconds':>9}{'J':>8}{'CR':>8}{'interface':>11}{'connected':>11}")
    base = 0.0
    for name, method in methods.items():
        seconds, labels = best_of(repeats, tool.device, method)
        cut = OBJECTIVES["interface"].value(graph, labels)
        base = base or cut
        print(
            f"{name:22}{seconds:9.3f}{energy(graph, labels):8.3f}{roundness(mesh, labels):8.3f}"
            f"{cut / base:11.3f}{connected(graph, labels):10.1f}%",
            flush=True,
        )
    steps(counted, parts, tool, repeats)
    if tool.device == "cuda":
        host = PaperGNN().partition(counted, Target(parts=parts), 0)
        labels = PaperGNN(device="cuda").partition(counted, Target(parts=parts), 0)
        print(f"labels equal to those of the CPU in double precision: {np.mean(host == labels):.4f}")


@torch.inference_mode()
def steps(graph: Graph, parts: int, tool: PaperGNN, repeats: int) -> None:
    """Print seconds and work of each step of the partition."""
    data = DeviceGraph.of(graph, tool.device)
    bisected = bisect_to_parts(data, parts, tool._odds)
    mended = mend(data, bisected, parts)
    calls: dict[str, Callable[[], Any]] = {
        "copy": lambda: DeviceGraph.of(graph, tool.device),
        "inference": lambda: bisect_to_parts(data, parts, tool._odds),
        "mend": lambda: mend(data, bisected, parts),
        "polish": lambda: polish(data, mended, parts),
    }
    print(f"{'step':22}{'seconds':>9}{'operations':>12}{'GB':>8}{'Gflop':>8}")
    for name, call in calls.items():
        seconds = best_of(repeats, tool.device, call)[0]
        with FlopCounterMode(display=False) as flops, Traffic() as traffic:
            call()
        print(
            f"{name:22}{seconds:9.3f}{traffic.operations:12d}{traffic.bytes / 1e9:8.2f}"
            f"{flops.get_total_flops() / 1e9:8.1f}"
        )


def main() -> None:
    """Print a table for each number of cells."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cells", type=int, nargs="*", default=[100_000, 1_000_000])
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--precision", choices=("single", "double"), default="single")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if options.device == "cuda" and not torch.cuda.is_available():
        print("SKIPPED: torch finds no CUDA device; --device cpu runs this code on the CPU")
        return
    torch.set_num_threads(1)
    tool = PaperGNN(device=options.device, precision=options.precision)
    warm_up = samples.random_triangles(1000, seed=1).graph
    for bisector, method in ((tool, "kway"), ("kmeans", "recursive"), (QUICK, "kway")):
        agglo.agglomerate(warm_up, bisector=bisector, n_parts=100, method=method)
    from_curve(warm_up, 100, options.device)
    for cells in options.cells:
        compare(cells, tool, options.repeats)


if __name__ == "__main__":
    main()
