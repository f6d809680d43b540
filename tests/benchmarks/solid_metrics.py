"""Measure the cost of metrics in 3-D: single-thread CPU seconds on agglomerates of random tetrahedra.

    python tests/benchmarks/solid_metrics.py [--points N] [--cells-per-part M]

238,000 points give about a million tetrahedra. The coarse mesh and its geometry, shared by all metrics, are
counted separately; kernels are compiled before.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.registry import default

METRICS = (
    *("CR", "CRc", "UF", "J", "isoperimetric"),
    *("convexity", "star_shapedness", "box_ratio", "face_ratio"),
)


def geometry(mesh: Mesh) -> None:
    """Compute the geometry shared by all metrics."""
    _ = mesh.cell_faces, mesh.cell_vertices, mesh.cell_measures, mesh.cell_diameters, mesh.face_measures


def main() -> None:
    """Print seconds and means, with a line per metric."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=238_000)
    parser.add_argument("--cells-per-part", type=int, default=10)
    given = parser.parse_args()
    small = samples.random_tetrahedra(50)
    agglo.quality(small, np.arange(small.n_cells), metrics=METRICS)
    mesh = samples.random_tetrahedra(given.points)
    hierarchy = agglo.agglomerate(mesh, bisector="kmeans", cells_per_part=given.cells_per_part)
    labels = hierarchy.levels[0]
    start = time.process_time()
    coarse = mesh.coarsen(labels)
    geometry(coarse)
    total = time.process_time() - start
    print(f"{mesh.n_cells:,} tetrahedra, {coarse.n_cells:,} agglomerates")
    print(f"{'coarse mesh':16}{total:7.2f} s")
    own = np.arange(coarse.n_cells)
    for name in METRICS:
        metric = default().build("metric", name)
        start = time.process_time()
        values = metric.measure(coarse, own)
        seconds = time.process_time() - start
        total += seconds
        print(f"{name:16}{seconds:7.2f} s   mean {values.mean():.3f}")
    print(f"{'all':16}{total:7.2f} s")


if __name__ == "__main__":
    main()
