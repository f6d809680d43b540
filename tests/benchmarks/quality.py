"""Measure the quality of every installed bisector on random meshes and on the brain.

    python tests/benchmarks/quality.py [--seeds N]

Means over N meshes per family (random triangles with 128 interior points, Voronoi with 256 cells) at h* =
√2/4, and one section of a brain at 0.2 D; default refiner and fixer. For a single mesh and h* the noise is
about 0.03 in UF and 0.02 in CR.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples

METRICS = ("UF", "CR", "CRc", "J", "isoperimetric")

_WIDTH = 15


def families(seeds: int) -> dict[str, tuple[list[Mesh], float]]:
    """Return meshes and target size by name."""
    brain = samples.brain()
    size = float(np.sqrt(2) / 4)
    return {
        "random triangles": ([samples.random_triangles(128, seed=s) for s in range(seeds)], size),
        "Voronoi": ([samples.voronoi(256, seed=s) for s in range(seeds)], size),
        "brain": ([brain], 0.2 * float(brain.graph.diameters()[0])),
    }


def means(meshes: Sequence[Mesh], h_star: float, bisector: str) -> list[float]:
    """Return the mean part count, mean metrics, and mean diameter over h*."""
    rows = []
    for mesh in meshes:
        labels = agglo.agglomerate(mesh, bisector=bisector, h_star=h_star).levels[0]
        values = agglo.quality(mesh, labels, metrics=METRICS)
        diameters = mesh.coarsen(labels).cell_diameters
        row = [len(diameters), *(values[name].mean() for name in METRICS), diameters.mean() / h_star]
        rows.append(row)
    return [float(mean) for mean in np.mean(rows, axis=0)]


def main() -> None:
    """Print a table per family."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    records = agglo.plugins.default().list()
    bisectors = [r.name for r in records if r.kind == "bisector" and r.state == "ok"]
    for family, (meshes, h_star) in families(seeds).items():
        print(f"\n{family}, {len(meshes)} meshes, h* = {h_star:.4g}")
        print(f"{'':16}{'K':>7}{'diam/h*':>9}{''.join(f'{name:>{_WIDTH}}' for name in METRICS)}")
        for bisector in bisectors:
            parts, *rest, size = means(meshes, h_star, bisector)
            print(f"{bisector:16}{parts:7.1f}{size:9.3f}{''.join(f'{value:{_WIDTH}.3f}' for value in rest)}")


if __name__ == "__main__":
    main()
