"""Build multigrid levels with a continuous space, smoothed by cell groups instead of single cells.

Each cell's unknowns are scaled so that its diagonal block is the identity: otherwise single precision
would lose all digits in the blocks of flat cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import Float, Int, System, frozen_float, multigrid
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack
from agglo_polydg_mg.auxiliary.strong_faces import columns, strong_pairs
from agglo_polydg_mg.space.basis import Basis

_SMALL = 0.25
"""Entries of a level's matrix over those of the level above, up to which the level is visited twice below
patches. Patches leave so little error that a single visit would limit convergence (benchmarks/solve.py
--meshes voronoi --degrees 3)."""
_SMALL_GIVEN = 0.7
"""Entry ratio for given agglomerates, which leave more error than classical levels (benchmarks/solve.py
--hierarchy kmeans --meshes voronoi --degrees 3)."""


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
    """Build the levels of ``conforming_stack``, but smooth the first by cell groups.

    Other parameters and the levels are documented in
    :func:`~agglo_polydg_mg.auxiliary.conforming_stack.conforming_stack`. By default groups are up to eight
    cells joined by :func:`~agglo_polydg_mg.auxiliary.strong_faces.strong_pairs`, in 3-D the
    :func:`~agglo_polydg_mg.auxiliary.strong_faces.columns` of flat cells. With ``overlap`` they are the
    vertex patches, which take half the iterations and several times the time and memory of a sweep.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite on a cell or a group.
    """
    # 1. Scale the cells, and choose the groups
    scaled = multigrid.block_scaled(system.A)
    mesh = basis.mesh
    if overlap:
        groups = multigrid.vertex_patches(mesh)
    elif mesh.dim == 3:
        groups, _ = columns(mesh)
    else:
        groups = multigrid.joined_patches(strong_pairs(mesh, sigma), mesh.n_cells)
    smoother = multigrid.VertexPatches(scaled.A, groups, dtype)
    # 2. Build the levels with the group smoother
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
    # 3. Below patches, visit small levels twice
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
