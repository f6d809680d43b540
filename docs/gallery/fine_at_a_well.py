"""Fine here, coarse there

A cut through the levels: the best coarse mesh of at most 200 parts for an indicator that peaks at a well,
with neighbours at most one level apart.
"""

import numpy as np

import agglo_core as agglo

mesh = agglo.samples.voronoi(2000, seed=5)
hierarchy = agglo.agglomerate(mesh, cells_per_part=(6, 36, 216), seed=0)
distance = np.linalg.norm(mesh.cell_centroids - [0.3, 0.6], axis=1)
cut = hierarchy.cut(200, mesh.cell_measures / (distance**4 + 1e-4), grade=1)
levels_used = sorted(set(cut.levels.tolist()))

if __name__ == "__main__":
    drawn = agglo.Hierarchy(mesh, mesh.graph, [cut.labels], [{"n_parts": 0}], nested=False)
    agglo.plot.draw(mesh, {"a cut": drawn}, "fine_at_a_well.png")
