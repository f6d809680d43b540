"""Networks of your own: how one is named, what it must offer, and how it is built.

A network is a class of ``torch.nn.Module`` that takes no arguments, or a function that returns one. Its

    forward(x, neighbours) -> logits (n, 2)

takes the features ``x (n, 3)`` of :func:`agglo_gnn.paper_network.inorm` (measure and two coordinates of
each cell, block by block) and a :class:`agglo_gnn.paper_network.Neighbours`, whose ``mean``, ``sum`` and
``block_sums`` are all a message-passing network needs. Several graphs share a call, so nothing may be
computed across blocks (no batch statistics).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agglo_core import samples
from agglo_core.errors import AggloError, OptionError
from agglo_gnn import model_file
from agglo_gnn.paper_network import ARCHITECTURE, Neighbours, PaperNetwork, inorm

__all__ = ["architecture_of", "arrays_of", "filled", "network_class", "unseeded"]


def network_class(name: str | None) -> Callable[[], nn.Module]:
    """The paper's network, or what ``"module:Class"`` names; modules of the current folder are found.

    Raises
    ------
    OptionError
        If it cannot be imported or built, or does not return logits ``(n, 2)``.
    """
    if name is None:
        return PaperNetwork
    module, colon, attribute = name.partition(":")
    if not colon or not module or not attribute:
        raise OptionError(f"network {name!r} is not of the form module:Class")
    try:
        with _current_folder():
            target: Any = reduce(getattr, attribute.split("."), importlib.import_module(module))
    except (ImportError, AttributeError) as error:
        raise OptionError(f"network {name!r} cannot be imported: {error}") from error
    _try(name, target)
    build: Callable[[], nn.Module] = target
    return build


def architecture_of(name: str | None) -> str:
    """What model files call a network."""
    return ARCHITECTURE if name is None else f"custom {name}"


def arrays_of(network: nn.Module) -> dict[str, NDArray[np.float32]]:
    """Parameters and buffers by name."""
    return {name: value.detach().cpu().numpy() for name, value in network.state_dict().items()}


def filled(name: str | None, weights: str | Path) -> nn.Module:
    """A network with the arrays of a model file, ready to be asked.

    Raises
    ------
    FileError
        If the file is not a sound model file of that very network.
    """
    with unseeded():
        network = network_class(name)()
    shapes = {key: tuple(value.shape) for key, value in network.state_dict().items()}
    arrays, _ = model_file.load(weights, architecture=architecture_of(name), shapes=shapes)
    network.load_state_dict({key: torch.from_numpy(np.array(value)) for key, value in arrays.items()})
    return network.eval().requires_grad_(False)


def _try(name: str, target: Callable[[], nn.Module]) -> None:
    """Ask the network about two small meshes, side by side and alone."""
    graphs = [samples.voronoi(18).graph, samples.strip(5).graph]
    features = [torch.from_numpy(inorm(graph)).float() for graph in graphs]
    try:
        with unseeded(), torch.no_grad():
            network = target().eval()
            both = network(torch.cat(features), Neighbours.of(graphs))
            alone = network(features[1], Neighbours.of(graphs[1:]))
            shape, agrees = tuple(both.shape), torch.allclose(both[-5:], alone, rtol=1e-3, atol=1e-4)
    except AggloError:
        raise
    except Exception as error:  # a stranger's code: whatever it raises is what is wrong with it
        raise OptionError(
            f"network {name!r} failed on two meshes: {type(error).__name__}: {error}"
        ) from error
    if shape != (23, 2):
        raise OptionError(f"network {name!r} returned shape {shape} for 23 cells, expected logits (23, 2)")
    if not agrees:
        raise OptionError(f"network {name!r} answers for a block by what is in the blocks beside it")


@contextmanager
def unseeded() -> Iterator[None]:
    """Whatever the block draws from torch's generators, they are afterwards as they were."""
    with torch.random.fork_rng():
        yield


@contextmanager
def _current_folder() -> Iterator[None]:
    """Modules of the current folder can be imported in the block."""
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
