"""Who splits, and how round it gets

The same mesh and the same 40 parts by four bisectors, as they come out of the recursion: without the
polish, which would make them more alike. CR is the circle ratio; two of the four are drawn.
"""

import agglo_core as agglo

mesh = agglo.samples.random_triangles(600, seed=1)
runs = {
    name: agglo.agglomerate(mesh, bisector=name, n_parts=40, polish=False)
    for name in ("kmeans", "sweep", "inertial", "coordinate")
}
measured = {name: agglo.quality(mesh, run.levels[0], metrics=["CR"]) for name, run in runs.items()}
circle_ratios = {name: round(float(values["CR"].mean()), 3) for name, values in measured.items()}

if __name__ == "__main__":
    two = {name: runs[name] for name in ("sweep", "coordinate")}
    agglo.plot.draw(mesh, two, "bisectors_compared.png")
