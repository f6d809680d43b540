"""What the corrections of a stationary iteration tell about its error."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from agglo_core.authoring import Float

__all__ = ["Corrections"]

_KEPT = 5


@dataclass(eq=False)
class Corrections:
    """The last corrections d of an iterate, each with A d, and the error they see."""

    _pairs: deque[tuple[Float, Float]] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def add(self, correction: Float, image: Float) -> None:
        self._pairs.append((correction, image))

    def parts(self, r: Float):
        V = np.array([d for d, _ in self._pairs]); W = np.array([w for _, w in self._pairs])
        G = V @ W.T
        n = np.sqrt(np.maximum(np.diag(G), 0))
        n[n == 0] = 1
        G = 0.5 * (G + G.T) / np.outer(n, n)
        g = (V @ r) / n
        lam, Q = np.linalg.eigh(G)
        keep = lam > 1e-10 * lam[-1]
        c = Q.T @ g
        proj = float(np.sqrt(np.sum(c[keep] ** 2 / lam[keep])))
        q = n[1:] / n[:-1]
        rate = max(q[-3:]) if len(q) else 0.0
        ratio = n[-1] / (1 - rate) if rate < 1 else np.inf
        return proj, ratio, n[-1], rate

    def error(self, r: Float) -> float:
        """‖e‖_A."""
        self.last = self.parts(r)
        return max(self.last[0], self.last[1])
