"""Matrix parts for κ = 1, reused for coefficients that are constant in each cell and only scale them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from agglo_core.authoring import Float, frozen_float
from agglo_core.fields.gauss_points import gauss
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.space.basis import Basis, stiffness

NORMALS: Final = frozen_float(np.zeros((0, 2, 1, 2)))
"""Directions of kernels for scalar coefficients: fluxes along the normals of faces."""
_MOST: Final = 2**31
"""Memory limit in bytes; a basis needs about twice the matrix size, 2.5 kB per triangle with p = 2."""


@dataclass(frozen=True, eq=False)
class UnitForms:
    """Matrix parts of a basis that do not depend on κ, if κ is constant in each cell.

    For a face, κ scales its block by the harmonic mean of both sides, and the required penalty by κ of the
    other side over the sum; for a cell, κ scales its stiffness. The parts are computed on first use, unless
    the basis is so large that they do not ``fit``.
    """

    basis: Basis

    @property
    def fit(self) -> bool:
        """True in 2-D if all parts together take 2 GiB or less."""
        if self.basis.mesh.dim != 2:
            return False
        m, mesh = self.basis.n_local, self.basis.mesh
        numbers = mesh.n_faces * 2 * m * (2 * m + 1) + mesh.n_cells * m * m
        return 8 * (numbers + len(mesh.cell_faces[1]) * ((m - 1) * m // 2 + 1)) <= _MOST

    @cached_property
    def stiffness(self) -> Float:
        """The :func:`~agglo_polydg_mg.space.basis.stiffness` ``(n_cells, m, m)`` for κ = 1."""
        return frozen_float(stiffness(self.basis, 1.0))

    @cached_property
    def faces(self) -> Float:
        """Bilinear forms of faces for κ = 1 ``(n_faces, 2, m (2 m + 1))``.

        See ``unit_faces`` in ``face_kernels``.
        """
        from agglo_polydg_mg.forms.face_kernels import unit_faces

        basis, mesh = self.basis, self.basis.mesh
        units = np.zeros((mesh.n_faces, 2, basis.n_local * (2 * basis.n_local + 1)))
        of_faces = mesh.local_points, mesh.face_pairs, mesh.face_cells
        form_data = mesh.face_measures, basis.boxes, basis.scale, *gauss(basis.degree + 1), basis.degree

        def write(start: int, stop: int) -> None:
            unit_faces(*of_faces, start, *form_data, units[start:stop])

        over_ranges(write, mesh.n_faces, few=COSTLY)
        return frozen_float(units)

    @cached_property
    def _whitened(self) -> tuple[Float, np.ndarray]:
        """Normal derivative forms for κ = 1, and a mask of cells that are not too thin ``(n_cells,)``.

        See ``whitened_forms`` in ``trace_kernels``.
        """
        from agglo_polydg_mg.forms.trace_kernels import whitened_forms

        basis, mesh, m = self.basis, self.basis.mesh, self.basis.n_local
        points, (offsets, faces), sides = (
            mesh.local_points,
            mesh.cell_faces,
            (mesh.face_pairs, mesh.face_cells),
        )
        # 1. Workspace, and a coefficient with c = κ = 1
        forms = np.zeros((len(faces), (m - 1) * m // 2 + 1))
        of_cells, rule = (basis.boxes, basis.scale, basis.fill, self.stiffness), gauss(basis.degree)
        penalised, ones = np.ones(mesh.n_faces, bool), np.where(mesh.face_cells[:, 1] < 0, 1.0, 4.0)
        # κ that gives ωκ/2 = 1, and no directions other than normals
        on_faces = frozen_float(np.stack((ones, ones), axis=1)[:, :, None]), NORMALS

        # 2. Forms, cell range by cell range
        def write(start: int, stop: int) -> np.ndarray:
            cell_data = [a[start:stop] for a in of_cells]
            shape = points, offsets[start : stop + 1], faces, *sides, start
            return np.asarray(
                whitened_forms(*shape, penalised, *cell_data, *on_faces, *rule, basis.degree, forms)
            )

        resolved = np.concatenate(over_ranges(write, mesh.n_cells, few=COSTLY))
        return frozen_float(forms), resolved

    def requirements(self, kappa: Float, held: np.ndarray) -> tuple[Float, np.ndarray]:
        """Return the penalties that cells require on penalised faces for κ ``(n_cells,)``, and a cell mask.

        The mask is True for cells that are not too thin for the eigenvalue problem. The shapes are
        ``(n_faces, 2)`` and ``(n_cells,)``; see ``side_penalties`` in ``trace_kernels``.
        """
        from agglo_polydg_mg.forms.trace_kernels import scaled_penalties

        mesh, (forms, resolved), values = self.basis.mesh, self._whitened, frozen_float(kappa)
        (offsets, faces), requirements = mesh.cell_faces, np.zeros((mesh.n_faces, 2))

        def ask(start: int, stop: int) -> None:
            geometry = offsets[start : stop + 1], faces, mesh.face_cells, start, held, mesh.face_measures
            scaled_penalties(*geometry, values, forms, resolved, self.basis.degree, requirements)

        over_ranges(ask, mesh.n_cells, few=COSTLY)
        return requirements, resolved
