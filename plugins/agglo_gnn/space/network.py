"""The 3-D network: parameters, inputs, and evaluation in torch for training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.authoring import Float

if TYPE_CHECKING:
    import torch

SPATIAL_SHAPES: Mapping[str, tuple[int, ...]] = {
    "dense1.weight": (16, 24), "dense1.bias": (24,), "dense2.weight": (24, 11), "dense2.bias": (11,),
}  # fmt: skip
"""Parameter shapes in the order of the forward pass: 683 numbers."""

SPATIAL_FEATURES = (
    *("ii", "jj", "kk", "iiii / 3", "jjjj / 3", "kkkk / 3", "iijj", "iikk", "jjkk"),
    *("iii²", "iii ijj", "iii ikk", "jjj²", "iij²", "iik²", "3 / ∛n"),
    *("tilt ij", "tilt iiij", "tilt ijjj", "tilt ijkk", "tilt iii iij", "tilt ijj iij", "tilt ijj jjj"),
    *("tilt iii jjj", "tilt ikk jkk", "tilt ijk kkk"),
)
"""Moments along axis i, the tilt axis j, and the third axis k: 16 for the score, 10 for the tilt."""


def initial_spatial(seed: int) -> dict[str, Float]:
    """Return random initial weights (He) with output 0, so that cuts are across the longest axis."""
    rng = np.random.default_rng([seed, 1])
    values: dict[str, Float] = {name: np.zeros(shape) for name, shape in SPATIAL_SHAPES.items()}
    values["dense1.weight"] = np.sqrt(2.0 / 16) * rng.standard_normal((16, 24))
    return values


def spatial_network(
    parameters: Mapping[str, torch.Tensor], even: torch.Tensor, odd: torch.Tensor, frames: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return scores ``(B, 3)`` and tilted directions ``(B, 3, 3)`` of each piece's principal axes.

    ``even (B, 6, 16)``, ``odd (B, 6, 10)`` and ``frames (B, 3, 3)`` come from ``describe_solids``. One
    network serves every pair of axes, so that axis order and signs have no influence.
    """
    import torch

    from agglo_gnn.space.kernels import PRIOR

    hidden = torch.relu(even @ parameters["dense1.weight"] + parameters["dense1.bias"])
    out = hidden @ parameters["dense2.weight"] + parameters["dense2.bias"]
    scores = PRIOR * even[:, ::2, 0] + out[:, ::2, 0] + out[:, 1::2, 0]
    tilts = (out[:, :, 1:] * odd).sum(2)
    towards = frames[:, [1, 2, 2, 0, 0, 1]] * tilts[:, :, None]
    return scores, frames + towards[:, ::2] + towards[:, 1::2]
