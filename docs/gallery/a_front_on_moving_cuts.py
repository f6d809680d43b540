"""A front followed by cuts of one hierarchy

The equation ∂u/∂t − ∇·(κ∇u) = u (1 − u) (u − 0.1) on a brain section, whose white matter conducts three
times better. Every six steps `hierarchy.cut` chooses 160 parts for the indicators of the current state: small
ones at the front and ahead of it, large ones behind it. The L2 projection from cut to cut preserves the
integral. With 960 unknowns the state at t = 60 differs by 2 % from that on all triangles, which has 83,868.
With 160 parts of equal size it differs by 6 %.
"""

import numpy as np
from scipy.spatial import KDTree

import agglo_core as agglo

brain = agglo.samples.brain()
depths = KDTree(brain.face_centroids[brain.outer_faces]).query(brain.cell_centroids)[0]
brain = brain.with_tags(white=depths > 4.0)  # mm below the surface
sizes = [3.0**k for k in range(1, 7)]
hierarchy = agglo.agglomerate(brain, cells_per_part=sizes, regions="white")
estimator = agglo.registry.default().build("estimator", "gradient_jump")


def from_focus(points):
    """Distance from the excited disc with a radius of 8 mm."""
    return np.hypot(points[:, 0] + 40.0, points[:, 1] - 10.0) - 8.0


def start(points):
    """Excitation of the disc."""
    return np.where(from_focus(points) < 0.0, 1.0, 0.0)


def current(t, points, u):
    """Reaction of the tissue."""
    return u * (1.0 - u) * (u - 0.1)


def evolved(cut, u0, duration):
    """Return the last state of an evolution on a cut, in steps of 1."""
    kappa = np.where(cut.mesh.cell_tags["white"], 9.0, 3.0)
    tissue = agglo.Diffusion(kappa=kappa, source=0.0, neumann={0: 0.0})
    levels = hierarchy.above(cut)
    states = agglo.evolve(levels, tissue, u0, duration, 1.0, "bdf2", reaction=current, degree=2)
    *_, (_, state) = states
    return state


def follow(cut, state):
    """Return the cut of 160 parts for the indicators of a state, spread to adjacent parts by a quarter."""
    squares = estimator.indicate(state) ** 2
    beside = cut.mesh.graph.to_scipy() > 0.0
    density = (squares + 0.25 * (beside @ squares)) / cut.measures
    return hierarchy.cut(160, density[cut.labels] * brain.cell_measures, grade=1)


near = np.exp(-0.5 * np.abs(from_focus(brain.cell_centroids)))
cuts, states, u0 = [hierarchy.cut(160, near, grade=1)], [], start
for _ in range(10):
    states.append(evolved(cuts[-1], u0, 6.0))
    cuts.append(follow(cuts[-1], states[-1]))
    u0 = states[-1].transfer(cuts[-2], cuts[-1])

# Against a fixed cut of as many parts, and all triangles
fine, equal = hierarchy.cut_at(-1), hierarchy.cut(160)
whole = evolved(fine, start, 60.0)
mass = whole.discretisation.mass(brain)
gaps = []
for cut, state in ((cuts[-2], states[-1]), (equal, evolved(equal, start, 60.0))):
    gap = state.transfer(cut, fine).x - whole.x
    gaps.append(round(float(np.sqrt(gap @ mass @ gap / (whole.x @ mass @ whole.x))), 2))
unknowns = (len(whole.x), len(states[-1].x))

if __name__ == "__main__":
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 3, figsize=(11, 6.5), layout="constrained")
    for column, k in zip(axes.T, (0, 4, 9), strict=True):
        states[k].plot(column[0], cmap="inferno")
        column[0].set_title(f"t = {6 * (k + 1)}", fontsize=9)
        cuts[k].mesh.plot(column[1])
        column[1].set_title(f"{cuts[k].n_parts} parts, t = {6 * k} to {6 * (k + 1)}", fontsize=9)
        for axis in column:
            axis.set_axis_off()
    pyplot.savefig("a_front_on_moving_cuts.png", dpi=160)
