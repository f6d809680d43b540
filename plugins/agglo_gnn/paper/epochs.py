"""Reproducible training of a network by the paper's loss, in epochs that can be resumed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agglo_core.authoring import Graph, OptionError
from agglo_gnn.paper.data import draw, random_piece
from agglo_gnn.paper.network import Neighbours, expected_normalised_cut, inorm


@dataclass(frozen=True)
class Recipe:
    """Settings for training data and optimiser, with the paper's values as defaults (§3.3).

    Attributes
    ----------
    meshes, validation : int
        Set sizes.
    pieces : float
        Fraction of training meshes reduced to a random piece; 0 in the paper.
    epochs, batch : int
    rate, decay : float
        Adam's learning rate and L² coefficient.
    """

    seed: int = 0
    meshes: int = 800
    validation: int = 200
    pieces: float = 0.0
    epochs: int = 300
    batch: int = 4
    rate: float = 1e-5
    decay: float = 1e-5


@dataclass(frozen=True)
class Epoch:
    """Progress after an epoch: mean training and validation losses, and fraction of one-sided bisections."""

    number: int
    loss: float
    validation: float
    one_sided: float


Sample = tuple[Graph, Tensor]


class Training:
    """Training run of one network, with its optimiser and its data.

    Parameters
    ----------
    build : callable
        Returns the network; all its random numbers from torch follow the seed.
    recipe : Recipe
    device : str
        ``"cpu"`` or ``"cuda"``.
    """

    def __init__(self, build: Callable[[], nn.Module], recipe: Recipe, device: str = "cpu") -> None:
        self.recipe, self.device, self.done = recipe, device, 0
        with _seed_torch(recipe.seed, 0):
            self.network = build().to(device)
        parameters = self.network.parameters()
        self.optimiser = torch.optim.Adam(parameters, lr=recipe.rate, weight_decay=recipe.decay)
        streams = [np.random.default_rng([recipe.seed, k]) for k in range(3)]
        self._train = _samples(draw(recipe.meshes, streams[0], recipe.pieces), device)
        fresh = list(draw(recipe.validation, streams[1]))
        self._fresh = _samples(fresh, device)
        self._pieces = _samples((random_piece(graph, streams[2]) for graph in fresh), device)

    def epochs(self) -> Iterator[Epoch]:
        """Train for all remaining epochs, and yield the progress after each."""
        while self.done < self.recipe.epochs:
            with _seed_torch(self.recipe.seed, self.done + 1):
                loss = self._epoch()
            self.done += 1
            yield Epoch(self.done, loss, self.measure(self._fresh)[0], self.measure(self._pieces)[1])

    def _epoch(self) -> float:
        order = np.random.default_rng([self.recipe.seed, 3, self.done]).permutation(len(self._train))
        total = 0.0
        self.network.train()
        for start in range(0, len(order), self.recipe.batch):
            losses = self._losses([self._train[i] for i in order[start : start + self.recipe.batch]])[0]
            self.optimiser.zero_grad()
            losses.mean().backward()  # type: ignore[no-untyped-call]
            self.optimiser.step()
            total += float(losses.detach().sum())
        return total / len(order)

    def _losses(self, samples: Sequence[Sample]) -> tuple[Tensor, Tensor, Neighbours]:
        neighbours = Neighbours.of([graph for graph, _ in samples], self.device)
        logits = self.network(torch.cat([features for _, features in samples]), neighbours)
        return expected_normalised_cut(logits, neighbours), logits, neighbours

    @torch.no_grad()
    def measure(self, samples: Sequence[Sample]) -> tuple[float, float]:
        """Return the mean loss over some graphs, and the fraction with all cells on one side."""
        self.network.eval()
        total, one_sided = 0.0, 0
        for start in range(0, len(samples), 50):
            losses, logits, neighbours = self._losses(samples[start : start + 50])
            total += float(losses.sum())
            side = (logits[:, 1] >= logits[:, 0]).to(logits.dtype)[:, None]
            ones = neighbours.block_sums(side)
            cells = neighbours.block_sums(torch.ones_like(side))
            one_sided += int(((ones == 0) | (ones == cells)).sum())
        return total / len(samples), one_sided / len(samples)

    def state(self) -> dict[str, np.ndarray]:
        """Return network parameters and optimiser moments by name, from which training can be resumed."""
        arrays = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        for (name, _), moments in zip(self.network.named_parameters(), self._moments(), strict=True):
            arrays |= {f"{key}.{name}": value for key, value in moments.items()}
        return {name: value.cpu().numpy() for name, value in arrays.items()}

    def restore(self, arrays: dict[str, np.ndarray], done: int) -> None:
        """Resume from a result of :meth:`state` after ``done`` epochs.

        Raises
        ------
        OptionError
            If the arrays belong to another network.
        """
        # 1. Compare the shapes
        state_arrays = self.state()
        shapes, other_shapes = ({k: v.shape for k, v in item.items()} for item in (state_arrays, arrays))
        if shapes != other_shapes:
            odd = sorted(
                k for k in shapes.keys() | other_shapes.keys() if shapes.get(k) != other_shapes.get(k)
            )
            raise OptionError(f"the checkpoint belongs to another network: {', '.join(odd[:4])} differ")
        # 2. Load the parameters
        tensors = {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()}
        prefix = "network."
        self.network.load_state_dict(
            {k[len(prefix) :]: v for k, v in tensors.items() if k.startswith(prefix)}
        )
        # 3. Load the optimiser's moments
        state = self.optimiser.state_dict()
        names = [name for name, _ in self.network.named_parameters()]
        state["state"] = {
            i: {key: tensors[f"{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")}
            for i, name in enumerate(names)
        }
        self.optimiser.load_state_dict(state)
        self.done = done

    def _moments(self) -> Iterator[dict[str, Tensor]]:
        """Yield the Adam optimiser's state for each parameter, zeros before the first step."""
        for parameter in self.network.parameters():
            state: dict[str, Any] = self.optimiser.state.get(parameter, {})
            blank = torch.zeros_like(parameter)
            initial = {"step": torch.tensor(0.0), "exp_avg": blank, "exp_avg_sq": blank}
            yield initial | state


def _samples(graphs: Iterator[Graph] | Sequence[Graph], device: str) -> list[Sample]:
    return [(graph, torch.from_numpy(inorm(graph)).to(device, torch.float32)) for graph in graphs]


@contextmanager
def _seed_torch(seed: int, step: int) -> Iterator[None]:
    """Seed torch's random generators within a ``with`` block, and restore them afterwards."""
    with torch.random.fork_rng():
        torch.manual_seed((seed << 20) + step)
        yield


def choose_device(wanted: str) -> str:
    """Return ``"cpu"`` or ``"cuda"``. The choice ``"auto"`` prefers a GPU if available.

    Raises
    ------
    OptionError
        If CUDA is requested but not available.
    """
    if wanted == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if wanted == "cuda" and not torch.cuda.is_available():
        raise OptionError("--device cuda: torch finds no CUDA device; use --device cpu")
    return wanted
