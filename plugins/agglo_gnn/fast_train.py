"""Training of the fast model: a minute on one core, from a seed and no files."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Float, Int, UInt64
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.sweep import sweep
from agglo_gnn.fast import SHAPES
from agglo_gnn.features import see
from agglo_gnn.pieces import piece_levels

if TYPE_CHECKING:
    import torch

__all__ = ["initial_parameters", "network", "train_fast"]

_BATCH = 64
_RATE = 2e-3
_WARM_UP = 0.03
_BALANCE = 6.0
_COMPACT = 15.0
_INERTIA = 2.0 / 3.0  # of every piece in its frame
_SIZE_POWER = 0.35
_VALIDATION = 20_000
Progress = Callable[[int, float, float], None]
Rival = Callable[[Graph, UInt64], Int]


@dataclass(frozen=True)
class _Data:
    """Pieces in flat arrays; piece p owns rows ``offsets[p]:offsets[p + 1]`` of each kind."""

    cell_offsets: Int
    cells: Float
    shares: Float
    edge_offsets: Int
    ends: Int
    lengths: Float
    node_offsets: Int
    nodes: Float
    near: Int
    areas: Float
    blocks: Float

    @property
    def sizes(self) -> Int:
        return np.diff(self.cell_offsets)


def initial_parameters(seed: int) -> dict[str, Float]:
    """Random weights (He), except that the output is (1, 0) whatever comes in: inertial bisection."""
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
    """Coefficients (c₁, c₂) of each block ``(B, 2)``.

    SAGE 4 → 16 → 16 (ReLU, mean), pooling by area, MLP to 48, 48, 2. ``near`` numbers all bins of the
    batch, −1 for none; ``owner (N,)`` is the block of each bin.
    """
    import torch

    present = (near >= 0).to(nodes.dtype)
    degree = present.sum(1, keepdim=True).clamp(min=1)
    rows = near.clamp(min=0)
    hidden = nodes
    for layer in ("sage1", "sage2"):
        mean = (hidden[rows] * present[:, :, None]).sum(1) / degree
        mixed = hidden @ parameters[f"{layer}.own"] + mean @ parameters[f"{layer}.near"]
        hidden = torch.relu(mixed + parameters[f"{layer}.bias"])
    pooled = hidden.new_zeros(len(blocks), hidden.shape[1]).index_add(0, owner, areas[:, None] * hidden)
    out = torch.cat((pooled, blocks), 1)
    for layer in ("dense1", "dense2"):
        out = torch.relu(out @ parameters[f"{layer}.weight"] + parameters[f"{layer}.bias"])
    return out @ parameters["dense3.weight"] + parameters["dense3.bias"]


def train_fast(
    seed: int = 0,
    steps: int = 3000,
    pieces: int = 9000,
    validation: int = 6000,
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
        As in :data:`agglo_gnn.fast.SHAPES`.
    metrics : dict
        Mean cost of a cut over that of 2-means, on pieces used for nothing else: ``ratio`` of the
        bisector, ``network`` of the network alone, ``initial`` of it untrained, ``axes`` of sweeps along
        eight axes; with ``_32`` on those of at least 32 cells.

    Raises
    ------
    PluginError
        If torch is not installed.
    OptionError
        If a number makes no sense.
    """
    if min(steps, pieces, validation) < 1 or seed < 0:
        raise OptionError(
            f"steps, pieces and validation must be 1 or more, seed 0 or more; "
            f"given {steps}, {pieces}, {validation}, {seed}"
        )
    try:
        import torch
    except ImportError as error:
        raise PluginError(f"training needs torch: pip install 'agglo[train]' ({error})") from error
    start = time.process_time()
    with _one_thread():
        data = _gather(list(piece_levels(np.random.default_rng([seed, 2]), pieces)))
        values = {
            k: torch.tensor(v, dtype=torch.float32, requires_grad=True)
            for k, v in initial_parameters(seed).items()
        }
        _fit(values, data, np.random.default_rng([seed, 3]), steps, start, progress)
    parameters = {key: value.detach().numpy().copy() for key, value in values.items()}
    return parameters, _validate(parameters, initial_parameters(seed), validation)


