"""Training of the 3-D network, a few minutes on one core, on meshes generated from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from agglo_core.authoring import Float, Int, SweepBisection
from agglo_gnn.plane.fast import FastGNN
from agglo_gnn.space.network import initial_spatial, spatial_network
from agglo_gnn.space.pieces import SpatialPieces, gather_solids, solid_graphs, tensors_of
from agglo_gnn.training.cut_costs import measure_costs
from agglo_gnn.training.loop import BALANCE, COMPACT, GROWTH, PieceTask, Progress, train_on_pieces

if TYPE_CHECKING:
    import torch

_INERTIA = 3.0  # inertia of every piece in its frame
_SEED = 30_000  # for the validation pieces
_LARGE = 100  # minimum cells of the pieces with means of their own, the metrics with the suffix _100


def train_solids(
    seed: int = 0,
    steps: int = 6000,
    pieces: int = 10_000,
    validation: int = 4000,
    progress: Progress | None = None,
) -> tuple[dict[str, Float], dict[str, float]]:
    """Train the 3-D network from ``seed`` on one thread, reproducibly on each computer.

    Parameters
    ----------
    steps : int
        Training steps, with 64 pieces each.
    pieces, validation : int
        Piece counts for training and for validation.
    progress : callable, optional
        Called every 100 steps with the step, its loss and the CPU seconds so far.

    Returns
    -------
    parameters : dict of arrays
        With the shapes :data:`agglo_gnn.space.network.SPATIAL_SHAPES`.
    metrics : dict
        Mean cut cost over the cost of 2-means, on separate pieces: ``ratio`` for the bisector, ``initial``
        for the untrained bisector, ``axes`` for sweeps along seven directions; ``_100`` for pieces with 100
        cells or more.

    Raises
    ------
    PluginError
        If torch is not installed.
    OptionError
        If a number is out of range.
    """
    task = PieceTask(initial_spatial, _pieces, _loss, _validate)
    return train_on_pieces(task, seed, steps, pieces, validation, progress)


def _pieces(rng: np.random.Generator, count: int) -> SpatialPieces:
    return gather_solids(list(solid_graphs(rng, count)))


def _loss(
    values: dict[str, torch.Tensor], data: SpatialPieces, piece_ids: Int, sharpness: float
) -> torch.Tensor:
    """Return the expected cost of random cuts with the predicted probabilities, averaged over pieces.

    The cost is cut · ∛A (1/A₁ + 1/A₂) − max(15, 4 √n) B/T + 6 ((A₁ − A₂)/A)². For each piece it is averaged
    over its three directions, weighted by the softmax of their scores. Along each direction, p = sigmoid(T
    z / std) with T = clip(t ∛n, 2, 20).
    """
    import torch

    # 1. Scores and directions
    batch = tensors_of(data, piece_ids)
    owner, share, sizes = batch["cell_owner"], batch["shares"][:, None], batch["sizes"]
    scores, directions = spatial_network(values, batch["even"], batch["odd"], batch["frames"])
    # 2. Probability of side 1
    z = (directions[owner] @ batch["cells"][:, :, None])[:, :, 0]  # zero mean: cells are centred
    zero = z.new_zeros(len(sizes), 3)
    std = zero.index_add(0, owner, share * z * z).clamp(min=1e-12).sqrt()
    steep = (sharpness * sizes ** (1 / 3)).clamp(2.0, 20.0)
    p = torch.sigmoid(steep[owner][:, None] * z / std[owner])
    # 3. Expected volumes, cut and moments
    volume1 = zero.index_add(0, owner, share * p)
    a, b = p[batch["ends"][:, 0]], p[batch["ends"][:, 1]]
    cut = zero.index_add(0, batch["edge_owner"], batch["areas"][:, None] * (a + b - 2 * a * b))
    square = zero
    for k in range(3):
        moment = zero.index_add(0, owner, share * p * batch["cells"][:, k : k + 1])
        square = square + moment.square()
    # 4. Cost
    weight = (GROWTH * sizes.sqrt()).clamp(min=COMPACT)[:, None]
    cost = (cut - weight / _INERTIA * square) / (volume1 * (1 - volume1)) + BALANCE * (2 * volume1 - 1) ** 2
    return (torch.softmax(scores, 1) * cost).sum(1).mean()


def _validate(parameters: Mapping[str, Float], initial: Mapping[str, Float], count: int) -> dict[str, float]:
    """Return ratios of cut costs to the costs of 2-means, on pieces not used in training."""
    rivals = {
        "ratio": FastGNN(parameters).bisect_level,
        "initial": FastGNN(initial).bisect_level,
        "axes": SweepBisection().bisect_level,
    }
    costs = measure_costs(solid_graphs(np.random.default_rng(_SEED), count), rivals)
    return costs.mean_ratios(_LARGE)
