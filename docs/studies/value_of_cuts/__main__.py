"""The commands of the study: ``python -m value_of_cuts train`` and ``compare``."""

from __future__ import annotations

import time
from typing import BinaryIO

import click
import numpy as np

from agglo_core.authoring import Number
from agglo_paper.long_runs import one_thread, without_notices


@click.group()
def study() -> None:
    """Train value functions of cuts, and compare their part counts with those of other methods."""


@study.command("train")
@click.option("--dim", type=click.IntRange(2, 3), default=2, show_default=True, help="Of the meshes.")
@click.option("--seed", type=Number(int, least=0), default=0, show_default=True, help="Of the training.")
@click.option("-o", "--output", type=click.File("wb"), required=True, help="File of the weights.")
def train_command(dim: int, seed: int, output: BinaryIO) -> None:
    """Train a network, print the part counts of each round, and write the weights."""
    start = time.process_time()
    with one_thread(), without_notices():
        from value_of_cuts.train import train

        np.savez(output, **train(dim, seed, click.echo)._asdict())
    click.echo(f"{time.process_time() - start:.0f} CPU seconds")


@study.command("compare")
@click.argument("files", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False))
@click.option("--meshes", type=Number(int, least=2), default=8, show_default=True, help="Of each family.")
@click.option("--seed", type=Number(int, least=0), default=9700, show_default=True, help="Of the first mesh.")
def compare_command(files: tuple[str, ...], meshes: int, seed: int) -> None:
    """Print part counts and CPU times over those of k-means, for FILES of one dimension and several seeds."""
    with one_thread(), without_notices():
        from value_of_cuts.compare import table
        from value_of_cuts.cuts import Network

        click.echo(table([Network(**np.load(file)) for file in files], meshes, seed))


if __name__ == "__main__":
    study(prog_name="python -m value_of_cuts")
