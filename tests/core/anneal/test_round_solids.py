"""Annealing in space: a cube of cubes falls into cubes, whatever the effort and the target."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import samples

BLOCKS = np.add.outer(16 * (np.arange(8) // 2), np.add.outer(4 * (np.arange(8) // 2), np.arange(8) // 2))
"""The 64 cubes of 2 × 2 × 2 cells, cell by cell."""
TARGETS: list[dict[str, Any]] = [{"n_parts": 64}, {"h_star": 3**0.5 / 4}]


@pytest.mark.parametrize("target", TARGETS, ids=["count", "size"])
@pytest.mark.parametrize("objective", ["solver", "roundness"])
@pytest.mark.parametrize("effort", ["fast", "good"])
def test_hexahedra_are_annealed_to_exact_cubes(effort: str, objective: str, target: dict[str, Any]) -> None:
    chosen = ("kmeans", {"effort": effort, "objective": objective})
    mesh, ways = samples.boxes(8), {"bisector": chosen, "method": "kway"}
    labels = agglo.agglomerate(mesh, seed=1, **ways, **target).levels[0]
    assert np.unique(np.stack([labels, BLOCKS.ravel()]), axis=1).shape[1] == labels.max() + 1 == 64
    np.testing.assert_allclose(mesh.coarsen(labels).cell_diameters, 3**0.5 / 4)


@pytest.mark.parametrize("target", TARGETS, ids=["count", "size"])
def test_the_refiner_keeps_cubes(target: dict[str, Any]) -> None:
    mesh = samples.boxes(8)
    for bisector in ("coordinate", "kmeans", "sweep"):
        ways = {
            "bisector": bisector,
            "post_refiners": ("compactness", ("anneal", {"objective": "roundness"})),
        }
        labels = agglo.agglomerate(mesh, **ways, **target).levels[0]
        assert np.unique(np.stack([labels, BLOCKS.ravel()]), axis=1).shape[1] == labels.max() + 1 == 64
