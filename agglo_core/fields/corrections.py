"""Problems that corrections on agglomerates solve."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.arrays import Int, frozen_float
from agglo_core.fields.tensors import is_tensor, tensor
from agglo_core.fields.values import sample
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion


def corrections(problem: Diffusion, mesh: Mesh, labels: Int) -> Diffusion:
    """Return the problem that corrections on agglomerates solve: equal conditions with zero data."""
    return Diffusion(
        kappa=_average_coefficient(problem.kappa, mesh, labels, "kappa"),
        reaction=_average_coefficient(problem.reaction, mesh, labels, "reaction"),
        source=0.0,
        dirichlet=dict.fromkeys(problem.dirichlet, 0.0),
        neumann=dict.fromkeys(problem.neumann, 0.0),
        convection=_average_velocity(problem.convection, mesh, labels),
        robin={
            tag: (alpha if callable(alpha) else _average_coefficient(alpha, mesh, labels, "alpha"), 0.0)
            for tag, (alpha, _) in problem.robin.items()
        },
        boundary=problem.boundary,
    )


def _average_velocity(convection: Any, mesh: Mesh, labels: Int) -> Any:
    """Average cell values of b over agglomerates, and return anything else unchanged."""
    if callable(convection) or np.ndim(convection) < 2:
        return convection
    volumes = np.bincount(labels, mesh.cell_measures)
    columns = [np.bincount(labels, mesh.cell_measures * column) / volumes for column in convection.T]
    return frozen_float(np.stack(columns, axis=1))


def _average_coefficient(field: Any, mesh: Mesh, labels: Int, name: str) -> Any:
    """Average the coefficient over each agglomerate's cells.

    A callable is evaluated at cell centroids.
    """
    if not callable(field) and np.ndim(field) in (0, 2):
        return field
    if is_tensor(field, mesh):
        entries = tensor(mesh, field).at(mesh.cell_centroids, slice(None)) * mesh.cell_measures[:, None, None]
        sums = np.zeros((int(labels.max()) + 1, mesh.dim, mesh.dim))
        np.add.at(sums, labels, entries)
        return frozen_float(sums / np.bincount(labels, mesh.cell_measures)[:, None, None])
    cells = sample(field, mesh.cell_centroids, name) if callable(field) else np.asarray(field, float)
    weighted = np.bincount(labels, mesh.cell_measures * cells)
    return frozen_float(weighted / np.bincount(labels, mesh.cell_measures))
