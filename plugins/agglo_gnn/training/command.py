"""The command ``agglo train``, which trains a built-in or user-defined network and writes its model file."""

from __future__ import annotations

import shlex
from dataclasses import replace
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from agglo_core.authoring import FileError, Number, OptionError
from agglo_core.cli.options.agglomeration import FILE

_COUNT, _SHARE = Number(int, least=1), Number(float, least=0, most=1)  # types of options
_FAST_COLUMNS = " step      loss  CPU seconds"
_PAPER_ONLY = ("epochs", "meshes", "pieces", "rate", "network", "checkpoint", "resume", "device")


@click.command()
@click.option("--preset", type=click.Choice(["paper", "fast", "fast3d"]), default="fast", show_default=True)
@click.option("-o", "--output", type=FILE, help="Model file to write (default PRESET.safetensors).")
@click.option("--epochs", type=_COUNT, help="Passes through the training set (paper: 300).")
@click.option("--steps", type=_COUNT, help="Training steps of 64 pieces each (fast, fast3d).")
@click.option("--seed", type=Number(int, least=0, most=2**31 - 1), default=0, show_default=True)
@click.option("--meshes", type=_COUNT, help="Training meshes (paper: 800), plus a quarter for validation.")
@click.option("--pieces", type=_SHARE, help="Share of meshes cut down to a random piece.")
@click.option("--rate", type=Number(float, above=0), help="Learning rate (paper: 1e-5).")
@click.option("--network", metavar="MODULE:CLASS", help="Your own network instead of the paper's.")
@click.option("--checkpoint", type=FILE, help="File kept up to date after each epoch (.safetensors).")
@click.option("--resume", is_flag=True, help="Resume from the checkpoint.")
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", help="Default auto.")
@click.option("--log", type=FILE, help="Text file with a line for each epoch (fast, fast3d: each 100 steps).")
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
@click.pass_context
def train(
    context: click.Context,
    preset: str,
    output: Path | None,
    epochs: int | None,
    steps: int | None,
    seed: int,
    meshes: int | None,
    pieces: float | None,
    rate: float | None,
    network: str | None,
    checkpoint: Path | None,
    resume: bool,
    device: str,
    log: Path | None,
    quiet: bool,
) -> None:
    """Train a bisector from a seed alone, and write its model file.

    The preset fast trains gnn in 2-D, fast3d in 3-D; the preset paper trains gnn_paper and takes all
    options except --steps. On one machine equal seeds give equal files to the last bit.
    """
    # 1. Check before the training
    _check_torch()
    target = output or Path(f"{preset}.safetensors")
    _check_files(target, checkpoint, log, resume)
    _refuse_foreign(context, ("steps",) if preset == "paper" else _PAPER_ONLY, preset)
    # 2. Train
    if preset != "paper":
        _train_fast(preset, target, seed, steps, log, quiet, _command(context))
    else:
        from agglo_gnn.paper.epochs import Recipe
        from agglo_gnn.paper.train import train_paper

        counts = {"meshes": meshes, "validation": max(1, meshes // 4) if meshes else None}
        changes: dict[str, Any] = {"epochs": epochs, "pieces": pieces, "rate": rate, **counts}
        options = {key: value for key, value in changes.items() if value is not None}
        train_paper(
            target,
            replace(Recipe(seed=seed), **options),
            command=_command(context),
            network=network,
            checkpoint=checkpoint,
            resume=resume,
            device=device,
            log=log,
            quiet=quiet,
        )
    if not quiet:
        click.echo(f"wrote {target}; inspect it with: agglo model info {target}")


def _check_torch() -> None:
    if find_spec("torch") is None:
        raise OptionError(
            "training needs PyTorch, which is not installed: pip install 'agglo[train]' "
            "(a trained gnn runs without it)"
        )


def _check_files(target: Path, checkpoint: Path | None, log: Path | None, resume: bool) -> None:
    """Raise errors about file names before the training rather than after it."""
    for file in filter(None, (target, checkpoint)):
        if file.suffix != ".safetensors":
            raise FileError(f"{file}: model files end in .safetensors, not {file.suffix!r}")
    for file in filter(None, (target, checkpoint, log)):
        if not file.absolute().parent.is_dir():
            raise FileError(f"{file}: there is no folder {file.parent}")
        if file.is_dir():
            raise FileError(f"{file} is a folder; expected the name of a file")
    if checkpoint is not None and checkpoint.absolute() == target.absolute():
        raise OptionError(f"--checkpoint and --output are the same file, {target}")
    if resume and checkpoint is None:
        raise OptionError("--resume needs --checkpoint FILE")


def _given_options(context: click.Context) -> dict[str, Any]:
    """Return the options that were given on the command line, in the order of the help."""
    source = context.get_parameter_source
    return {key: context.params[key] for key in _names() if source(key) is ParameterSource.COMMANDLINE}


def _names() -> list[str]:
    return [str(parameter.name) for parameter in train.params]


def _refuse_foreign(context: click.Context, foreign: tuple[str, ...], preset: str) -> None:
    if typed := [f"--{key}" for key in _given_options(context) if key in foreign]:
        raise OptionError(f"{', '.join(typed)}: not for the preset {preset}; see agglo train --help")


def _command(context: click.Context) -> str:
    """Return the command line that repeats this training."""
    words = [
        f"--{key}" if value is True else f"--{key} {shlex.quote(str(value))}"
        for key, value in _given_options(context).items()
    ]
    return " ".join(["agglo train", *words])


def _train_fast(
    preset: str, target: Path, seed: int, steps: int | None, log: Path | None, quiet: bool, command: str
) -> None:
    from agglo_core.authoring import __version__
    from agglo_gnn import model_file
    from agglo_gnn.training.report import reporter

    fit, features, pieces = _parts_of(preset)
    options = {} if steps is None else {"steps": steps}
    total = options.get("steps") or signature(fit).parameters["steps"].default
    with reporter([f"# {command}", f"# {pieces}", _FAST_COLUMNS], log, quiet) as report:

        def progress(step: int, loss: float, seconds: float) -> None:
            report(f"{step:5d}  {loss:8.4f}  {seconds:11.1f}", step / total)

        arrays, metrics = fit(seed, progress=progress, **options)
    recipe = {"pieces": pieces, "steps": total}
    header = {"architecture": preset, "features": list(features), "recipe": recipe, "seed": seed}
    model_file.save(target, arrays, header | {"version": __version__, "metrics": metrics})


def _parts_of(preset: str) -> tuple[Any, tuple[str, ...], str]:
    """Return training function, feature names and a description of the training pieces for a preset."""
    if preset == "fast3d":
        from agglo_gnn.space.network import SPATIAL_FEATURES
        from agglo_gnn.space.pieces import SPATIAL_RECIPE
        from agglo_gnn.space.train import train_solids

        return train_solids, SPATIAL_FEATURES, SPATIAL_RECIPE
    from agglo_gnn.plane.features import FEATURES
    from agglo_gnn.plane.train import train_fast
    from agglo_gnn.training.pieces import RECIPE

    return train_fast, FEATURES, RECIPE
