"""How well a trained fast model cuts, beside 2-means and beside sweeps without a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from agglo_core.authoring import Float, Graph, Int, UInt64, sweep
from agglo_gnn.plane.data import batch_of, gather
from agglo_gnn.plane.fast import FastGNN
from agglo_gnn.plane.network import network
from agglo_gnn.training.pieces import piece_graphs

_SEED = 20_000
Rival = Callable[[Graph, UInt64], Int]


def validate(parameters: Mapping[str, Float], initial: Mapping[str, Float], count: int) -> dict[str, float]:
    """Costs of cuts over those of 2-means, on pieces made for nothing else.

    Means of the ratios, of all pieces and of those of 32 cells or more; ``of_means`` is the ratio of the
    mean costs instead, in which the pieces that are hard to cut count for more.
    """
    from agglo_core.authoring import SweepBisection, default

    levels = list(piece_graphs(np.random.default_rng(_SEED), count))
    rivals: dict[str, Rival] = {
        "ratio": FastGNN(parameters).bisect_level,
        "axes": SweepBisection().bisect_level,
        "network": lambda level, seeds: sweep(level, _scores(level, parameters)),
        "initial": lambda level, seeds: sweep(level, _scores(level, initial)),
    }
    two_means: Rival = default().build("bisector", "kmeans").bisect_level
    costs: dict[str, list[Float]] = {key: [] for key in (*rivals, "base")}
    for level in levels:
        seeds = np.zeros(level.n_blocks, np.uint64)
        costs["base"].append(cut_costs(level, np.asarray(two_means(level, seeds))))
        for key, rival in rivals.items():
            costs[key].append(cut_costs(level, rival(level, seeds)))
    large = np.concatenate([level.sizes for level in levels]) >= 32
    joined = {key: np.concatenate(values) for key, values in costs.items()}
    base = joined.pop("base")
    ratios = {key: values / base for key, values in joined.items()}
    return (
        {key: float(values.mean()) for key, values in ratios.items()}
        | {f"{key}_32": float(values[large].mean()) for key, values in ratios.items()}
        | {"of_means": float(joined["ratio"].mean() / base.mean())}
    )


def _scores(level: Graph, parameters: Mapping[str, Float]) -> Float:
    """The logits of the torch network on every node."""
    import torch

    batch = batch_of(gather([level]), np.arange(level.n_blocks))
    values = {key: torch.from_numpy(np.asarray(value, np.float32)) for key, value in parameters.items()}
    with torch.no_grad():
        c = network(
            values, batch["nodes"], batch["near"], batch["areas"], batch["node_owner"], batch["blocks"]
        )
    return np.asarray((c[batch["cell_owner"]] * batch["cells"]).sum(1).numpy(), dtype=float)


def cut_costs(level: Graph, sides: Int) -> Float:
    """cut · √A (1/A₁ + 1/A₂) + 15 (1 − B/T) of each block; in space ∛A."""
    block, count = level.block_ids, level.n_blocks
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    crossing = sides[rows] != sides[level.indices]
    cut = 0.5 * np.bincount(block[rows], level.interface * crossing, minlength=count)
    part = 2 * block + sides
    area = np.bincount(part, level.measures, minlength=2 * count).reshape(-1, 2)
    moment = [
        np.bincount(part, level.measures * x, minlength=2 * count).reshape(-1, 2) for x in level.centroids.T
    ]
    total = area.sum(axis=1)
    inertia = np.bincount(block, level.measures * (level.centroids**2).sum(axis=1), minlength=count)
    mean = sum(m.sum(axis=1) ** 2 for m in moment) / total
    within = inertia - sum((m**2 / area).sum(axis=1) for m in moment)
    length = np.sqrt(total) if level.dim == 2 else np.cbrt(total)
    costs: Float = cut * length * (1 / area).sum(axis=1) + 15 * within / (inertia - mean)
    return costs
