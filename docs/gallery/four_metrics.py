"""Four metrics of the same parts

What metrics see: sizes (UF), narrow places (CR), the whole shape (J), bays (convexity). The worst of 40
parts is another one for each.
"""

import agglo_core as agglo

mesh = agglo.samples.voronoi(800, seed=6)
labels = agglo.agglomerate(mesh, n_parts=40, bisector="coordinate", refiners=(), polish=False).levels[0]
values = agglo.quality(mesh, labels, metrics=["UF", "CR", "J", "convexity"])
worst = {name: round(float(each.min()), 2) for name, each in values.items()}

if __name__ == "__main__":
    import numpy as np
    from matplotlib import pyplot
    from matplotlib.collections import PolyCollection

    coarse = mesh.coarsen(labels)
    loops = coarse.boundary_loops
    corners = np.split(coarse.points[loops.vertices], loops.loop_offsets[1:-1])
    figure, axes = pyplot.subplots(1, 4, figsize=(12, 3.2), layout="constrained")
    for axis, (name, each) in zip(axes, values.items(), strict=True):
        shown = PolyCollection(corners, array=each, cmap="viridis", edgecolor="white", clim=(0, 1))
        axis.add_collection(shown)
        axis.set(title=f"{name}, mean {each.mean():.2f}", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        axis.set_axis_off()
    figure.colorbar(shown, ax=axes, shrink=0.8)
    figure.savefig("four_metrics.png", dpi=160)
