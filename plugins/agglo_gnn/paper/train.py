"""Training for ``agglo train --preset paper``, with checkpoints, log and model file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agglo_core.authoring import OptionError, __version__
from agglo_gnn import model_file
from agglo_gnn.paper.custom import architecture_of, arrays_of, network_class
from agglo_gnn.paper.data import CELLS, FAMILIES
from agglo_gnn.paper.epochs import Epoch, Recipe, Training, choose_device
from agglo_gnn.paper.network import FEATURES
from agglo_gnn.training.loop import one_thread
from agglo_gnn.training.report import reporter

_COLUMNS = "epoch      loss  validation  one-sided"


def train_paper(
    target: Path,
    recipe: Recipe,
    *,
    command: str = "",
    network: str | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
    device: str = "auto",
    log: Path | None = None,
    quiet: bool = True,
) -> dict[str, Any]:
    """Train a network by the paper's loss, write the model file ``target``, and return its header.

    The log has a line per epoch: running mean loss on the training set, mean loss on the validation meshes,
    and the fraction of one-sided random validation pieces.

    Raises
    ------
    OptionError
        If the network or the checkpoint does not fit.
    FileError
        If a file cannot be read or written.
    """
    header = _header(recipe, network)
    title = [f"# {command}", f"# {json.dumps(header['recipe'])}, seed {recipe.seed}", _COLUMNS]
    build, chosen = network_class(network), choose_device(device)
    with one_thread(), reporter(title, log, quiet, append=resume) as report:
        training = Training(build, recipe, chosen)
        if resume and checkpoint is not None:
            _resume(training, checkpoint, header)
        for epoch in training.epochs():
            header["metrics"] = _metrics(epoch)
            if checkpoint is not None:
                model_file.save(checkpoint, training.state(), header | _checkpoint(header))
            report(_line(epoch), epoch.number / recipe.epochs)
    model_file.save(target, arrays_of(training.network), header)
    return header


def _header(recipe: Recipe, network: str | None) -> dict[str, Any]:
    options = {key: value for key, value in asdict(recipe).items() if key != "seed"}
    return {
        "architecture": architecture_of(network),
        "features": list(FEATURES),
        "recipe": options | {"families": list(FAMILIES), "cells": list(CELLS)},
        "seed": recipe.seed,
        "version": __version__,
        "metrics": {},
    }


def _checkpoint(header: dict[str, Any]) -> dict[str, str]:
    return {"architecture": f"checkpoint of {header['architecture']}"}


def _resume(training: Training, checkpoint: Path, header: dict[str, Any]) -> None:
    """Resume a training from its checkpoint.

    All options except the epoch count must be unchanged.
    """
    arrays, saved = model_file.load(checkpoint, architecture=_checkpoint(header)["architecture"])
    options, saved_options = ({**each["recipe"], "seed": each["seed"]} for each in (header, saved))
    odd = sorted(
        key
        for key in options.keys() | saved_options.keys()
        if options.get(key) != saved_options.get(key) and key != "epochs"
    )
    if odd:
        was = ", ".join(f"{key}={saved_options.get(key)!r} (now {options.get(key)!r})" for key in odd)
        raise OptionError(f"{checkpoint}: was trained with {was}; resume with the same options")
    epoch = saved["metrics"]["epoch"]
    if epoch >= training.recipe.epochs:
        raise OptionError(
            f"{checkpoint}: has completed {epoch} epochs; to resume, --epochs must be larger, "
            f"given {training.recipe.epochs}"
        )
    training.restore(arrays, epoch)


def _metrics(epoch: Epoch) -> dict[str, Any]:
    values = {"loss": epoch.loss, "validation": epoch.validation, "one_sided": epoch.one_sided}
    return {"epoch": epoch.number, **values}


def _line(epoch: Epoch) -> str:
    return f"{epoch.number:5d}  {epoch.loss:8.5f}  {epoch.validation:10.5f}  {epoch.one_sided:9.3f}"
