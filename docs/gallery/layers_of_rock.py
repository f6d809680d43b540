"""Materials kept apart

``regions`` names a cell tag; no part holds cells of two of its values. How many parts would have been mixed
without?
"""

import numpy as np

import agglo_core as agglo

mesh = agglo.samples.voronoi(1500, seed=2)
x, y = mesh.cell_centroids.T
layer = np.floor(6 * (y + 0.15 * np.sin(5 * x))).astype(int) % 2
rocks = mesh.with_tags(rock=layer)
runs = {
    "any part": agglo.agglomerate(rocks, cells_per_part=16),
    "regions": agglo.agglomerate(rocks, cells_per_part=16, regions="rock"),
}


def mixed(labels: np.ndarray) -> int:
    """Parts that hold cells of both rocks."""
    ones = np.bincount(labels, layer)
    return int(((ones > 0) & (ones < np.bincount(labels))).sum())


mixed_parts = [mixed(run.levels[0]) for run in runs.values()]

if __name__ == "__main__":
    agglo.plot.draw(rocks, runs, "layers_of_rock.png")
