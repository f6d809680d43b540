"""Diffusion problems on the parts of a cut: data given by cell become data by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int, Mask, first_of_each, frozen_float
from agglo_core.errors import OptionError
from agglo_core.hierarchy.cuts import Cut
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field


class PosedOnCuts:
    """Problem on a mesh that can be posed on cuts.

    Coefficients and boundary data by cell must be constant in a part: parts where they vary are divided. The
    source by cell is averaged over a part, and :meth:`source_oscillation` bounds the effect.

    Attributes
    ----------
    problem : Diffusion
    mesh : Mesh
    """

    def __init__(self, problem: Diffusion, mesh: Mesh) -> None:
        self.problem, self.mesh = problem, mesh

    @property
    def regions(self) -> Int | None:
        """Region ``(n_cells,)`` of equal coefficients, or None if no coefficient is given by cell."""
        columns = [values for values, cells in self._columns() if cells.all()]
        if not columns:
            return None
        return np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)[1].ravel()

    def mixed_parts(self, cut: Cut) -> Mask:
        """Return a mask of the parts in which data by cell vary, other than the source."""
        mixed = np.zeros(cut.n_parts, bool)
        for values, cells in self._columns():
            least, most = np.full(cut.n_parts, np.inf), np.full(cut.n_parts, -np.inf)
            np.minimum.at(least, cut.labels[cells], values[cells])
            np.maximum.at(most, cut.labels[cells], values[cells])
            mixed |= most > least
        return mixed

    def on(self, cut: Cut) -> Diffusion:
        """Return the problem with the parts of a cut as cells. No part may be mixed."""
        problem, labels, first = self.problem, cut.labels, first_of_each(cut.labels)
        source = problem.source
        if self._by_cell(source):
            weighted = np.asarray(source) * self.mesh.cell_measures
            source = frozen_float(
                np.bincount(labels, weighted) / np.bincount(labels, self.mesh.cell_measures)
            )
        coefficients: dict[str, Any] = {
            name: np.asarray(field)[first] if self._by_cell(field) else field
            for name, field in self._coefficients().items()
        }
        robin = {tag: tuple(self._at_faces(tag, v, labels) for v in p) for tag, p in problem.robin.items()}
        return replace(
            problem,
            source=source,
            **coefficients,
            dirichlet={tag: self._at_faces(tag, v, labels) for tag, v in problem.dirichlet.items()},
            neumann={tag: self._at_faces(tag, v, labels) for tag, v in problem.neumann.items()},
            robin=robin,
        )

    def source_oscillation(self, cut: Cut) -> Float:
        """Return h/π ‖f − mean f‖ / √κ per part ``(n_parts,)`` for a source by cell, else 0."""
        source, labels = self.problem.source, cut.labels
        if not self._by_cell(source):
            return np.zeros(cut.n_parts)
        gaps = np.asarray(source, float) - np.asarray(self.on(cut).source)[labels]
        squares = np.bincount(labels, self.mesh.cell_measures * gaps**2)
        kappa = self.problem.kappa
        values = np.asarray(kappa(self.mesh.cell_centroids) if callable(kappa) else kappa, float)
        if values.ndim >= 2:
            values = np.linalg.eigvalsh(values)[..., 0]
        smallest = np.full(cut.n_parts, np.inf)
        np.minimum.at(smallest, labels, np.broadcast_to(values, len(labels)))
        return np.asarray(cut.mesh.cell_diameters / np.pi * np.sqrt(squares / smallest))

    def _coefficients(self) -> Mapping[str, Any]:
        return {name: getattr(self.problem, name) for name in ("kappa", "reaction", "convection")}

    def _columns(self) -> Iterator[tuple[Float, Mask]]:
        """Yield each component of the data by cell ``(n_cells,)``, with a mask of the cells that use it."""
        everywhere = np.ones(self.mesh.n_cells, bool)
        for field in self._coefficients().values():
            if self._by_cell(field):
                for column in np.asarray(field, float).reshape(self.mesh.n_cells, -1).T:
                    yield column, everywhere
        problem = self.problem
        pairs = [(tag, field) for tag, pair in problem.robin.items() for field in pair]
        for tag, field in (*problem.dirichlet.items(), *problem.neumann.items(), *pairs):
            if self._by_cell(field):
                yield np.asarray(field, float), self._beside(tag)

    def _by_cell(self, field: Any) -> bool:
        """Return True for an array with one number, vector or matrix for each cell."""
        if callable(field):
            return False
        shape, dim = np.shape(field), self.mesh.dim
        return len(shape) > 0 and shape[0] == self.mesh.n_cells and shape not in ((dim,), (dim, dim))

    def _beside(self, tag: int) -> Mask:
        """Return a mask of the cells with a boundary face that has a tag."""
        mesh, outer = self.mesh, self.mesh.outer_faces
        tags = mesh.face_tags.get(self.problem.boundary, np.zeros(mesh.n_faces, int))
        beside = np.zeros(mesh.n_cells, bool)
        beside[mesh.face_cells[outer & (tags == tag), 0]] = True
        return beside

    def _at_faces(self, tag: int, field: Any, labels: Int) -> Any:
        """Return boundary data with values by cell replaced by values by part, 0 away from the boundary."""
        if not self._by_cell(field):
            return field
        beside = self._beside(tag)
        values = np.zeros(int(labels.max()) + 1)
        values[labels[beside]] = np.asarray(field, float)[beside]
        return frozen_float(values)


def dual_problem(problem: Diffusion, goal: Field) -> Diffusion:
    """Return the problem with source ψ and boundary data 0, whose solution weighs errors of ∫ ψ u.

    Raises
    ------
    OptionError
        For a problem with convection, which is not its own adjoint.
    """
    if callable(problem.convection) or np.any(problem.convection):
        raise OptionError("goal requires a problem without convection, whose matrix is symmetric")
    return replace(
        problem,
        source=goal,
        dirichlet=dict.fromkeys(problem.dirichlet, 0.0),
        neumann=dict.fromkeys(problem.neumann, 0.0),
        robin={tag: (alpha, 0.0) for tag, (alpha, _) in problem.robin.items()},
        exact=None,
    )
