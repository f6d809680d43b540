"""Training of the model in space: a few minutes on one core, from a seed and no files."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.authoring import Float, Int, OptionError, PluginError
from agglo_gnn.space.network import initial_spatial, spatial_network
from agglo_gnn.space.pieces import SpatialPieces, gather_solids, solid_graphs, tensors_of

if TYPE_CHECKING:
    import torch

_BATCH = 64
_RATE = 2e-3
_WARM_UP = 0.03
_BALANCE = 6.0
_COMPACT, _GROWTH = 15.0, 4.0  # as in the sweep
_INERTIA = 3.0  # of every piece in its frame
_SIZE_POWER = 0.35
_SEED = 30_000  # of the pieces of the validation
Progress = Callable[[int, float, float], None]


def train_solids(
    seed: int = 0,
    steps: int = 6000,
    pieces: int = 10_000,
    validation: int = 4000,
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
        As in :data:`agglo_gnn.space.network.SPATIAL_SHAPES`.
    metrics : dict
        Mean cost of a cut over that of 2-means, on pieces used for nothing else: ``ratio`` of the bisector,
        ``initial`` of it untrained, ``axes`` of sweeps along seven directions; ``_100`` for pieces of 100
        cells or more.

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

    start = time.process_time()
    with one_thread():
        data = gather_solids(list(solid_graphs(np.random.default_rng([seed, 2]), pieces)))
        initial = initial_spatial(seed)
        values = {k: torch.tensor(v, dtype=torch.float32, requires_grad=True) for k, v in initial.items()}
        _fit(values, data, np.random.default_rng([seed, 3]), steps, start, progress)
        parameters = {key: value.detach().numpy().copy() for key, value in values.items()}
        return parameters, _validate(parameters, initial, validation)


def _fit(
    values: Any,
    data: SpatialPieces,
    rng: np.random.Generator,
    steps: int,
    start: float,
    progress: Progress | None,
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
        chosen: Int = np.minimum(np.searchsorted(edges, rng.random(_BATCH)), len(weight) - 1)
        loss = _loss(values, tensors_of(data, chosen), 0.4 + 0.8 * share)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(values.values(), 1.0)
        optimiser.step()
        if progress is not None and (step + 1) % 100 == 0:
            progress(step + 1, float(loss.detach()), time.process_time() - start)


def _loss(values: Any, batch: dict[str, torch.Tensor], sharpness: float) -> torch.Tensor:
    """Expected cut · ∛A (1/A₁ + 1/A₂) − max(15, 4 √n) B/T + 6 ((A₁ − A₂)/A)², mean over the pieces.

    Of each piece, the mean over its three directions, weighted by the softmax of their scores. Along each,
    p = sigmoid(T z / std) with T = clip(t ∛n, 2, 20).
    """
    import torch

    owner, share, sizes = batch["cell_owner"], batch["shares"][:, None], batch["sizes"]
    scores, found = spatial_network(values, batch["even"], batch["odd"], batch["frames"])
    z = (found[owner] @ batch["cells"][:, :, None])[:, :, 0]  # of mean 0: cells are centred
    zero = z.new_zeros(len(sizes), 3)
    spread = zero.index_add(0, owner, share * z * z).clamp(min=1e-12).sqrt()
    steep = (sharpness * sizes ** (1 / 3)).clamp(2.0, 20.0)
    p = torch.sigmoid(steep[owner][:, None] * z / spread[owner])
    one = zero.index_add(0, owner, share * p)
    a, b = p[batch["ends"][:, 0]], p[batch["ends"][:, 1]]
    cut = zero.index_add(0, batch["edge_owner"], batch["areas"][:, None] * (a + b - 2 * a * b))
    square = zero
    for k in range(3):
        moment = zero.index_add(0, owner, share * p * batch["cells"][:, k : k + 1])
        square = square + moment.square()
    weight = (_GROWTH * sizes.sqrt()).clamp(min=_COMPACT)[:, None]
    cost = (cut - weight / _INERTIA * square) / (one * (1 - one)) + _BALANCE * (2 * one - 1) ** 2
    return (torch.softmax(scores, 1) * cost).sum(1).mean()


def _validate(parameters: Mapping[str, Float], initial: Mapping[str, Float], count: int) -> dict[str, float]:
    from agglo_core.authoring import SweepBisection, default
    from agglo_gnn.plane.fast import FastGNN
    from agglo_gnn.plane.validation import cut_costs

    rivals = {
        "ratio": FastGNN(parameters),
        "initial": FastGNN(initial),
        "axes": SweepBisection(),
        "base": default().build("bisector", "kmeans"),
    }
    costs: dict[str, list[Float]] = {key: [] for key in rivals}
    sizes = []
    for level in solid_graphs(np.random.default_rng(_SEED), count):
        seeds = np.zeros(level.n_blocks, np.uint64)
        sizes.append(level.sizes)
        for key, rival in rivals.items():
            costs[key].append(cut_costs(level, np.asarray(rival.bisect_level(level, seeds))))
    joined = {key: np.concatenate(values) for key, values in costs.items()}
    base, large = joined.pop("base"), np.concatenate(sizes) >= 100
    ratios = {key: values / base for key, values in joined.items()}
    return {key: float(values.mean()) for key, values in ratios.items()} | {
        f"{key}_100": float(values[large].mean()) for key, values in ratios.items()
    }
