"""Iterates from which conjugate gradients start afresh, and the best of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Float, frozen_float

_IDLE = 2
"""Fresh starts that gain nothing until an iteration is given up: rounding differs from one to the next."""

Iterate = tuple[float, Float, Float]
"""The relative size of b − A x, x and b − A x."""


@dataclass(eq=False)
class Restarts:
    """Fresh starts from b − A x, where the residual of the recursion has become another vector.

    Attributes
    ----------
    best : tuple
        The iterate of least residual among them.
    """

    best: Iterate = (np.inf, frozen_float([]), frozen_float([]))
    _bound: float = np.inf
    _idle: int = 0

    def add(self, iterate: Iterate, bound: float) -> bool:
        """Take note of a fresh start and return whether these gain nothing any more.

        Where rounding lets neither the residual nor the bound of the error fall they go up and down.
        """
        idle = iterate[0] > 0.5 * self.best[0] and bound > 0.5 * self._bound
        self._idle, self._bound = (self._idle + 1 if idle else 0), min(bound, self._bound)
        if iterate[0] < self.best[0]:
            self.best = iterate
        return self._idle >= _IDLE
