"""``agglo hilbert-order``."""

import click
import numpy as np
from numpy.typing import NDArray

from agglo_core import samples
from agglo_hilbert.curve import hilbert_keys

__all__ = ["order"]


def _unit(points: NDArray[np.float64]) -> NDArray[np.float64]:
    low = points.min(axis=0)
    return (points - low) / (points.max(axis=0) - low).max()


@click.command()
@click.argument("sample")
@click.option("--bits", default=10, show_default=True, type=click.IntRange(1, 20), help="Depth of the curve.")
def order(sample: str, bits: int) -> None:
    """Print the cells of SAMPLE along the Hilbert curve."""
    grid = np.minimum(_unit(samples.from_spec(sample).cell_centroids) * 2**bits, 2**bits - 1)
    click.echo(" ".join(map(str, np.argsort(hilbert_keys(grid.astype(np.uint64), bits), kind="stable"))))
