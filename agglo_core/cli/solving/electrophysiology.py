"""A wave of excitation on the brain section: the computation of ``agglo demo --electrophysiology``.

The monodomain equation ∂u/∂t − ∇·(K∇u) = u (1 − u) (u − 0.1) − w with w' = 0.01 (0.5 u − w), the membrane of
FitzHugh and Nagumo, in mm and the unit of time of this model. Grey matter is the tissue up to 4 mm below
the surface, with K = 3 I. White matter conducts five times better along its fibres. The fibres are synthetic,
not measured: they follow the gradient of a potential with sources in the deep core and value 0 on the
surface, and so fan out into the gyri.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.progress import Listener, phase

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh
    from agglo_core.problems import Solution
    from agglo_core.problems.discretisation import Samples

TISSUE = "tissue"
"""Cell tag: 1 in grey matter, 2 in white matter."""
T_END, STEP = 60.0, 1.0  # unit of time of the membrane
PICTURE, FRAME = 20.0, 2.0  # time between pictures, and between frames of a film

_GREY = 4.0  # mm below the surface
_ACROSS, _ALONG = 3.0, 15.0  # mm² per unit of time, across and along fibres
_CORE = 0.6  # of the largest depth
_FOCUS, _RADIUS = (-40.0, 10.0), 8.0  # excited disc, mm


@dataclass(frozen=True)
class Wave:
    """Costs and states of the monodomain equation on one mesh with one degree.

    ``setup_seconds`` and ``step_seconds`` are CPU seconds: assembly and levels of all steps together, and the
    mean of the rest. ``integral`` is that of u at the end, in mm².
    """

    mesh: str
    cells: int
    degree: int
    unknowns: int
    steps: int
    iterations: float
    setup_seconds: float
    step_seconds: float
    integral: float
    frames: Mapping[float, Samples]
    last: Solution

    @property
    def name(self) -> str:
        """Mesh and degree."""
        return f"{self.mesh}, p = {self.degree}"

    def data(self) -> dict[str, Any]:
        """Return the costs in JSON types."""
        return {name: value for name, value in vars(self).items() if name not in ("frames", "last")}


class Membrane:
    """Current of the membrane as a reaction, with the recovery variable w at each point."""

    def __init__(self, step: float) -> None:
        self.step = step
        self.w: Any = 0.0

    def __call__(self, t: float, points: Float, u: Float) -> Float:
        """Return the current, and advance w by an explicit step."""
        current: Float = u * (1.0 - u) * (u - 0.1) - self.w
        self.w = self.w + self.step * 0.01 * (0.5 * u - self.w)
        return current


def brain_tissue(mesh: Mesh) -> tuple[Mesh, Float]:
    """Return the section with the cell tag for its tissue, and its conductivity tensors ``(n, 2, 2)``."""
    from scipy.spatial import KDTree

    from agglo_core.problems import Diffusion, solve

    depths = KDTree(mesh.face_centroids[mesh.outer_faces]).query(mesh.cell_centroids)[0]
    core = Diffusion(source=np.where(depths > _CORE * depths.max(), 1.0, 0.0))
    gradients = solve(mesh, core, degree=2, tolerance=1e-10).gradient(mesh.cell_centroids)
    fibres = gradients / np.linalg.norm(gradients, axis=1)[:, None]
    white = depths > _GREY
    along = np.where(white, _ALONG - _ACROSS, 0.0)[:, None, None]
    kappa = _ACROSS * np.eye(2) + along * fibres[:, :, None] * fibres[:, None, :]
    return mesh.with_tags(**{TISSUE: white + 1}), kappa


def on_agglomerates(hierarchy: Hierarchy, kappa: Float) -> tuple[Mesh, Float]:
    """Return the mesh of the first level, and the mean tensor of each agglomerate."""
    fine, labels = hierarchy.fine, hierarchy.levels[0]
    assert fine is not None
    coarse = fine.coarsen(labels)
    shares = fine.cell_measures / coarse.cell_measures[labels]
    means = np.zeros((coarse.n_cells, 2, 2))
    np.add.at(means, labels, shares[:, None, None] * kappa)
    return coarse, means


def wave(name: str, mesh: Mesh, kappa: Float, degree: int, every: float, progress: Listener | None) -> Wave:
    """Solve the monodomain equation by BDF2 steps, with a frame at multiples of ``every``."""
    from agglo_core.problems import Diffusion, evolve

    problem = Diffusion(kappa=kappa, source=0.0, neumann={0: 0.0})
    membrane, spent, setup, counts, frames = Membrane(STEP), 0.0, 0.0, list[int](), dict[float, Any]()
    states = evolve(mesh, problem, _focus, T_END, STEP, "bdf2", reaction=membrane, degree=degree)
    with phase(progress, "stepping", f"{name}, p = {degree}") as notify:
        start = time.process_time()
        for t, state in states:
            spent += time.process_time() - start
            setup += sum(seconds for key, seconds in state.cpu_seconds.items() if key != "solve")
            counts.append(state.iterations)
            if np.isclose(t % every, 0.0):
                frames[t] = state.samples()
            notify(t / T_END)
            start = time.process_time()
    return Wave(
        mesh=name,
        cells=mesh.n_cells,
        degree=degree,
        unknowns=len(state.x),
        steps=len(counts),
        iterations=float(np.mean(counts)),
        setup_seconds=setup,
        step_seconds=(spent - setup) / len(counts),
        integral=float(state.integral()),
        frames=frames,
        last=state,
    )


def _focus(points: Float) -> Float:
    return np.where(np.hypot(*(points - _FOCUS).T) < _RADIUS, 1.0, 0.0)
