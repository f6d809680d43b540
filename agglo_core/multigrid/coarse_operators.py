"""Coarse operators: the matrices of coarse levels."""

from __future__ import annotations

from typing import Any

from agglo_core.errors import OptionError
from agglo_core.multigrid.matrices.galerkin import galerkin
from agglo_core.problems import Coarsening


class Galerkin:
    """Galerkin operator Pᵀ A P, with coarse corrections that are optimal in the energy norm."""

    def coarse_matrix(self, step: Coarsening, P: Any) -> Any:
        """Return the coarse matrix Pᵀ A P ``(m, m)``."""
        return galerkin(step.A, P)


class Rediscretised:
    """Matrix of the problem discretised on the agglomerates, with penalties computed from their sizes."""

    def coarse_matrix(self, step: Coarsening, P: Any) -> Any:
        """Return the matrix ``(m, m)`` of the problem discretised on the agglomerates.

        Raises
        ------
        OptionError
            Without a discretisation, as for linear systems, or if P maps to other unknowns.
        MeshError
            For self-overlapping agglomerates.
        """
        if step.rediscretised is None:
            raise OptionError(
                "coarse_operator=rediscretised requires a problem that the solver discretises; for a "
                "linear system, which is only a matrix, use coarse_operator=galerkin"
            )
        matrix = step.rediscretised()
        if matrix.shape[0] != P.shape[1]:
            raise OptionError(
                f"coarse_operator=rediscretised has {matrix.shape[0]} unknowns on the coarse level, but "
                f"the transfer has {P.shape[1]}: use coarse_operator=galerkin, or transfer=injection"
            )
        return matrix
