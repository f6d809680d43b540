"""The roundest parts of a size

With an ``effort`` and the objective ``roundness`` direct partitions are annealed: fewer, rounder parts of
the same largest diameter, for a little more time.
"""

import agglo_core as agglo

mesh = agglo.samples.voronoi(300, seed=4)
round_parts = ("kmeans", {"effort": "good", "objective": "roundness"})
runs = {
    "default": agglo.agglomerate(mesh, h_star=0.35),
    "annealed": agglo.agglomerate(mesh, h_star=0.35, bisector=round_parts, method="kway"),
}
parts = [run.parts[0] for run in runs.values()]

if __name__ == "__main__":
    agglo.plot.draw(mesh, runs, "roundest_parts.png")
