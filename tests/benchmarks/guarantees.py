"""Check all guarantees of the default partition on fresh random meshes.

    python tests/benchmarks/guarantees.py [--meshes N] [--cells N]

Each mesh is agglomerated into two nested levels. Checked: exact numbers of parts, connected parts, nested
levels, equal labels in a second run and with two threads, the same parts for cells numbered otherwise and for
a turned mesh, parts within regions, and a second run by size whose parts are not wider than the target. One
line per family shows the number of meshes that break each guarantee.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples

GUARANTEES = (
    "counts",
    "connected",
    "nested",
    "deterministic",
    "threads",
    "numbering",
    "motion",
    "regions",
    "sizes",
)


def families(cells: int) -> dict[str, Callable[[int], Mesh]]:
    """Return functions of a seed for meshes with about ``cells`` cells, by name."""

    def mapped(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[int], Mesh]:
        def make(seed: int) -> Mesh:
            mesh = samples.voronoi(cells, seed=seed)
            return replace(mesh, points=change(mesh.points))

        return make

    return {
        "triangles": lambda seed: samples.random_triangles(cells // 2, seed=seed),
        "Voronoi": lambda seed: samples.voronoi(cells, seed=seed),
        "tetrahedra": lambda seed: samples.random_tetrahedra(cells // 5, seed=seed),
        "stretched 20 times": mapped(lambda points: points * [20.0, 1.0]),
        "graded": mapped(lambda points: points**3),
    }


def same_parts(one: np.ndarray, other: np.ndarray) -> bool:
    """Return True if two labellings differ at most in the part numbers."""
    return len(np.unique(np.stack((one, other)), axis=1).T) == one.max() + 1 == other.max() + 1


def broken_guarantees(mesh: Mesh, seed: int) -> set[str]:
    """Return the guarantees that do not hold on this mesh."""
    rng, graph, d = np.random.default_rng(seed), mesh.graph, mesh.dim
    counts = (graph.n // 10, graph.n // 80)
    levels = agglo.agglomerate(mesh, n_parts=counts).levels
    with agglo.using_threads(2, few=1):
        parallel = agglo.agglomerate(mesh, n_parts=counts).levels
    order = rng.permutation(graph.n)
    scattered = agglo.agglomerate(graph.subgraph(order, [0, graph.n]), n_parts=counts).levels
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    turn[0] *= np.linalg.det(turn)
    moved = agglo.agglomerate(replace(mesh, points=mesh.points @ turn.T), n_parts=counts).levels
    regions = (graph.centroids[:, 0] > np.median(graph.centroids[:, 0])).astype(int)
    within = agglo.agglomerate(mesh, n_parts=counts[0], regions=regions).levels[0]
    size = 4.0 * float(mesh.h)
    by_size = agglo.agglomerate(mesh, h_star=size).levels[0]
    again = agglo.agglomerate(mesh, n_parts=counts).levels
    holds = {
        "counts": tuple(int(labels.max()) + 1 for labels in levels) == counts,
        "connected": all(graph.components(labels).max() == labels.max() for labels in (*levels, by_size)),
        "nested": len(np.unique(np.stack(levels), axis=1).T) == counts[0],
        "deterministic": all(map(np.array_equal, levels, again)),
        "threads": all(map(np.array_equal, levels, parallel)),
        "numbering": all(same_parts(a[order], b) for a, b in zip(levels, scattered, strict=True)),
        "motion": all(map(same_parts, levels, moved)),
        "regions": len(np.unique(np.stack((within, regions)), axis=1).T) == within.max() + 1,
        "sizes": bool(graph.part_diameters(by_size).max() <= size * (1.0 + 1e-9)),
    }
    return {name for name in GUARANTEES if not holds[name]}


def main() -> None:
    """Print a line per family."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--meshes", type=int, default=20)
    parser.add_argument("--cells", type=int, default=1500)
    options = parser.parse_args()
    fresh = int(np.random.SeedSequence().generate_state(1)[0]) % 10**6
    for family, make in families(options.cells).items():
        broken: Counter[str] = Counter()
        for seed in range(fresh, fresh + options.meshes):
            broken.update(broken_guarantees(make(seed), seed))
        faults = ", ".join(f"{name} {broken[name]}" for name in GUARANTEES if broken[name])
        print(f"{family}: {options.meshes} meshes from seed {fresh}, broken: {faults or 'none'}", flush=True)


if __name__ == "__main__":
    main()
