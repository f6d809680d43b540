"""Parts long in one direction

A metric says in which lengths to measure: here heights count three times as much as widths, so parts become
two to three times as wide as high. For a permeability K the metric is its inverse.
"""

import numpy as np

import agglo_core as agglo

mesh = agglo.samples.voronoi(1200, seed=2)
hierarchy = agglo.agglomerate(mesh, n_parts=40, metric=np.diag([1.0, 9.0]))
extents = [np.ptp(mesh.cell_centroids[hierarchy.levels[0] == part], axis=0) for part in range(40)]
wide, high = np.mean(extents, axis=0)
ratio = round(float(wide / high), 1)

if __name__ == "__main__":
    agglo.plot.draw(mesh, {"metric": hierarchy}, "stretched_parts.png")
