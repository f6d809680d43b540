"""Training of the 2-D network, a minute on one core, on meshes generated from a seed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from agglo_core.authoring import Float, Int
from agglo_gnn.plane.data import Pieces, batch_of, gather
from agglo_gnn.plane.network import initial_parameters, network
from agglo_gnn.plane.validation import validate
from agglo_gnn.training.loop import BALANCE, COMPACT, GROWTH, PieceTask, Progress, train_on_pieces
from agglo_gnn.training.pieces import piece_graphs

if TYPE_CHECKING:
    import torch

_INERTIA = 2.0 / 3.0  # inertia of every piece in its frame


def train_fast(
    seed: int = 0,
    steps: int = 6000,
    pieces: int = 16_000,
    validation: int = 18_000,
    progress: Progress | None = None,
) -> tuple[dict[str, Float], dict[str, float]]:
    """Train the 2-D network from ``seed`` on one thread, reproducibly on each computer.

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
        With the shapes :data:`agglo_gnn.plane.fast.SHAPES`.
    metrics : dict
        Mean cut cost over the cost of 2-means, on separate pieces: ``ratio`` for the bisector, ``network``
        for the network alone, ``initial`` for the untrained network, ``axes`` for sweeps along eight axes;
        with ``_32`` on pieces with at least 32 cells. ``of_means`` is the bisector's mean cost over the
        mean cost of 2-means.

    Raises
    ------
    PluginError
        If torch is not installed.
    OptionError
        If a number is out of range.
    """
    task = PieceTask(initial_parameters, _pieces, _loss, validate)
    return train_on_pieces(task, seed, steps, pieces, validation, progress)


def _pieces(rng: np.random.Generator, count: int) -> Pieces:
    return gather(list(piece_graphs(rng, count)))


def _loss(values: dict[str, torch.Tensor], data: Pieces, piece_ids: Int, sharpness: float) -> torch.Tensor:
    """Return the expected cost of random cuts with the predicted probabilities, averaged over pieces.

    The cost is cut · √A (1/A₁ + 1/A₂) − max(15, 4 √n) B/T + 6 ((A₁ − A₂)/A)². The probability is
    p = sigmoid(T (z − mean) / std) with T = clip(t √n, 2, 20): standardised per piece, the logits cannot
    collapse to one side.
    """
    import torch

    # 1. Logits, and probability of side 1
    batch = batch_of(data, piece_ids)
    owner, share, count = batch["cell_owner"], batch["shares"], len(batch["blocks"])
    c = network(values, batch["nodes"], batch["near"], batch["areas"], batch["node_owner"], batch["blocks"])
    z = (c[owner] * batch["cells"]).sum(1)  # zero mean: cells are centred
    zero = z.new_zeros(count)
    std = zero.index_add(0, owner, share * z * z).clamp(min=1e-12).sqrt()
    p = torch.sigmoid((sharpness * batch["root"]).clamp(2.0, 20.0)[owner] * z / std[owner])
    # 2. Expected areas, cut and moments
    area1 = zero.index_add(0, owner, share * p)
    a, b = p[batch["ends"][:, 0]], p[batch["ends"][:, 1]]
    cut = zero.index_add(0, batch["edge_owner"], batch["lengths"] * (a + b - 2 * a * b))
    moment = batch["cells"].new_zeros(count, 2).index_add(0, owner, (share * p)[:, None] * batch["cells"])
    # 3. Cost
    weight = (GROWTH * batch["root"]).clamp(min=COMPACT)
    cost = (cut - weight / _INERTIA * moment.square().sum(1)) / (area1 * (1 - area1))
    return (cost + BALANCE * (2 * area1 - 1) ** 2).mean()
