"""A fracture that no part crosses

``barriers`` are faces, here those between cells on either side of a line that ends inside the mesh. No part
reaches around its tip either.
"""

import agglo_core as agglo

mesh = agglo.samples.voronoi(1000, seed=7)
owner, neighbour = mesh.face_cells.T
x, y = mesh.cell_centroids.T
above = y > 0.3 + 0.4 * x
crossed = (neighbour >= 0) & (above[owner] != above[neighbour]) & (x[owner] < 0.7)
hierarchy = agglo.agglomerate(mesh, h_factor=(3, 6), barriers=crossed)
parts_across = [int((labels[owner] == labels[neighbour])[crossed].sum()) for labels in hierarchy.levels]

if __name__ == "__main__":
    agglo.plot.draw(mesh, {"one fracture": hierarchy}, "one_fracture.png")