@contextmanager
def _one_thread() -> Iterator[None]:
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _fit(
    values: Any, data: _Data, rng: np.random.Generator, steps: int, start: float, progress: Progress | None
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
        loss = _loss(values, _batch(data, chosen), 0.4 + 0.8 * share)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(values.values(), 1.0)
        optimiser.step()
        if progress is not None and (step + 1) % 100 == 0:
            progress(step + 1, float(loss.detach()), time.process_time() - start)


def _loss(values: Any, batch: dict[str, torch.Tensor], sharpness: float) -> torch.Tensor:
    """Expected cut · √A (1/A₁ + 1/A₂) − 15 B/T + 6 ((A₁ − A₂)/A)², mean over the pieces.

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
    cost = (cut - _COMPACT / _INERTIA * moment.square().sum(1)) / (one * (1 - one))
    return (cost + _BALANCE * (2 * one - 1) ** 2).mean()


def _gather(levels: list[Graph]) -> _Data:
    """Flat arrays of all blocks; lengths in units of √A."""
    kinds: dict[str, list[Any]] = {key: [] for key in _Data.__dataclass_fields__}
    for level in levels:
        sight = see(level)
        rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
        once = rows < level.indices
        rows, columns, block = rows[once], level.indices[once], level.block_ids[rows[once]]
        area = np.bincount(level.block_ids, level.measures)
        first = level.offsets[block]
        found = {
            "cell_offsets": np.diff(level.offsets),
            "cells": sight.cells,
            "shares": sight.shares,
            "edge_offsets": np.bincount(block, minlength=level.n_blocks),
            "ends": np.stack((rows - first, columns - first), axis=1),
            "lengths": level.interface[once] / np.sqrt(area[block]),
            "node_offsets": np.diff(sight.node_offsets),
            "nodes": sight.nodes,
            "near": sight.near.astype(np.int64),
            "areas": sight.areas,
            "blocks": sight.blocks,
        }
        for key, values in found.items():
            kinds[key].append(values)
    joined = {key: np.concatenate(values) for key, values in kinds.items()}
    for key in ("cell_offsets", "edge_offsets", "node_offsets"):
        joined[key] = np.concatenate(([0], np.cumsum(joined[key])))
    return _Data(**joined)


def _batch(data: _Data, chosen: Int) -> dict[str, torch.Tensor]:
    import torch

    cells, cell_owner, cell_first = _rows(data.cell_offsets, chosen)
    edges, edge_owner, _ = _rows(data.edge_offsets, chosen)
    nodes, node_owner, node_first = _rows(data.node_offsets, chosen)
    near = data.near[nodes]
    arrays = {
        "cells": data.cells[cells].astype(np.float32),
        "shares": data.shares[cells].astype(np.float32),
        "cell_owner": cell_owner,
        "ends": data.ends[edges] + cell_first[edge_owner][:, None],
        "lengths": data.lengths[edges].astype(np.float32),
        "edge_owner": edge_owner,
        "nodes": data.nodes[nodes].astype(np.float32),
        "near": np.where(near >= 0, near + node_first[node_owner][:, None], -1),
        "areas": data.areas[nodes].astype(np.float32),
        "node_owner": node_owner,
        "blocks": data.blocks[chosen].astype(np.float32),
        "root": np.sqrt(data.sizes[chosen]).astype(np.float32),
    }
    return {key: torch.from_numpy(values) for key, values in arrays.items()}


def _rows(offsets: Int, chosen: Int) -> tuple[Int, Int, Int]:
    """Rows of the chosen pieces one after the other, the place of each row's piece, and their new starts."""
    sizes = np.diff(offsets)[chosen]
    first = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(chosen)), sizes)
    return np.arange(sizes.sum()) + (offsets[chosen] - first)[owner], owner, first


def _validate(parameters: Mapping[str, Float], initial: Mapping[str, Float], count: int) -> dict[str, float]:
    """Costs of cuts over those of 2-means, on pieces made for nothing else."""
    from agglo_core.defaults.sweep import SweepBisection
    from agglo_core.plugins import default
    from agglo_gnn.fast import FastGNN

    levels = list(piece_levels(np.random.default_rng(_VALIDATION), count))
    rivals: dict[str, Rival] = {
        "ratio": FastGNN(parameters).bisect_level,
        "axes": SweepBisection().bisect_level,
        "network": lambda level, seeds: sweep(level, _scores(level, parameters)),
        "initial": lambda level, seeds: sweep(level, _scores(level, initial)),
    }
    two_means: Rival = default().build("bisector", "kmeans").bisect_level
    costs: dict[str, list[Float]] = {key: [] for key in rivals}
    for level in levels:
        seeds = np.zeros(level.n_blocks, np.uint64)
        base = _costs(level, np.asarray(two_means(level, seeds)))
        for key, rival in rivals.items():
            costs[key].append(_costs(level, rival(level, seeds)) / base)
    large = np.concatenate([np.diff(level.offsets) for level in levels]) >= 32
    joined = {key: np.concatenate(values) for key, values in costs.items()}
    return {k: float(v.mean()) for k, v in joined.items()} | {
        f"{k}_32": float(v[large].mean()) for k, v in joined.items()
    }


def _scores(level: Graph, parameters: Mapping[str, Float]) -> Float:
    """The logits of the torch network on every node."""
    import torch

    batch = _batch(_gather([level]), np.arange(level.n_blocks))
    values = {key: torch.from_numpy(np.asarray(value, np.float32)) for key, value in parameters.items()}
    with torch.no_grad():
        c = network(
            values, batch["nodes"], batch["near"], batch["areas"], batch["node_owner"], batch["blocks"]
        )
    return np.asarray((c[batch["cell_owner"]] * batch["cells"]).sum(1).numpy(), dtype=float)


def _costs(level: Graph, sides: Int) -> Float:
    """cut · √A (1/A₁ + 1/A₂) + 15 (1 − B/T) of each block."""
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
    costs: Float = cut * np.sqrt(total) * (1 / area).sum(axis=1) + 15 * within / (inertia - mean)
    return costs
