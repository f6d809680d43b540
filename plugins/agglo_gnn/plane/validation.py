"""Comparison of the trained 2-D network's cuts with 2-means and with cuts without a network."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agglo_core.authoring import Float, Graph, SweepBisection
from agglo_core.graph.sweep import sweep
from agglo_gnn.plane.data import batch_of, gather
from agglo_gnn.plane.fast import FastGNN
from agglo_gnn.plane.network import network
from agglo_gnn.training.cut_costs import Rival, measure_costs
from agglo_gnn.training.pieces import piece_graphs

_SEED = 20_000  # for the validation pieces
_LARGE = 32  # minimum cells of the pieces with means of their own, the metrics with the suffix _32


def validate(parameters: Mapping[str, Float], initial: Mapping[str, Float], count: int) -> dict[str, float]:
    """Return ratios of cut costs to the costs of 2-means, on pieces not used in training.

    The values are mean ratios, over all pieces and over pieces with 32 cells or more. ``of_means`` is the
    ratio of the mean costs instead, which gives more weight to pieces that are hard to cut.
    """
    rivals: dict[str, Rival] = {
        "ratio": FastGNN(parameters).bisect_level,
        "axes": SweepBisection().bisect_level,
        "network": lambda level, seeds: sweep(level, _scores(level, parameters)),
        "initial": lambda level, seeds: sweep(level, _scores(level, initial)),
    }
    costs = measure_costs(piece_graphs(np.random.default_rng(_SEED), count), rivals)
    of_means = float(costs.of["ratio"].mean() / costs.base.mean())
    return costs.mean_ratios(_LARGE) | {"of_means": of_means}


def _scores(level: Graph, parameters: Mapping[str, Float]) -> Float:
    """Return the torch network's cut function c₁ u + c₂ v at every node."""
    import torch

    batch = batch_of(gather([level]), np.arange(level.n_blocks))
    values = {key: torch.from_numpy(np.asarray(value, np.float32)) for key, value in parameters.items()}
    with torch.no_grad():
        c = network(
            values, batch["nodes"], batch["near"], batch["areas"], batch["node_owner"], batch["blocks"]
        )
    return np.asarray((c[batch["cell_owner"]] * batch["cells"]).sum(1).numpy(), dtype=float)
