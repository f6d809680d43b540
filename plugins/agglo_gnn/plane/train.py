"""Training of the fast model: a minute on one core, from a seed and no files."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.authoring import Float, OptionError, PluginError
from agglo_gnn.plane.data import Pieces, batch_of, gather
from agglo_gnn.plane.network import initial_parameters, network
from agglo_gnn.training.pieces import piece_graphs

if TYPE_CHECKING:
    import torch

_BATCH = 64
_RATE = 2e-3
_WARM_UP = 0.03
_BALANCE = 6.0
_COMPACT, _GROWTH = 15.0, 4.0  # as in the sweep
_INERTIA = 2.0 / 3.0  # of every piece in its frame
_SIZE_POWER = 0.35
Progress = Callable[[int, float, float], None]


def train_fast(
    seed: int = 0,
    steps: int = 6000,
    pieces: int = 16_000,
    validation: int = 18_000,
    progress: Progress | None = None,
) -> tuple[dict[str, Float], dict[str, float]]:
    """Train from ``seed`` on one thread; the same seed gives the same weights on the same machine.

    Parameters
    ----------
    steps : int
        Of 64 pieces each.
    pieces, validation : int
        Pieces to make for training, and to measure the result on.
    progress : callable, optional
        Called every 100 steps with the step, its loss and the CPU seconds so far.

    Returns
    -------
    parameters : dict of arrays
        As in :data:`agglo_gnn.plane.fast.SHAPES`.
    metrics : dict
        Mean cost of a cut over that of 2-means, on pieces used for nothing else: ``ratio`` of the
        bisector, ``network`` of the network alone, ``initial`` of it untrained, ``axes`` of sweeps along
        eight axes; with ``_32`` on those of at least 32 cells. ``of_means`` is the bisector's mean cost
        over the mean cost of 2-means.

    Raises
    ------
    PluginError
        If torch is not installed.
    OptionError
        If a number makes no sense.
    """
    if min(steps, pieces, validation) < 1 or seed < 0:
        raise OptionError(
            "steps, pieces and validation must be 1 or more, seed 0 or more; "
            f"given {steps}, {pieces}, {validation}, {seed}"
        )
    try:
        import torch
    except ImportError as error:
        raise PluginError(f"training needs torch: pip install 'agglo[train]' ({error})") from error
    from agglo_gnn.paper.epochs import one_thread
    from agglo_gnn.plane.validation import validate

    start = time.process_time()
    with one_thread():
        data = gather(list(piece_graphs(np.random.default_rng([seed, 2]), pieces)))
        values = {
            k: torch.tensor(v, dtype=torch.float32, requires_grad=True)
            for k, v in initial_parameters(seed).items()
        }
        _fit(values, data, np.random.default_rng([seed, 3]), steps, start, progress)
        parameters = {key: value.detach().numpy().copy() for key, value in values.items()}
        return parameters, validate(parameters, initial_parameters(seed), validation)


def _fit(
    values: Any, data: Pieces, rng: np.random.Generator, steps: int, start: float, progress: Progress | None
) -> None:
    import torch

    optimiser = torch.optim.Adam(values.values(), lr=_RATE)
    weight = data.sizes**_SIZE_POWER
    edges = np.cumsum(weight / weight.sum())
    warm = max(1, round(_WARM_UP * steps))
    for step in range(steps):
        share = step / steps
        for group in optimiser.param_groups:
            group["lr"] = _RATE * min((step + 1) / warm, 0.5 * (1 + np.cos(np.pi * share)))
        chosen = np.minimum(np.searchsorted(edges, rng.random(_BATCH)), len(weight) - 1)
        loss = _loss(values, batch_of(data, chosen), 0.4 + 0.8 * share)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(values.values(), 1.0)
        optimiser.step()
        if progress is not None and (step + 1) % 100 == 0:
            progress(step + 1, float(loss.detach()), time.process_time() - start)


def _loss(values: Any, batch: dict[str, torch.Tensor], sharpness: float) -> torch.Tensor:
    """Expected cut · √A (1/A₁ + 1/A₂) − max(15, 4 √n) B/T + 6 ((A₁ − A₂)/A)², mean over the pieces.

    p = sigmoid(T (z − mean) / std) with T = clip(t √n, 2, 20): standardised per piece, the logits
    cannot collapse to one side.
    """
    import torch

    owner, share, count = batch["cell_owner"], batch["shares"], len(batch["blocks"])
    c = network(values, batch["nodes"], batch["near"], batch["areas"], batch["node_owner"], batch["blocks"])
    z = (c[owner] * batch["cells"]).sum(1)  # of mean 0: cells are centred
    zero = z.new_zeros(count)
    spread = zero.index_add(0, owner, share * z * z).clamp(min=1e-12).sqrt()
    p = torch.sigmoid((sharpness * batch["root"]).clamp(2.0, 20.0)[owner] * z / spread[owner])
    one = zero.index_add(0, owner, share * p)
    a, b = p[batch["ends"][:, 0]], p[batch["ends"][:, 1]]
    cut = zero.index_add(0, batch["edge_owner"], batch["lengths"] * (a + b - 2 * a * b))
    moment = batch["cells"].new_zeros(count, 2).index_add(0, owner, (share * p)[:, None] * batch["cells"])
    weight = (_GROWTH * batch["root"]).clamp(min=_COMPACT)
    cost = (cut - weight / _INERTIA * moment.square().sum(1)) / (one * (1 - one))
    return (cost + _BALANCE * (2 * one - 1) ** 2).mean()
