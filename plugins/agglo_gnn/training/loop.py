"""Training of a small network on mesh pieces, common to 2-D and 3-D."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from agglo_core.authoring import Float, Int, OptionError, PluginError

if TYPE_CHECKING:
    import torch

_BATCH = 64  # pieces per step: more give smoother gradients and slower steps (benchmarks/constants.py)
_RATE = 2e-3  # largest learning rate of Adam, after the warm-up (benchmarks/constants.py)
_WARM_UP = 0.03  # fraction of the steps in which the learning rate rises from 0 (benchmarks/constants.py)
# Pieces are drawn in proportion to this power of their number of cells: large pieces are few, but need the
# network most. 0 would draw all pieces equally often (benchmarks/constants.py)
_SIZE_POWER = 0.35
BALANCE = 6.0
"""Weight of ((A₁ − A₂)/A)² in a loss, relative to the cut cost: larger favours equal sides.
Benchmark: benchmarks/constants.py."""
COMPACT, GROWTH = 15.0, 4.0  # as in the sweep
"""Weight of the inertia between the sides in a loss: the maximum of the first and √n times the second. Larger
values favour compact sides, smaller values short cuts (benchmarks/constants.py)."""

Progress = Callable[[int, float, float], None]


class PieceTask(NamedTuple):
    """Definition of a training: initial parameters, training pieces, loss and validation of a network.

    Attributes
    ----------
    initial : callable
        ``initial(seed)`` returns the parameters before training.
    pieces : callable
        ``pieces(rng, count)`` returns at least ``count`` pieces in flat arrays, with their cell counts
        ``sizes``.
    loss : callable
        ``loss(values, pieces, chosen, sharpness)`` returns the mean loss of the chosen pieces, a scalar
        tensor.
    validate : callable
        ``validate(parameters, initial, count)`` returns metrics, measured on ``count`` separate pieces.
    """

    initial: Callable[[int], dict[str, Float]]
    pieces: Callable[[np.random.Generator, int], Any]
    loss: Callable[[dict[str, torch.Tensor], Any, Int, float], torch.Tensor]
    validate: Callable[[dict[str, Float], dict[str, Float], int], dict[str, float]]


def train_on_pieces(
    task: PieceTask, seed: int, steps: int, pieces: int, validation: int, progress: Progress | None
) -> tuple[dict[str, Float], dict[str, float]]:
    """Train a network from ``seed`` on one thread, reproducibly on each computer.

    Parameters
    ----------
    task : PieceTask
    seed : int
    steps : int
        Training steps, with 64 pieces each.
    pieces, validation : int
        Piece counts for training and for validation.
    progress : callable, optional
        Called every 100 steps with the step, its loss and the CPU seconds so far.

    Returns
    -------
    parameters : dict of arrays
    metrics : dict

    Raises
    ------
    PluginError
        If torch is not installed.
    OptionError
        If a number is out of range.
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
    start = time.process_time()
    with one_thread():
        data, initial = task.pieces(np.random.default_rng([seed, 2]), pieces), task.initial(seed)
        values = {k: torch.tensor(v, dtype=torch.float32, requires_grad=True) for k, v in initial.items()}
        _fit(task, values, data, np.random.default_rng([seed, 3]), steps, start, progress)
        parameters = {key: value.detach().numpy().copy() for key, value in values.items()}
        return parameters, task.validate(parameters, initial, validation)


def _fit(
    task: PieceTask,
    values: dict[str, torch.Tensor],
    data: Any,
    rng: np.random.Generator,
    steps: int,
    start: float,
    progress: Progress | None,
) -> None:
    """Minimise the loss by Adam.

    The sides become increasingly sharp from step to step.
    """
    import torch

    optimiser = torch.optim.Adam(values.values(), lr=_RATE)
    # Draw large pieces more often: by a power of the cell count.
    weight = data.sizes**_SIZE_POWER
    edges = np.cumsum(weight / weight.sum())
    warm = max(1, round(_WARM_UP * steps))
    for step in range(steps):
        # The learning rate rises linearly during the warm-up and falls along a cosine.
        share = step / steps
        for group in optimiser.param_groups:
            group["lr"] = _RATE * min((step + 1) / warm, 0.5 * (1 + np.cos(np.pi * share)))
        chosen: Int = np.minimum(np.searchsorted(edges, rng.random(_BATCH)), len(weight) - 1)
        loss = task.loss(values, data, chosen, 0.4 + 0.8 * share)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(values.values(), 1.0)
        optimiser.step()
        if progress is not None and (step + 1) % 100 == 0:
            progress(step + 1, float(loss.detach()), time.process_time() - start)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread within a ``with`` block, so that sums are reproducible to the bit."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
