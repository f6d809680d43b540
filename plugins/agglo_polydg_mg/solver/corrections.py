"""What the corrections of a stationary iteration tell about its error."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from agglo_core.authoring import Float

_KEPT = 5
_RATES = 3
_INDEPENDENT = 1e-10
"""Least eigenvalue of a Gram matrix of unit vectors that is not taken for 0."""


@dataclass(eq=False)
class Corrections:
    """The last corrections d of an iterate, each with A d, and what they see of its error e.

    Two numbers that the energy norm of e is at least, nearly:

    - that of its projection on the corrections, which is known since d·A e = d·r, r being the residual. It is
      e itself where slow modes are left, however slow;
    - that of the last correction over 1 − ρ, ρ being the largest of the last ratios of two corrections. It is
      e where corrections go on to shrink like that.
    """

    _pairs: deque[tuple[Float, Float]] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def add(self, correction: Float, image: Float) -> None:
        """Take the next correction d ``(n,)`` and A d."""
        self._pairs.append((correction, image))

    def error(self, r: Float) -> float:
        """Estimate of ‖e‖_A, from the residual ``r (n,)`` that the last correction was made from.

        Infinite where corrections do not shrink, or A is not positive definite on them, or all are 0.
        """
        pairs = [(d, image) for d, image in self._pairs if d.any()]
        if not pairs:
            return float("inf")
        vectors, images = (np.array(each) for each in zip(*pairs, strict=True))
        gram = vectors @ images.T
        squares = np.diag(gram)
        if not (squares > 0.0).all():
            return float("inf")
        norms, stands = np.sqrt(squares), not self._pairs[-1][0].any()
        return max(_projected(gram, vectors @ r, norms), 0.0 if stands else _remaining(norms))


def _projected(gram: Float, products: Float, norms: Float) -> float:
    """Norm of the projection on vectors with these products among themselves and with the vector."""
    unit = gram / np.outer(norms, norms)
    values, axes = np.linalg.eigh(0.5 * (unit + unit.T))
    kept = values > _INDEPENDENT * values[-1]
    along = (axes.T @ (products / norms))[kept]
    return float(np.sqrt(np.sum(along**2 / values[kept])))


def _remaining(norms: Float) -> float:
    """Sum of the norms to come, the last one included, if they shrink as slowly as lately."""
    rate = float((norms[1:] / norms[:-1])[-_RATES:].max(initial=0.0))
    return float(norms[-1]) / (1.0 - rate) if rate < 1.0 else float("inf")
