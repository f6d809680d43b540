"""Exactly as many as asked for

With ``n_parts`` every level has that many parts, whatever the mesh: here the section of a brain with five
holes.
"""

import agglo_core as agglo

mesh = agglo.samples.brain_holes()
hierarchy = agglo.agglomerate(mesh, n_parts=(100, 20, 4))
counts = [int(labels.max()) + 1 for labels in hierarchy.levels]

if __name__ == "__main__":
    agglo.plot.draw(mesh, {"100, 20, 4": hierarchy}, "exact_counts.png")
