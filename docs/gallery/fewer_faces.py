"""Coarse meshes with fewer faces

Agglomerates of Voronoi cells have many small edges. Within a tenth of their diameters most can go; cells
still tile the domain.
"""

import numpy as np

import agglo_core as agglo

fine = agglo.samples.voronoi(1000, seed=3)
coarse = agglo.agglomerate(fine, cells_per_part=20).mesh(0)
simple = coarse.simplified(tolerance=0.1)
faces = (coarse.n_faces, simple.n_faces)

if __name__ == "__main__":
    each, targets = np.arange(simple.n_cells), [{"n_parts": simple.n_cells}]
    drawn = agglo.Hierarchy(simple, simple.graph, [each], targets, nested=True)
    agglo.plot.draw(simple, {"simplified": drawn}, "fewer_faces.png")
