"""A bisector in ten lines

Any object with a method ``bisect`` splits pieces; agglo makes both sides connected, and here leaves the
interfaces as they are cut: along circles.
"""

import numpy as np

import agglo_core as agglo


class Rings:
    """Half of the area on either side of a circle around the centre of the unit square."""

    def bisect(self, graph, rng):
        radius = np.linalg.norm(graph.centroids + graph.origin - 0.5, axis=1)
        order = np.argsort(radius, kind="stable")
        half = np.searchsorted(np.cumsum(graph.measures[order]), graph.measures.sum() / 2)
        sides = np.ones(graph.n, int)
        sides[order[: np.clip(half, 1, graph.n - 1)]] = 0
        return sides


mesh = agglo.samples.voronoi(1500, seed=1)
rings = agglo.agglomerate(mesh, bisector=Rings(), refiners=(), polish=False, n_parts=8)
parts = rings.parts[0]

if __name__ == "__main__":
    agglo.plot.draw(mesh, {"rings": rings}, "own_bisector.png")
