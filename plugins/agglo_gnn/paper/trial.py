"""Test, before any training, that a user-defined network can be trained, saved and evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from agglo_core.authoring import AggloError, OptionError, samples
from agglo_gnn.paper.network import Neighbours, inorm

_BATCH_NORMS = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm)


def try_network(name: str, build: Callable[[], nn.Module]) -> None:
    """Test a network on two small meshes, together and alone, and raise OptionError if it is unsuitable.

    It is evaluated in evaluation mode and in training mode: batch norm, for example, mixes blocks only in
    training.

    Raises
    ------
    OptionError
        If the network fails, has no parameters to train, cannot be saved in a model file, or does not
        return finite logits ``(n, 2)`` that depend only on the block.
    """
    try:
        with keep_torch_state():
            network = build()
            before = _shapes(name, network)
            _ask(name, network)
            _check_state(name, network, before)
    except AggloError:
        raise
    except Exception as error:  # third-party code may raise any exception
        raise OptionError(
            f"network {name!r} failed on two meshes: {type(error).__name__}: {error}"
        ) from error


@contextmanager
def keep_torch_state() -> Iterator[None]:
    """Restore torch's random state after a ``with`` block."""
    with torch.random.fork_rng():
        yield


def _shapes(name: str, network: nn.Module) -> dict[str, tuple[int, ...] | None]:
    """Return the shapes of a network's state arrays by name, None for any other state."""
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise OptionError(f"network {name!r} has no parameters to train")
    state = network.state_dict()
    if lazy := [key for key, value in state.items() if is_lazy(value)]:
        raise OptionError(
            f"network {name!r}: {lazy[0]!r} has no shape before the first call; "
            "give its layer the number of inputs"
        )
    return {key: tuple(value.shape) if isinstance(value, Tensor) else None for key, value in state.items()}


def _check_state(name: str, network: nn.Module, before: dict[str, tuple[int, ...] | None]) -> None:
    """Raise OptionError for any state that a model file could not restore."""
    for key, value in network.state_dict().items():
        if reason := _unsavable_reason(value):
            raise OptionError(f"network {name!r} cannot be saved in a model file: {key!r} {reason}")
    after = _shapes(name, network)
    if odd := sorted(key for key in before.keys() | after.keys() if before.get(key) != after.get(key)):
        raise OptionError(f"network {name!r} changes the shapes of its state when called: {', '.join(odd)}")


def _unsavable_reason(value: object) -> str:
    """Return the reason why a model file cannot contain a state value, empty if it can."""
    if not isinstance(value, Tensor):
        return f"is a {type(value).__name__}, and model files hold arrays only"
    if value.dtype not in (torch.float16, torch.float32, torch.float64):
        kind = str(value.dtype).removeprefix("torch.")
        return (
            f"is {kind}, and model files hold real numbers only; "
            "use register_buffer(..., persistent=False) for a constant"
        )
    return "" if value.isfinite().all() else "has values that are not finite"


def _ask(name: str, network: nn.Module) -> None:
    """Check that the logits of a block depend only on this block and on the network parameters.

    In evaluation mode the second mesh is evaluated alone too, in training mode with the first mesh changed.
    """
    # 1. Two meshes with their features
    graphs = [samples.voronoi(18).graph, samples.strip(5).graph]
    first, second = (torch.from_numpy(inorm(graph)).float() for graph in graphs)
    pair = Neighbours.of(graphs)

    def logits(x: Tensor, neighbours: Neighbours) -> Tensor:
        torch.manual_seed(0)  # fixes dropout
        return _check_logits(name, network(x, neighbours), len(x))

    # 2. Evaluate both modes, with the first mesh absent or changed
    network.eval()
    with torch.no_grad():
        batched = logits(torch.cat((first, second)), pair)[len(first) :]
        alone = logits(second, Neighbours.of(graphs[1:]))
    network.train()
    trained = logits(torch.cat((first, second)), pair)
    changed = logits(torch.cat((1 - 3 * first, second)), pair)[len(first) :]
    # 3. Compare the logits of the second mesh
    for a, b, mode in ((batched, alone, ""), (trained[len(first) :], changed, " in training")):
        if not torch.allclose(a, b, rtol=1e-3, atol=1e-4):
            raise OptionError(
                f"network {name!r} returns logits of a block that depend on other blocks{mode}"
                f"{_culprit(network)}"
            )
    if not trained.requires_grad:
        raise OptionError(f"network {name!r} returns logits that do not depend on its parameters")


def _culprit(network: nn.Module) -> str:
    """Return an addition to the error message that names the first batch norm layer, if any."""
    norms = ((key, layer) for key, layer in network.named_modules() if isinstance(layer, _BATCH_NORMS))
    return next((f": {key!r} is a {type(layer).__name__}" for key, layer in norms), "")


def _check_logits(name: str, logits: Tensor, cells: int) -> Tensor:
    if tuple(logits.shape) != (cells, 2):
        raise OptionError(
            f"network {name!r} returned shape {tuple(logits.shape)} for {cells} cells, "
            f"expected logits ({cells}, 2)"
        )
    if not logits.isfinite().all():
        raise OptionError(f"network {name!r} returned logits that are not finite for a mesh of {cells} cells")
    return logits
