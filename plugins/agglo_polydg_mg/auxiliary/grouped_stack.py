"""The recipe with a continuous space where single cells are too little to smooth with: several at once.

The unknowns of each cell are scaled so that its diagonal block is the identity: in single precision the
blocks of flat cells would otherwise keep no digit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import Float, Int, System, frozen_float, multigrid
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack
from agglo_polydg_mg.auxiliary.strong_faces import strong_pairs
from agglo_polydg_mg.space.basis import Basis

_SMALL = 0.25
"""Levels whose matrix has at most this part of the entries of the one above are visited twice under patches,
which leave so little that a single visit is what iterations wait for."""
_SMALL_GIVEN = 0.7
"""The same where agglomerates are given, which leave more than classical levels do."""


def grouped_stack(
    system: System,
    basis: Basis,
    sigma: Float,
    kappa: Float,
    *,
    labels: Sequence[Int] | None = None,
    bubbles: bool = True,
    vertices: Literal["aggregates", "classical"] = "aggregates",
    layers: bool = False,
    dtype: Any = np.float32,
    overlap: bool = False,
) -> multigrid.LevelStack:
    """Levels of :func:`~agglo_polydg_mg.auxiliary.conforming_stack.conforming_stack`, the first smoothed by
    groups.

    Parameters are the same, but for ``overlap``: by default groups are up to eight cells that
    :func:`~agglo_polydg_mg.auxiliary.strong_faces.strong_pairs` join, if True the vertex patches, which
    take half the iterations and several times the time and memory of a sweep.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite on a cell or a group.
    """
    scaled = multigrid.block_scaled(system.A)
    mesh = basis.mesh
    if overlap:
        groups = multigrid.vertex_patches(mesh)
    else:
        groups = multigrid.joined_patches(strong_pairs(mesh, sigma), mesh.n_cells)
    smoother = multigrid.VertexPatches(scaled.A, groups, dtype)
    stack = conforming_stack(
        system,
        basis,
        sigma,
        kappa,
        labels=labels,
        smoother=lambda *_: smoother,
        scale=frozen_float(scaled.LT.data),
        bubbles=bubbles,
        vertices=vertices,
        layers=layers,
        dtype=dtype,
    )
    first, *below = stack.levels
    top = replace(first, A=smoother.A, patches=groups)
    if overlap:
        small = _SMALL if labels is None else _SMALL_GIVEN
        above = [system.A, *(level.A for level in below)]
        below = [
            replace(level, visits=2 if level.A.nnz <= small * A.nnz else 1)
            for level, A in zip(below, above, strict=False)
        ]
    return replace(stack, levels=[top, *below], scaling=scaled.T)
