"""Import, check and build user-defined networks.

A network is a class of ``torch.nn.Module`` without arguments, or a function that returns an instance. Its

    forward(x, neighbours) -> logits (n, 2)

takes the features ``x (n, 3)`` from :func:`agglo_gnn.paper.network.inorm` (measure and two coordinates of
each cell, block by block) and a :class:`agglo_gnn.paper.network.Neighbours`, whose ``mean``, ``sum`` and
``block_sums`` suffice for message passing. Several graphs share a call, so nothing may be computed across
blocks (no batch statistics). All network state must be real arrays, and some of it parameters.
"""

from __future__ import annotations

import importlib
import inspect
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

from agglo_core.authoring import OptionError
from agglo_gnn import model_file
from agglo_gnn.paper.network import ARCHITECTURE, PaperNetwork
from agglo_gnn.paper.trial import keep_torch_state, try_network


def network_class(name: str | None) -> Callable[[], nn.Module]:
    """Import and check the network class ``"module:Class"``. Without a name, return the paper's.

    Raises
    ------
    OptionError
        If the network cannot be imported, does not fit the description of this module (then it is not
        called), or cannot be trained and used (:mod:`agglo_gnn.paper.trial`).
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
    if not _builds_networks(target):
        raise OptionError(
            f"network {name!r} is {target!r:.60}, expected a class of torch.nn.Module, or a function without "
            "arguments that returns one"
        )
    try_network(name, target)
    build: Callable[[], nn.Module] = target
    return build


def _builds_networks(target: object) -> bool:
    """Return True for a class of torch networks, or a function without required arguments."""
    if isinstance(target, type):
        return issubclass(target, nn.Module)
    if not inspect.isfunction(target):
        return False
    parameters = inspect.signature(target).parameters.values()
    return all(
        each.default is not each.empty or each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD)
        for each in parameters
    )


def architecture_of(name: str | None) -> str:
    """Return the name by which model files refer to a network architecture."""
    return ARCHITECTURE if name is None else f"custom {name}"


def arrays_of(network: nn.Module) -> dict[str, NDArray[np.float32]]:
    """Return the parameters and buffers of a network as arrays by name."""
    return {name: value.detach().cpu().numpy() for name, value in network.state_dict().items()}


def load_network(name: str | None, weights: str | Path) -> nn.Module:
    """Build a network, load its parameters from a model file, and prepare it for evaluation.

    The file is read first: no code is imported for an invalid file.

    Raises
    ------
    FileError
        If the file is not a valid model file for this network.
    """
    arrays, _ = model_file.load(weights, architecture=architecture_of(name))
    with keep_torch_state():
        network = network_class(name)()
    shapes = {key: tuple(value.shape) for key, value in network.state_dict().items()}
    model_file.check_shapes(weights, arrays, shapes)
    network.load_state_dict({key: torch.from_numpy(np.array(value)) for key, value in arrays.items()})
    return network.eval().requires_grad_(False)


@contextmanager
def _current_folder() -> Iterator[None]:
    """Make modules in the current folder importable within a ``with`` block."""
    folder = str(Path.cwd())
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)
