"""Nested coarse levels

A Voronoi mesh and three levels, the sizes of which are asked for in units of the mesh size. Every part of a
level is a union of parts of the finer one.
"""

import agglo_core as agglo

mesh = agglo.samples.voronoi(1200, seed=3)
hierarchy = agglo.agglomerate(mesh, h_factor=(2, 4, 8), seed=0)
parts = hierarchy.parts

if __name__ == "__main__":
    agglo.plot.draw(mesh, {"k-means": hierarchy}, "nested_levels.png")
