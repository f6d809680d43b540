"""Measure cuts through a hierarchy: CPU seconds by size, and reduction of the largest indicator.

    python tests/benchmarks/cuts.py [--cells N ...] [--parts K ...]

Squares in nested blocks of 3, 9, 27 and 81 cells per side. The indicator is 1/r² around a point, times the
measure. The last column is the largest indicator per part, relative to equal blocks with as many parts.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from agglo_core import Hierarchy, samples
from agglo_core.arrays import Float
from agglo_core.hierarchy import by_first_cell


def blocks(side: int) -> tuple[Hierarchy, Float]:
    """Return squares in nested blocks, and the indicator."""
    mesh = samples.squares(side)
    x, y = (mesh.cell_centroids.T * side).astype(int)
    levels = [by_first_cell((x // size) * side + y // size) for size in (3, 9, 27, 81)]
    r = np.linalg.norm(mesh.cell_centroids - [0.3, 0.4], axis=1)
    return Hierarchy(mesh, mesh.graph, levels, [{}] * 4, True), mesh.cell_measures / (r**2 + 1e-3)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", nargs="+", type=int, default=[100_000, 1_000_000])
    parser.add_argument("--parts", nargs="+", type=int, default=[1_000, 10_000])
    given = parser.parse_args()
    print("    cells    parts  objective  grade  seconds  largest")
    for n in given.cells:
        hierarchy, indicator = blocks(round(n**0.5))
        start = time.process_time()
        roots = hierarchy.forest.n_roots
        print(f"{hierarchy.graph.n:9}  {'trees':>26}  {time.process_time() - start:7.3f}")
        for objective, grade in (("largest", None), ("largest", 1), ("squares", None)):
            hierarchy.cut(roots, indicator, objective=objective, grade=grade)  # compiles
            for k in given.parts:
                start = time.process_time()
                cut = hierarchy.cut(k, indicator, objective=objective, grade=grade)
                taken = time.process_time() - start
                ratio = np.bincount(cut.labels, indicator).max() / alike(hierarchy, indicator, k)
                print(f"{'':9} {cut.n_parts:8}  {objective:>9}  {grade!s:>5}  {taken:7.3f}  {ratio:7.2f}")


def alike(hierarchy: Hierarchy, indicator: Float, k: int) -> float:
    """Return the largest indicator on about k equal square blocks."""
    assert hierarchy.fine is not None
    x, y = (hierarchy.fine.cell_centroids.T * round(k**0.5)).astype(int)
    return float(np.bincount(x * round(k**0.5) + y, indicator).max())


if __name__ == "__main__":
    main()
