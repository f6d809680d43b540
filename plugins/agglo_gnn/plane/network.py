"""The 2-D network in torch, for training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.authoring import Float
from agglo_gnn.plane.fast import SHAPES

if TYPE_CHECKING:
    import torch


def initial_parameters(seed: int) -> dict[str, Float]:
    """Return random initial weights (He) for which the network cuts across the principal axis."""
    rng = np.random.default_rng([seed, 1])
    values = {}
    for name, shape in SHAPES.items():
        scale = 0.0 if len(shape) == 1 or name == "dense3.weight" else np.sqrt(2.0 / shape[0])
        values[name] = scale * rng.standard_normal(shape)
    values["dense3.bias"] = np.array([1.0, 0.0])
    return values


def network(
    parameters: Mapping[str, torch.Tensor],
    nodes: torch.Tensor,
    near: torch.Tensor,
    areas: torch.Tensor,
    owner: torch.Tensor,
    blocks: torch.Tensor,
) -> torch.Tensor:
    """Evaluate the network on a batch: coefficients (c₁, c₂) of each block's cut function ``(B, 2)``.

    SAGE 4 → 16 → 16 (ReLU, mean), pooling by area, MLP to 48, 48, 2. ``near`` numbers all bins in the
    batch, −1 for none; ``owner (N,)`` is each bin's block.
    """
    import torch

    # 1. SAGE layers on the bins
    present = (near >= 0).to(nodes.dtype)
    degree = present.sum(1, keepdim=True).clamp(min=1)
    rows = near.clamp(min=0)
    node_values = nodes
    for layer in ("sage1", "sage2"):
        mean = (node_values[rows] * present[:, :, None]).sum(1) / degree
        mixed = node_values @ parameters[f"{layer}.own"] + mean @ parameters[f"{layer}.near"]
        node_values = torch.relu(mixed + parameters[f"{layer}.bias"])
    # 2. Pooling by area, and the MLP
    pooled = node_values.new_zeros(len(blocks), node_values.shape[1]).index_add(
        0, owner, areas[:, None] * node_values
    )
    block_values = torch.cat((pooled, blocks), 1)
    for layer in ("dense1", "dense2"):
        block_values = torch.relu(block_values @ parameters[f"{layer}.weight"] + parameters[f"{layer}.bias"])
    return block_values @ parameters["dense3.weight"] + parameters["dense3.bias"]
