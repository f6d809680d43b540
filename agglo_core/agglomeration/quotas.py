"""How a number of parts is divided: among the pieces at the start, and between the two sides of a split."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError


class TooFewPartsError(OptionError):
    """Fewer parts are asked for than the mesh has components."""

    def __init__(self, parts: int, components: int) -> None:
        self.parts, self.components = parts, components
        super().__init__(
            f"too few parts, {parts}: the mesh has {components} disconnected components, and each is a part"
        )


def apportion(k: int, measures: Float, cells: Int, least: Int | int = 1) -> Int:
    """Divide k parts among pieces by measure: at least ``least`` each, at most their cells, exactly k in all.

    Pieces whose share lies beyond these limits get the limit, and the others divide the rest in proportion
    to their measures. If no piece has a measure, k is divided by number of cells.

    Raises
    ------
    OptionError
        If the pieces need more parts, or have fewer cells.
    """
    fewest = int(np.broadcast_to(least, cells.shape).sum())
    if k < fewest:
        raise TooFewPartsError(k, fewest)
    if k > cells.sum():
        raise OptionError(f"too many parts, {k}: there are {int(cells.sum())} cells")
    if len(measures) == 1:
        return frozen_int([k])
    share = measures if measures.sum() > 0 else cells
    ideal = _limited(frozen_float(k * share / share.sum()), k, least, cells)
    low, high = -float(k), float(k)
    for _ in range(80):  # the quotas nearest to ideal + shift add up to more as the shift rises
        shift = 0.5 * (low + high)
        fits = np.clip(np.floor(ideal + shift + 0.5), least, cells).sum() <= k
        low, high = (shift, high) if fits else (low, shift)
    quotas = np.clip(np.floor(ideal + low + 0.5), least, cells).astype(np.int64)
    want = np.where(quotas < cells, ideal - quotas, -np.inf)
    quotas[np.argsort(-want, kind="stable")[: k - int(quotas.sum())]] += 1
    return frozen_int(quotas)


def _limited(ideal: Float, k: int, least: Int | int, cells: Int) -> Float:
    """Multiples of the shares ``ideal`` by one factor, cut off at the limits, that add up to k."""
    if (np.clip(ideal, least, cells) == ideal).all():
        return ideal
    low, high = -64.0, 64.0  # exponents of the factor, by bisection: the sum rises with it
    for _ in range(80):
        middle = 0.5 * (low + high)
        fits = np.clip(np.exp2(middle) * ideal, least, cells).sum() <= k
        low, high = (middle, high) if fits else (low, middle)
    return frozen_float(np.clip(np.exp2(low) * ideal, least, cells))


def split_quotas(quotas: Float, measures: Float, cells: Int) -> Float:
    """Quotas ``(2B,)`` of the sides of B blocks: ``clamp(round(k · measure share), 1, min(k − 1, cells))``.

    Parameters
    ----------
    quotas : (B,) float
        Parts that each block is to become; those of its two sides add up to it.
    measures : (2B,) float
        Measure of each side.
    cells : (2B,) int
        Number of its cells.
    """
    sizes, measure = cells.reshape(-1, 2), measures.reshape(-1, 2)
    measure = np.where(measure.sum(axis=1, keepdims=True) > 0, measure, sizes)
    share = measure[:, 0] / measure.sum(axis=1)
    low = np.maximum(1.0, quotas - sizes[:, 1])
    high = np.minimum(quotas - 1.0, sizes[:, 0])
    first = np.clip(np.round(quotas * share), low, high)
    return frozen_float(np.stack((first, quotas - first), axis=1).ravel())
